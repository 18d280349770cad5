"""A simulated level with its survey, honest walkers and others, as evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.mapping import Covariance, FieldLevel
from app.engine.mapping.model import MapModel
from app.engine.types import Evidence, EvidenceSource, FeatureSet, Float64Array, SourceKind
from tests.support.walks import Field

STEP_M = 0.6
DAY_S = 86_400.0
MEAN = np.array([3.0, 30.0, -30.0])
SD = 5.0
ERROR_UT, WHITE_UT = 2.5, 1.0
"""A walk's own error (correlated over two metres) and that of each row."""


@dataclass
class Level:
    """Thirty by twenty metres; ``change`` is added to the field from ``changed_t`` on inside ``area``."""

    field: Field
    rng: np.random.Generator
    size: tuple[float, float] = (30.0, 20.0)
    changed_t: float = np.inf
    area: tuple[float, float, float, float] = (10.0, 5.0, 15.0, 10.0)
    change: Float64Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def random(cls, seed: int) -> Level:
        """Another level for each seed."""
        rng = np.random.default_rng(seed)
        return cls(Field.random(rng, sd=SD, length_m=3.0), rng)

    @property
    def model(self) -> MapModel:
        """What a build would have fitted."""
        covariance = Covariance(length_m=5.0, error=(ERROR_UT / SD) ** 2, white=(WHITE_UT / SD) ** 2)
        return MapModel(FieldLevel(MEAN, np.full(3, SD)), covariance)

    def inside(self, xy: Float64Array) -> np.ndarray:
        """Whether places lie where the field changes."""
        x0, y0, x1, y1 = self.area
        return (xy[:, 0] >= x0) & (xy[:, 0] <= x1) & (xy[:, 1] >= y0) & (xy[:, 1] <= y1)

    def at(self, xy: Float64Array, t: float) -> Float64Array:
        """Field, shape (n, 3), uT."""
        changed = self.inside(xy)[:, None] & (t >= self.changed_t)
        return self.field.at(xy) + changed * self.change

    def read(self, xy: Float64Array, t: float) -> Float64Array:
        """The same as a walk reads it."""
        keep = np.exp(-STEP_M / 2.0)
        error = self.rng.standard_normal((len(xy), 3))
        for i in range(1, len(xy)):
            error[i] = keep * error[i - 1] + np.sqrt(1.0 - keep**2) * error[i]
        white = WHITE_UT * self.rng.standard_normal((len(xy), 3))
        return self.at(xy, t) + ERROR_UT * error + white

    def lane(self, y: float | None = None) -> Float64Array:
        """A way across the level, along x."""
        x = np.arange(0.0, self.size[0], STEP_M)
        at = self.rng.uniform(0.0, self.size[1]) if y is None else y
        return np.stack([x, np.full(len(x), at)], axis=1)

    def wander(self, metres: float = 60.0) -> Float64Array:
        """A way that bends and stays on the level, shape (n, 2)."""
        place, heading = self.rng.uniform(0.0, self.size), self.rng.uniform(0.0, 2.0 * np.pi)
        way = [place]
        while len(way) < metres / STEP_M:
            heading += 0.25 * self.rng.standard_normal()
            step = place + STEP_M * np.array([np.cos(heading), np.sin(heading)])
            if (step < 0).any() or (step > self.size).any():
                heading += 0.5
                continue
            place = step
            way.append(place)
        return np.array(way)

    def survey(self, spacing_m: float = 1.5, t: float = 0.0) -> Evidence:
        """Lanes along x, a walk each."""
        walks = []
        for i, y in enumerate(np.arange(0.5, self.size[1], spacing_m)):
            xy = self.lane(y)
            source = EvidenceSource(f"survey{i}", SourceKind.SURVEY, t=t + 60.0 * i)
            walks.append(Evidence.of(FeatureSet.VECTOR, source, xy, self.read(xy, source.t)))
        return Evidence.joined(walks)

    def session(self, name: str, who: str, t: float, way: Float64Array | None = None, spread: float = 0.3) -> Evidence:
        """What an honest walker contributes: read where he was, placed give or take ``spread``."""
        xy = self.wander() if way is None else way
        values = self.read(xy, t)
        placed = xy + spread * self.rng.standard_normal(2)
        return Evidence.of(
            FeatureSet.VECTOR, EvidenceSource(name, SourceKind.SESSION, who, t=t), placed, values, spread
        )

    def traffic(self, n: int, first_t: float = DAY_S, *, each: int = 1) -> list[Evidence]:
        """Honest sessions, one after another, ``each`` of one contributor."""
        return [self.session(f"s{first_t:.0f}-{i}", f"user{i // each}", first_t + 600.0 * i) for i in range(n)]


def tampered(evidence: Evidence, change: Callable[[Float64Array, Float64Array], Float64Array]) -> Evidence:
    """Evidence whose values are those of ``change(xy, values)``."""
    xy, values = evidence.xy.astype(np.float64), evidence.values.astype(np.float64)
    return replace(evidence, values=change(xy, values).astype(np.float32))


def joined(*parts: Evidence | Sequence[Evidence]) -> Evidence:
    """Evidence of all parts."""
    return Evidence.joined([e for part in parts for e in ([part] if isinstance(part, Evidence) else part)])
