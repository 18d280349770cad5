"""A device's own step counter, for walks that its accelerometer hardly shows (a phone in a soft pocket)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.types import BoolArray, Float64Array, StepCounts

DECIDE = 6.0
"""Counted steps from which the two counts are compared: counters wait some steps before they believe in a walk."""
WARY = 12.0
"""Counted steps for which a detector that missed many is held against every reading."""
AGREE = 0.7
"""Share of the counted steps that must have been found for the walk to pass as seen."""
MAX_CREDIT = 12.0
"""Steps that a counter may lag behind the detector."""
MAX_RATE = 4.0
"""Steps a second nobody walks; a counter that claims more has jumped."""
MAX_INTERVAL_S = 1.0
"""Steps are spread no wider than this before the reading that reports them: the walker stood before."""


def _no_counts() -> StepCounts:
    return StepCounts(np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class Pedometer:
    """Detected steps against counted ones.

    Attributes
    ----------
    until : float, s
        Time up to which steps have been told already.
    t, count : float
        Reading that the comparison began with; NaN before the first.
    told : float
        Steps told since then.
    credit : float
        Steps told before then that the counter may still report.
    wary : float
        Counted steps until the detector is believed again.
    readings : StepCounts
        Later than ``until``.
    """

    until: float = -np.inf
    t: float = float("nan")
    count: float = float("nan")
    told: float = 0.0
    credit: float = 0.0
    wary: float = 0.0
    readings: StepCounts = field(default_factory=_no_counts)

    def hear(self, counts: StepCounts | None) -> Pedometer:
        """With new readings; those not later than known ones are left out."""
        if counts is None:
            return self
        known = self.readings
        new = counts.t > max(self.until, known.t[-1] if len(known.t) else -np.inf)
        readings = StepCounts(
            np.concatenate([known.t, counts.t[new]]), np.concatenate([known.count, counts.count[new]])
        )
        return replace(self, readings=readings)

    def compare(self, found: Float64Array, until: float) -> tuple[Pedometer, BoolArray, Float64Array]:
        """Judge the readings up to ``until``.

        Parameters
        ----------
        found : array, shape (n,), s
            Detected steps, later than ``self.until``.

        Returns
        -------
        Pedometer
        kept : array, shape (n,), bool
            Detected steps to be told.
        added : array, shape (m,), s
            Counted steps to be told beside them.
        """
        kept, added, now = np.ones(found.shape[0], dtype=bool), list[Float64Array](), self
        due = self.readings.t <= until
        for t, count in zip(self.readings.t[due].tolist(), self.readings.count[due].tolist(), strict=True):
            counted = count - now.count
            begin = max(now.t, self.until)
            here = (found > begin) & (found <= t)
            seen = now.told + now.credit + int(here.sum())
            if not 0.0 <= counted <= MAX_RATE * (t - now.t) + MAX_CREDIT:  # the first reading, or a counter set anew
                now = Pedometer(self.until, t, count)
            elif counted < (1.0 if now.wary > 0.0 else DECIDE):
                continue
            elif seen >= AGREE * counted:
                credit = min(max(seen - counted, 0.0), MAX_CREDIT)
                now = Pedometer(self.until, t, count, credit=credit, wary=max(now.wary - counted, 0.0))
            else:
                missing = round(counted - now.told - now.credit)
                interval = min((t - begin) / missing, MAX_INTERVAL_S)
                kept &= ~here
                added.append(t - interval * np.arange(missing)[::-1])
                now = Pedometer(self.until, t, count, wary=WARY)
        told = now.told + int((found > max(now.t, self.until)).sum())
        later = StepCounts(self.readings.t[~due], self.readings.count[~due])
        return (
            replace(now, until=until, told=told, readings=later),
            kept,
            np.concatenate(added) if added else np.empty(0),
        )
