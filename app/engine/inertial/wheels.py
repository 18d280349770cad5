"""Way from speed readings: a robot, trolley or car makes no steps, so its way is cut into pieces of a step's length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.inertial.attitude import LevelledSamples
from app.engine.inertial.events import Moments
from app.engine.inertial.steps import MIN_INTERVAL_S
from app.engine.types import BoolArray, Float64Array, SpeedReadings

PIECE_M = 0.6
"""Way after which the field is read; fast vehicles go farther, at most three pieces a second."""
HOLD_S = 2.0
"""A reading tells the speed for so long if no other follows."""
STANDING_M_S = 0.02
"""What encoders of a standing vehicle report."""


def _no_readings() -> SpeedReadings:
    return SpeedReadings(np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class Odometer:
    """Way integrated so far.

    Attributes
    ----------
    t : float, s
        Time up to which speed was integrated.
    piece_t : float, s
        Time of the last piece's end.
    way, x, y : float, m
        Way (backwards too counts up) and displacement (free azimuth) since the readings began.
    piece : tuple of three floats, m
        ``way``, ``x``, ``y`` at the last piece's end.
    readings : SpeedReadings
        Those needed from ``t`` on.
    """

    t: float = -np.inf
    piece_t: float = -np.inf
    way: float = 0.0
    x: float = 0.0
    y: float = 0.0
    piece: tuple[float, float, float] = (0.0, 0.0, 0.0)
    readings: SpeedReadings = field(default_factory=_no_readings)

    def hear(self, speed: SpeedReadings | None) -> Odometer:
        """With new readings; those not later than known ones are left out."""
        if speed is None:
            return self
        known = self.readings
        new = speed.t > (known.t[-1] if len(known.t) else -np.inf)
        readings = SpeedReadings(
            np.concatenate([known.t, speed.t[new]]), np.concatenate([known.speed, speed.speed[new]])
        )
        return replace(self, readings=readings)

    def speed(self, t: Float64Array) -> tuple[Float64Array, BoolArray]:
        """Speed at ``t``, m/s, and where it is known.

        Linear between readings at most ``HOLD_S`` apart; else, and after the last, a reading holds for that long.
        """
        known = self.readings
        if len(known.t) == 0:
            return np.zeros_like(t), np.zeros(t.shape, dtype=bool)
        before = np.searchsorted(known.t, t, side="right") - 1
        after = np.minimum(before + 1, len(known.t) - 1)
        before = np.maximum(before, 0)
        held = known.t[after] - known.t[before] > HOLD_S
        speed = np.where(held, known.speed[before], np.interp(t, known.t, known.speed))
        covered = (t >= known.t[before]) & (t - known.t[before] <= HOLD_S)
        return np.where(covered & (np.abs(speed) > STANDING_M_S), speed, 0.0), covered

    def drive(self, levelled: LevelledSamples, until: float) -> tuple[Odometer, Moments]:
        """Pieces of way that end after ``self.t`` and up to ``until``.

        Sums run on from the session's first reading, so a recording gives the same ones however it is cut, as long as
        readings come at least every ``SETTLE_S``.
        """
        t = levelled.t
        last = np.flatnonzero((t > self.t) & (t <= until))
        last = last[last > 0]
        if len(last) == 0 or len(self.readings.t) == 0:
            return replace(self, t=max(self.t, until)), _moments([])
        middle = 0.5 * (t[last] + t[last - 1])
        heading = 0.5 * (levelled.heading[last] + levelled.heading[last - 1])
        step = self.speed(middle)[0] * (t[last] - t[last - 1])
        way, x, y = (
            np.cumsum(np.concatenate([[start], piece]))[1:]
            for start, piece in (
                (self.way, np.abs(step)),
                (self.x, step * np.cos(heading)),
                (self.y, step * np.sin(heading)),
            )
        )
        found, piece, piece_t = [], self.piece, self.piece_t
        while True:
            k = max(
                int(np.searchsorted(way, piece[0] + PIECE_M - 1e-9)),
                int(np.searchsorted(t[last], piece_t + MIN_INTERVAL_S)),
            )
            if k >= len(last):
                break
            dx, dy = x[k] - piece[1], y[k] - piece[2]
            piece, piece_t = (float(way[k]), float(x[k]), float(y[k])), float(t[last[k]])
            found.append((piece_t, float(np.hypot(dx, dy)), float(np.arctan2(dy, dx))))
        kept = max(int(np.searchsorted(self.readings.t, until, side="right")) - 1, 0)
        readings = SpeedReadings(self.readings.t[kept:], self.readings.speed[kept:])
        return Odometer(until, piece_t, float(way[-1]), float(x[-1]), float(y[-1]), piece, readings), _moments(found)


def _moments(found: list[tuple[float, float, float]]) -> Moments:
    t, stride, course = np.array(found, dtype=np.float64).reshape(-1, 3).T
    return Moments(t, np.zeros_like(t), stride, np.ones(len(t), dtype=bool), course)
