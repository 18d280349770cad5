"""What a track keeps of its newest steps, so that it can be found lost and searched for without walking them again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from app.engine.inertial import StepEvents
from app.engine.localization.aids import RadioSighting, Sighting, sighting_from, sighting_values
from app.engine.localization.profile import join, newest, no_steps, profile_from, profile_values
from app.engine.types import Float64Array

STEPS = 60
"""Steps kept: some 40 m, as much as a search needs."""
SCANS = 8
"""Scans and satellite fixes kept, a scan of a hundred readings takes 5 kB of the session's state."""
SCAN_M = 4.0
"""A scan nearer than this to one that is kept would count for little."""


@dataclass(frozen=True, slots=True, eq=False)
class Trail:
    """The newest steps of a track, and the running account of how well it explains them.

    Attributes
    ----------
    events : StepEvents
    places : array, shape (k, 4), m, m, m, -
        For each of the steps, x, y, spread (major semi-axis, one sigma) and share on mapped ground of the estimate
        before it.
    sightings : tuple of Sighting
        Seen since the first of the steps.
    misfit : float, nats per step
        By which readings are less likely than a good fit makes them, smoothed.
    waiting : int
        Steps until the track may be checked again.
    pause : int
        Steps to wait for after a check that finds nothing; grows with each.
    """

    events: StepEvents = field(default_factory=no_steps)
    places: Float64Array = field(default_factory=lambda: np.empty((0, 4)))
    sightings: tuple[Sighting, ...] = ()
    misfit: float = 0.0
    waiting: int = 0
    pause: int = 0

    @property
    def mapped(self) -> float:
        """Share on mapped ground, over the steps kept; 0 without any."""
        return float(self.places[:, 3].mean()) if len(self.events) else 0.0

    def walked(self, events: StepEvents, places: Sequence[tuple[float, float, float, float]], misfit: float) -> Trail:
        """After the steps of one more segment; ``places`` as the attribute, ``misfit`` its new value."""
        if not len(events):
            return self
        steps = newest(join(self.events, events), STEPS)
        return replace(
            self,
            events=steps,
            places=np.concatenate([self.places, np.array(places).reshape(-1, 4)])[-STEPS:],
            sightings=tuple(s for s in self.sightings if s.t > steps.t[0]),
            misfit=misfit,
            waiting=max(self.waiting - len(events), 0),
        )

    def heard(self, seen: Sequence[Sighting]) -> Trail:
        """With what was seen beside the field; scans at places that have one are left out."""
        kept = list(self.sightings)
        for sighting in seen:
            if not (isinstance(sighting, RadioSighting) and _has_like(kept, sighting)):
                kept.append(sighting)
        return replace(self, sightings=tuple(kept[-SCANS:]))


def _has_like(kept: Sequence[Sighting], scan: RadioSighting) -> bool:
    return any(
        isinstance(s, RadioSighting) and s.scan.is_ble == scan.scan.is_ble and scan.travelled_m - s.travelled_m < SCAN_M
        for s in kept
    )


def trail_values(trail: Trail) -> dict[str, Any]:
    """As plain values."""
    return {
        "events": profile_values(trail.events),
        "places": trail.places,
        "sightings": [sighting_values(s) for s in trail.sightings],
        "account": [trail.misfit, trail.waiting, trail.pause],
    }


def trail_from(values: Mapping[str, Any]) -> Trail:
    """Inverse of :func:`trail_values`."""
    sightings = tuple(sighting_from(s) for s in values["sightings"])
    return Trail(profile_from(values["events"]), values["places"], sightings, *values["account"])
