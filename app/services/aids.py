"""Aids: what may come with the samples of a segment, as it was uploaded and as the engine takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.geodesy import TangentPlane
from app.engine.types import (
    Float64Array,
    GnssFixes,
    ImuSamples,
    PressureReadings,
    RadioScans,
    Segment,
    SpeedReadings,
    StepCounts,
)
from app.services.errors import InvalidError

RADIUS_68_SD = 1.515
"""Radius that holds 68 % of a circular normal distribution, in standard deviations per axis: sqrt(-2 ln 0.317)."""
MAX_FROM_ANCHOR_M = 1e6
"""Plan metres reach so far."""


@dataclass(frozen=True, slots=True)
class GnssReadings:
    """Satellite fixes as platforms report them: ``t`` (m,) s, WGS 84 (m,) degrees, ``accuracy_m`` (m,) 68 % radius."""

    t: Float64Array
    latitude_deg: Float64Array
    longitude_deg: Float64Array
    accuracy_m: Float64Array


@dataclass(frozen=True, slots=True)
class Aids:
    """What may come with samples; None: nothing was sent."""

    wifi: RadioScans | None = None
    ble: RadioScans | None = None
    gnss: GnssReadings | None = None
    pressure: PressureReadings | None = None
    speed: SpeedReadings | None = None
    steps: StepCounts | None = None


NO_AIDS = Aids()


@dataclass(frozen=True, slots=True)
class Recording:
    """A segment as it was uploaded: satellite fixes are in degrees still."""

    samples: ImuSamples
    aids: Aids = NO_AIDS

    def segment(self, plane: TangentPlane | None) -> Segment:
        """As the engine takes it: satellite fixes in the level frame, through the venue's anchor (``plane``).

        InvalidError if there are satellite fixes and no anchor, or if one lies beyond the reach of a level frame.
        """
        aids = self.aids
        gnss = None if aids.gnss is None else to_level(aids.gnss, plane)
        return Segment(self.samples, aids.wifi, aids.ble, gnss, aids.pressure, aids.speed, aids.steps)


def to_level(gnss: GnssReadings, plane: TangentPlane | None) -> GnssFixes:
    """Satellite fixes in the level frame, with a standard deviation per axis."""
    if plane is None:
        raise InvalidError(
            "gnss",
            "cannot be used: the venue has no anchor, so nobody knows where its levels lie",
            "set the venue's anchor with PATCH /v1/venues/{venue_id}, or leave gnss out",
        )
    x, y = plane.from_wgs84(gnss.latitude_deg, gnss.longitude_deg)
    distance = np.hypot(x, y)
    near = distance <= MAX_FROM_ANCHOR_M  # NaN, from the other side of the earth, is not
    if not near.all():
        i = int(near.argmin())
        raise InvalidError(
            "gnss.latitude_deg",
            f"fix {i} ({gnss.latitude_deg[i]:.5f}, {gnss.longitude_deg[i]:.5f}) lies more than "
            f"{MAX_FROM_ANCHOR_M / 1000:.0f} km from the venue's anchor",
            "send latitude and longitude in degrees, each under its name, or correct the venue's anchor",
        )
    return GnssFixes(gnss.t, x, y, gnss.accuracy_m / RADIUS_68_SD)
