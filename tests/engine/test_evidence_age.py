"""How old the evidence of a map is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.engine.mapping.age import newest_evidence
from app.engine.types import Evidence, EvidenceSource, FeatureSet, SourceKind
from tests.support.builders import grid_map

OLD, NEW = 1.7e9, 1.8e9


def evidence(xy: list[tuple[float, float]], source: list[int], times: list[float], **changes: object) -> Evidence:
    n = len(xy)
    found = Evidence(
        features=FeatureSet.VECTOR,
        sources=tuple(EvidenceSource(f"wlk_{i}", SourceKind.SURVEY, t=t) for i, t in enumerate(times)),
        source=np.array(source, np.int32),
        xy=np.array(xy, np.float32).reshape(n, 2),
        values=np.zeros((n, 3), np.float32),
        spread=np.zeros(n, np.float32),
        weight=np.ones(n, np.float32),
    )
    return replace(found, **changes)  # type: ignore[arg-type]


def test_the_newest_counts_in_each_metre() -> None:
    grid = grid_map()
    x, y = grid.x0 + 3.2, grid.y0 + 2.2
    found = newest_evidence(grid, evidence([(x, y), (x + 0.1, y), (x + 5.0, y)], [0, 1, 0], [OLD, NEW]))
    row, column = int(y - found.y0), int(x - found.x0)
    assert found.t[row, column] == NEW
    assert found.t[row, column + 5] == OLD
    assert np.isfinite(found.t).sum() == 2


def test_what_is_not_in_the_map_or_of_no_known_time_is_no_age() -> None:
    grid = grid_map()
    x, y = grid.x0 + 3.2, grid.y0 + 2.2
    rejected = evidence([(x, y)], [0], [NEW], weight=np.zeros(1, np.float32))
    undated = evidence([(x, y)], [0], [0.0])
    outside = evidence([(grid.x0 - 40.0, y), (x, grid.y0 + 1e4)], [0, 0], [NEW])
    for one in (rejected, undated, outside, Evidence.empty(FeatureSet.VECTOR)):
        assert np.isnan(newest_evidence(grid, one).t).all()
