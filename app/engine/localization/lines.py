"""Lines of a session's particles: where those of now, or the ones they descend from, were at the last steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from app.engine.filtering import Cloud, Estimate
from app.engine.kernels import lines as kernel
from app.engine.localization.integrity import Integrity
from app.engine.types import Fix, Float32Array, Int16Array, IntArray


@dataclass(slots=True)
class OpenStep:
    """A step that is to be told once more.

    Attributes
    ----------
    t : float, s
    level_id : str
    x, y, heading : float
        As they were told in the moment (m, m, rad; level frame).
    integrity : Integrity
        As it was then.
    lines : array, shape (n, 2), int16, cm from ``(x, y)``
        Where each of the ``n`` particles of now, or its ancestor, was.
    """

    t: float
    level_id: str
    x: float
    y: float
    heading: float
    integrity: Integrity
    lines: Int16Array

    @classmethod
    def of(cls, fix: Fix, integrity: Integrity, particles: Cloud) -> OpenStep:
        """The step of ``fix``, with the particles that it was estimated from."""
        lines = np.empty((particles.n, 2), dtype=np.int16)
        kernel.record(particles.p[0], particles.p[1], fix.x, fix.y, lines)
        return cls(fix.t, fix.level_id, fix.x, fix.y, fix.heading, integrity, lines)

    def resample(self, ancestors: IntArray) -> None:
        """Particle ``i`` of now was particle ``ancestors[i]``, shape (n,)."""
        self.lines = self.lines.take(ancestors, axis=0)

    def estimate(self, weights: Float32Array) -> Estimate:
        """Moments of the lines under the weights of the particles of now, shape (n,)."""
        moments = np.empty(5)
        kernel.moments(self.lines, weights, moments)
        dx, dy, cov_xx, cov_xy, cov_yy = moments.tolist()
        return Estimate(self.x + dx, self.y + dy, cov_xx, cov_xy, cov_yy, self.heading, self.integrity.mapped)


def steps_values(steps: Sequence[OpenStep]) -> dict[str, Any]:
    """Open steps of one track as plain values: packed into few arrays, for this is on the way of every segment."""
    told = [(step.t, step.x, step.y, step.heading) for step in steps]
    then = [[float(getattr(step.integrity, name)) for name in _INTEGRITY] for step in steps]
    return {
        "level_ids": [step.level_id for step in steps],
        "told": np.array(told),
        "integrity": np.array(then),
        "lines": np.array([step.lines for step in steps], dtype=np.int16),
    }


def steps_from(values: Mapping[str, Any]) -> tuple[OpenStep, ...]:
    """Inverse of :func:`steps_values`."""
    columns = (values["level_ids"], values["told"].tolist(), values["integrity"].tolist(), values["lines"])
    return tuple(
        OpenStep(t, level_id, x, y, heading, _integrity(then), lines)
        for level_id, (t, x, y, heading), then, lines in zip(*columns, strict=True)
    )


_INTEGRITY = tuple(f.name for f in fields(Integrity))
_FLAGS = ("settled", "doubted", "borne_out", "found")


def _integrity(then: Sequence[float]) -> Integrity:
    known: dict[str, Any] = dict(zip(_INTEGRITY, then, strict=True))
    return Integrity(**{**known, **{name: bool(known[name]) for name in _FLAGS}})
