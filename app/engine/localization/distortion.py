"""What the steps of a track tell of its device's soft iron, and what follows for the particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.calibration import Reading, SoftIron
from app.engine.filtering import Cloud, FilterGrid, ParticleNoise
from app.engine.inertial import StepEvents
from app.engine.localization.integrity import spread
from app.engine.localization.session import Track
from app.engine.types import FeatureSet

_FIELD_UT = 50.0
_PARTICLES = 200
"""Of a cloud no more are needed for a mean of the map and its spread."""


@dataclass(frozen=True, slots=True)
class DistortionPolicy:
    """Which steps tell of soft iron, and how much.

    Attributes
    ----------
    field : float
        Standard deviation of a reading about the map, over the map's ``noise_sd``. Less than the particles take it for:
        theirs also stands for what no place explains.
    sure_m : float, m
        Spread of the particles up to which the map at their mean is the walker's.
    mapped : float
        Share of particles on mapped ground from which on.
    """

    field: float = 1.0
    sure_m: float = 2.2
    mapped: float = 0.9


def learn(
    track: Track, weighted: Cloud, grid: FilterGrid, events: StepEvents, i: int, noise: ParticleNoise,
    policy: DistortionPolicy,
) -> None:  # fmt: skip
    """Let step ``i`` count, ``weighted`` being the particles after it; renew the correction if that is due.

    Where the correction changes, the particles' hard iron is open by as much as the readings change, and the next
    reading is compared as a first one.
    """
    if events.carrying[i]:  # the device was turned, and its soft iron with it
        _forget(track)
    elif events.shift[i] > 0.0:
        track.soft_iron = track.soft_iron.shifted(float(events.shift[i]))
    if not _tells(track, events, i, noise, policy):
        return
    before = track.soft_iron
    track.soft_iron = before.observe(_reading(weighted, grid, events, i, noise, policy)).renewed()
    change = _FIELD_UT * float(np.abs(track.soft_iron.applied - before.applied).max())
    if change > 0.0:
        track.cloud.p[12:14] = np.maximum(track.cloud.p[12:14], change**2)
        track.cloud.moved = False


def _forget(track: Track) -> None:
    """The correction goes with it; particles know already that their hard iron is open."""
    track.soft_iron = SoftIron.start(None)


def _tells(track: Track, events: StepEvents, i: int, noise: ParticleNoise, policy: DistortionPolicy) -> bool:
    """Whether a step is the next one to count, undisturbed, on the map, and where it is thought to be."""
    integrity, estimate = track.integrity, track.estimate
    return (
        track.features is FeatureSet.VECTOR
        and integrity.borne_out
        and not integrity.doubted
        and not events.disturbed[i]
        and _is_due(integrity.walked_m, float(events.stride[i]), noise.correlation_m)
        and estimate.mapped >= policy.mapped
        and spread(estimate) <= policy.sure_m
    )


def _is_due(walked_m: float, stride: float, every_m: float) -> bool:
    """Whether a multiple of so many metres was passed with this stride: the steps between tell nothing new."""
    return walked_m // every_m > (walked_m - stride) // every_m


def _reading(
    weighted: Cloud, grid: FilterGrid, events: StepEvents, i: int, noise: ParticleNoise, policy: DistortionPolicy
) -> Reading:
    """The step's field beside the map's, averaged over the particles.

    Neighbours err alike: the map's error and the place's over one length, the noise about the map over another (that
    of the readings that are taken). A reading counts for its share of a length. (For a constant it would be two
    lengths, as of a first-order Markov process; but what soft iron does goes with the heading, and what wanders more
    slowly is the hard iron's.)
    """
    x, y, c, s = weighted.p[:4, weighted.draw(_PARTICLES, 0.5)]
    nodes = grid.lookup(x, y)[:, :5].astype(np.float64)
    mean, place = nodes.mean(axis=0), nodes[:, :3].var(axis=0)
    alike = max(noise.map_correlation_m / noise.correlation_m, 1.0)
    about = policy.field**2 * np.array(grid.noise_sd)[[0, 0, 1]] ** 2
    place[:2] = place[:2].mean()  # level frame's axes, and the device's: which way it turns is no matter
    variance = alike * (place + mean[[3, 3, 4]]) + about
    heading = float(np.arctan2(s.sum(), c.sum()))
    return Reading(events.mag[i], mean[:3], variance, float(events.heading[i]), heading, noise.correlation_m)
