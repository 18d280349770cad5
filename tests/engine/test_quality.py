"""What of a level is covered, and where the sources of a map disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.mapping.quality import find_conflicts, summarize_coverage, walkable_space
from app.engine.types import Evidence, EvidenceSource, FeatureSet, Float64Array, GridMap, SourceKind
from tests.support.fields import field_map

NOISE_UT = 2.0


def level(**changes: object) -> GridMap:
    """20 m by 15 m of nodes half a metre apart from (-10, -20) on."""
    grid = field_map(np.random.default_rng(2), shape=(30, 40))
    return replace(grid, noise_sd=(NOISE_UT,) * 3, **changes)


def source(name: str) -> EvidenceSource:
    return EvidenceSource(name, SourceKind.SURVEY)


def walk(
    grid: GridMap, name: str, xy: Float64Array, rng: np.random.Generator, *, error: Float64Array | float = 0.0
) -> Evidence:
    """Readings along points: the map's own values, an error alike within a metre, and one of the sample."""
    c = np.rint((xy[:, 0] - grid.x0) / grid.cell_m).astype(int)
    r = np.rint((xy[:, 1] - grid.y0) / grid.cell_m).astype(int)
    metre = np.floor(xy[:, 0]).astype(int) - int(np.floor(xy[:, 0]).min())
    alike = rng.normal(0.0, NOISE_UT, (metre.max() + 1, 3))[metre]
    values = grid.mean[:, r, c].T + alike + rng.normal(0.0, 0.2, (len(xy), 3)) + error
    return Evidence.of(grid.features, source(name), xy, values)


def line(y: float, *, x0: float = -9.75, x1: float = 9.0) -> Float64Array:
    x = np.arange(x0, x1, 0.25)
    return np.stack([x, np.full(len(x), y)], axis=1)


def test_coverage_of_a_plan() -> None:
    obstacle = np.ones((30, 40), np.float32)
    obstacle[:, :10] = 0.0  # 10 columns by 30 rows: 75 m2, in two parts
    obstacle[:, 20:28] = 0.0
    support = np.full((30, 40), 8.0, np.float32)
    support[:15, :10] = 0.5
    support[:, 12:15] = 0.5  # mapped, but in a wall
    found = summarize_coverage(level(obstacle=obstacle, support=support))
    assert found.by_plan
    assert found.walkable_m2 == pytest.approx(30 * 18 * 0.25)
    assert found.mapped_m2 == pytest.approx(15 * 10 * 0.25)
    assert found.mapped_share == pytest.approx(150 / 540)
    assert [(part.area_m2, part.mapped_share) for part in found.regions] == [(75.0, 0.5), (60.0, 0.0)]
    assert found.regions[1].box == (0.0, -20.0, 3.5, -5.5)
    assert found.support_m == (8.0, 8.0)


def test_small_parts_are_not_listed() -> None:
    obstacle = np.ones((30, 40), np.float32)
    obstacle[:, :10] = 0.0
    obstacle[3:6, 20:24] = 0.0
    assert len(summarize_coverage(level(obstacle=obstacle)).regions) == 1


def test_without_a_plan_the_space_is_ground_near_mapped_ground() -> None:
    support = np.full((30, 40), 8.0, np.float32)
    support[15, 20] = 0.0
    space = walkable_space(level(support=support))
    assert space[15, 20 + 16]
    assert not space[15, 20 + 17]
    assert not walkable_space(level(support=np.full((30, 40), 8.0, np.float32))).any()


def test_a_level_with_nothing_mapped() -> None:
    found = summarize_coverage(level(support=np.full((30, 40), 8.0, np.float32)))
    assert (found.walkable_m2, found.mapped_share, found.regions) == (0.0, 0.0, ())


