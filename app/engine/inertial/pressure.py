"""Changes of level from a barometer.

Weather moves the pressure by up to 3 hPa an hour: 25 m, but only 0.4 m a minute. So heights are compared within a
minute only, where whoever takes stairs, an escalator or a lift climbs several metres. A door that opens or a gust is
over in seconds, which medians leave out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.types import Float64Array, PressureReadings

WINDOW_S = 60.0
LEFT_M = 2.0
"""A climb of more within ``WINDOW_S`` has left the level: ramps and half landings rise less, storeys 3.5 to 5 m."""
STOREY_M = 4.2
"""Between the 3.5 m of offices and the 5 m of malls."""
SETTLED_M = 0.6
"""Heights that differ by less for ``SETTLE_BLOCKS`` are those of one level."""
SETTLE_BLOCKS = 5
BLOCK_S = 2.0
"""Each block of readings gives its median; a height is the median of three blocks."""
_STANDARD_HPA = 1013.25
_SCALE_M = 44330.8
_EXPONENT = 0.190263


def heights(hpa: Float64Array) -> Float64Array:
    """Heights in the standard atmosphere (ISO 2533), m, shape of ``hpa``; differences are good to some 5 %."""
    height: Float64Array = _SCALE_M * (1.0 - (hpa / _STANDARD_HPA) ** _EXPONENT)
    return height


def climbed(readings: PressureReadings, window_s: float = WINDOW_S) -> float:
    """Height gained over the last ``window_s`` of these readings, m; 0 with hardly any readings.

    The difference of medians over the last and the first ``BLOCK_S`` of that time.
    """
    t = readings.t
    if t.shape[0] < 2:
        return 0.0
    begin = max(t[-1] - window_s, t[0])
    height = heights(readings.hpa)
    first, last = (t >= begin) & (t <= begin + BLOCK_S), t >= t[-1] - BLOCK_S
    return float(np.median(height[last]) - np.median(height[first]))


def storeys(climb_m: float) -> int:
    """About how many storeys a climb is, negative downwards; at least one if it left the level."""
    if abs(climb_m) <= LEFT_M:
        return 0
    return int(np.sign(climb_m)) * max(round(abs(climb_m) / STOREY_M), 1)


def _no_readings() -> PressureReadings:
    return PressureReadings(np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class Barometer:
    """Watches for changes of level, segment by segment; how readings are cut changes nothing.

    Attributes
    ----------
    pending : PressureReadings
        Of the block that is not over.
    blocks : tuple of (time, height), s, m
        Medians of the last ``WINDOW_S``, oldest first.
    left_m : float or None
        While a climb goes on, the height it began at.
    climb_m : float
        Sum of the climbs that have ended.
    """

    pending: PressureReadings = field(default_factory=_no_readings)
    blocks: tuple[tuple[float, float], ...] = ()
    left_m: float | None = None
    climb_m: float = 0.0

    @property
    def climbing(self) -> bool:
        """Whether a level was left and none is reached yet."""
        return self.left_m is not None

    @property
    def elsewhere(self) -> bool:
        """Whether the climbs that have ended lead to another level."""
        return abs(self.climb_m) > LEFT_M

    def hear(self, readings: PressureReadings | None) -> Barometer:
        """Go on by some readings; those not later than known ones are left out."""
        if readings is None:
            return self
        known = self.pending
        last = known.t[-1] if len(known.t) else self.blocks[-1][0] if self.blocks else -np.inf
        new = readings.t > last
        t, hpa = np.concatenate([known.t, readings.t[new]]), np.concatenate([known.hpa, readings.hpa[new]])
        if len(t) == 0:
            return self
        number = np.floor(t / BLOCK_S)
        now = self
        for block in np.unique(number[number < number[-1]]):
            inside = number == block
            now = now._after(float(t[inside][-1]), float(np.median(heights(hpa[inside]))))
        open_block = number == number[-1]
        return replace(now, pending=PressureReadings(t[open_block], hpa[open_block]))

    def settled(self) -> Barometer:
        """The same, on a level that is known anew."""
        return replace(self, climb_m=0.0)

    def _after(self, t: float, height: float) -> Barometer:
        """One more block."""
        blocks = (*(b for b in self.blocks if b[0] > t - WINDOW_S), (t, height))
        now = replace(self, blocks=blocks)
        smooth = [float(np.median([h for _, h in blocks[i : i + 3]])) for i in range(len(blocks) - 2)]
        if not smooth:
            return now
        if self.left_m is None:
            farthest = max(smooth, key=lambda h: abs(smooth[-1] - h))
            return replace(now, left_m=farthest) if abs(smooth[-1] - farthest) > LEFT_M else now
        latest = smooth[-SETTLE_BLOCKS:]
        if len(latest) < SETTLE_BLOCKS or max(latest) - min(latest) > SETTLED_M:
            return now
        climb = smooth[-1] - self.left_m
        ended = climb if abs(climb) > LEFT_M else 0.0
        return Barometer(self.pending, blocks[-3:], None, self.climb_m + ended)
