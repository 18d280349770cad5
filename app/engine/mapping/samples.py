"""Survey walks turned into placed field samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.errors import InputError
from app.engine.inertial import find_steps, level_samples, window_means
from app.engine.inertial.legs import heading_offset, positions_by_steps, stride_scale
from app.engine.types import BoolArray, Float64Array, IntArray, SurveyWalk

WINDOW_S = 0.16
"""Field samples are means over this time on either side of a half step."""
_PAUSE_S = 0.8
_MIN_SAMPLES = 4


@dataclass(frozen=True, slots=True)
class PlacedSamples:
    """Field samples of one walk at each half step.

    Attributes
    ----------
    walk_id : str
    t : array, shape (n,), s
    xy : array, shape (n, 2), m, level frame
    heading : array, shape (n,), rad
        Heading of the device in the level frame as far as the survey tells: the direction of motion, or what the
        surveyor said. How the device was held adds to it.
    mag : array, shape (n, 3), uT
        Forward, left, up of the device.
    stride_scale : float or None
        The walker's stride over the stride model's; None where the walk does not tell.
    """

    walk_id: str
    t: Float64Array
    xy: Float64Array
    heading: Float64Array
    mag: Float64Array
    stride_scale: float | None = None

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def subset(self, keep: BoolArray | IntArray) -> PlacedSamples:
        """Rows of a mask or index array."""
        return replace(self, t=self.t[keep], xy=self.xy[keep], heading=self.heading[keep], mag=self.mag[keep])


def place_samples(walk: SurveyWalk) -> PlacedSamples:
    """Place the field samples of a walk between its waypoints.

    Raises
    ------
    InputError
        Fewer than two waypoints, waypoints out of order, or hardly any step between them.
    """
    waypoints = walk.waypoints
    if len(waypoints) < 2:
        raise InputError("waypoints", "at least two are needed to place a walk")
    if not np.all(np.diff(waypoints.t) > 0):
        raise InputError("waypoints.t", "must increase strictly")
    levelled, _ = level_samples(walk.samples)
    steps = find_steps(levelled.t, levelled.vertical)
    if len(steps) < _MIN_SAMPLES:
        raise InputError("samples.acc", f"shows {len(steps)} steps; a survey is walked")
    half = steps.t[1:] - 0.5 * np.minimum(np.diff(steps.t), _PAUSE_S)
    t = np.sort(np.concatenate([steps.t, half]))
    t = t[(t >= waypoints.t[0]) & (t <= waypoints.t[-1])]
    if t.shape[0] < _MIN_SAMPLES:
        raise InputError("waypoints.t", "hardly any step lies between the waypoints; are both on one clock?")
    x, y = positions_by_steps(t, steps, waypoints)
    if walk.device_heading is None:
        placed = levelled.heading + heading_offset(levelled, steps, waypoints)
    else:
        placed = levelled.heading + _offset_to(walk.device_heading, np.interp(t, levelled.t, levelled.heading))
    heading = np.interp(t, levelled.t, placed)
    mag = window_means(levelled.t, levelled.mag, t - WINDOW_S, t + WINDOW_S)
    scale = stride_scale(steps, float(levelled.t[-1]), waypoints)
    return PlacedSamples(walk.walk_id, t, np.stack([x, y], axis=1), heading, mag, scale)


def _offset_to(device_heading: float, free: Float64Array) -> float:
    """Angle that brings free-azimuth headings to a mean of ``device_heading``, rad."""
    return device_heading - float(np.angle(np.mean(np.exp(1j * free))))