def test_sources_that_agree_are_in_conflict_by_chance_only() -> None:
    rng, grid = np.random.default_rng(3), level()
    walks = [walk(grid, f"w{y}-{k}", line(y), rng) for y in np.arange(-19.0, -6.0) for k in range(3)]
    view = find_conflicts(grid, Evidence.joined(walks))
    shared = np.isfinite(view.ratio)
    assert shared.sum() > 200
    assert set(view.sources[shared]) == {3}
    assert view.ratio[shared].mean() == pytest.approx(1.0, abs=0.15)
    assert view.conflict[shared].mean() < 0.04


def test_a_walk_that_is_wrong_on_a_stretch_is_shown_there() -> None:
    rng, grid = np.random.default_rng(4), level()
    walks = [walk(grid, f"w{y}-{k}", line(y), rng) for y in np.arange(-19.0, -6.0, 2.0) for k in range(3)]
    xy = line(-13.0)
    wrong = np.where((xy[:, :1] > 2.0) & (xy[:, :1] < 6.0), 15.0, 0.0) * np.ones(3)
    view = find_conflicts(grid, Evidence.joined([*walks, walk(grid, "wrong", xy, rng, error=wrong)]))
    row = int(-13.0 - view.y0)
    columns = [int(x - view.x0) for x in (3.2, 4.2, 5.2)]
    assert view.conflict[row, columns].all()
    elsewhere = view.conflict.copy()
    elsewhere[row] = False
    assert elsewhere.sum() < 0.05 * np.isfinite(view.ratio).sum()


def test_a_constant_offset_of_a_source_is_no_conflict() -> None:
    rng, grid = np.random.default_rng(5), level()
    walks = [walk(grid, f"w{k}", line(-12.0), rng) for k in range(3)]
    alone = find_conflicts(grid, Evidence.joined([*walks, walk(grid, "same", line(-12.0), np.random.default_rng(6))]))
    shifted = walk(grid, "same", line(-12.0), np.random.default_rng(6), error=30.0)
    moved = find_conflicts(grid, Evidence.joined([*walks, shifted]))
    assert moved.conflict.sum() <= alone.conflict.sum() + 1
    np.testing.assert_allclose(np.nanmedian(moved.ratio), np.nanmedian(alone.ratio), rtol=0.2)


def test_order_of_rows_does_not_matter() -> None:
    rng, grid = np.random.default_rng(7), level()
    evidence = Evidence.joined([walk(grid, f"w{k}", line(-12.0), rng) for k in range(3)])
    shuffled = evidence.subset(rng.permutation(len(evidence)))
    a, b = find_conflicts(grid, evidence), find_conflicts(grid, shuffled)
    np.testing.assert_allclose(a.ratio, b.ratio, rtol=1e-5)


def test_what_is_not_in_the_map_does_not_count() -> None:
    rng, grid = np.random.default_rng(8), level()
    evidence = Evidence.joined([walk(grid, f"w{k}", line(-12.0), rng) for k in range(2)])
    muted = replace(evidence, weight=np.where(evidence.source == 1, 0.0, 1.0).astype(np.float32))
    view = find_conflicts(grid, muted)
    assert view.sources.max() == 1
    assert not np.isfinite(view.ratio).any()
    assert find_conflicts(grid, Evidence.empty(grid.features)).sources.max() == 0


def test_nodes_take_the_value_of_their_cell() -> None:
    rng, grid = np.random.default_rng(9), level()
    view = find_conflicts(grid, Evidence.joined([walk(grid, f"w{k}", line(-12.0), rng) for k in range(2)]))
    ratio, sources, conflict = view.at_nodes(grid)
    assert ratio.shape == sources.shape == conflict.shape == grid.shape
    row = round((-12.0 - grid.y0) / grid.cell_m)
    assert (sources[row, 1:37] == 2).all()
    assert sources[row + 4].max() == 0


def test_evidence_of_other_features() -> None:
    with pytest.raises(InputError, match="vector"):
        find_conflicts(level(), Evidence.empty(FeatureSet.TOTAL))
