"""Differences of maps: against a node-by-node twin, and what must hold for any two versions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.mapping.components import as_features, magnitude
from app.engine.mapping.diff import COMPONENTS, SIGNIFICANT, Component, MapDifference, diff_maps
from app.engine.types import FeatureSet, GridMap
from tests.support.builders import grid_map


def version(
    seed: int, *, rows: int = 12, columns: int = 9, x0: float = -1.5, y0: float = 2.0, features: str = "vector"
) -> GridMap:
    """A small map, some of it unmapped."""
    made = grid_map(rows=rows, columns=columns, seed=seed, features=FeatureSet(features))
    support = np.random.default_rng(seed + 50).uniform(0.0, 2.5, made.support.shape).astype(np.float32)
    return replace(made, x0=x0, y0=y0, support=support)


def nodes(grid: GridMap) -> dict[tuple[int, int], tuple[int, int]]:
    """Row and column of each mapped node by its place on the lattice."""
    first = round(grid.x0 / grid.cell_m), round(grid.y0 / grid.cell_m)
    return {(first[0] + c, first[1] + r): (r, c) for r, c in zip(*np.nonzero(grid.mapped), strict=True)}


def at(difference: MapDifference, values: np.ndarray, place: tuple[int, int]) -> float:
    """Value of a raster at a place of the lattice."""
    column, row = (
        round(k - origin / difference.cell_m) for k, origin in zip(place, (difference.x0, difference.y0), strict=True)
    )
    return float(values[row, column])


def test_every_node_is_compared_with_the_same_node_of_the_other_version() -> None:
    new, old = version(1), version(2, rows=8, columns=14, x0=-3.0, y0=3.5)
    difference = diff_maps(new, old)
    mine, theirs = nodes(new), nodes(old)
    both = mine.keys() & theirs.keys()
    assert len(both) > 5
    change, significance = difference.change(Component.ALL), difference.significance(Component.ALL)
    assert np.isfinite(change).sum() == np.isfinite(significance).sum() == len(both)
    changed = significant = 0
    for place in both:
        (r, c), (q, d) = mine[place], theirs[place]
        delta = new.mean[:, r, c].astype(float) - old.mean[:, q, d]
        z = delta / np.hypot(new.sd[:, r, c].astype(float), old.sd[:, q, d])
        assert at(difference, change, place) == pytest.approx(np.linalg.norm(delta), rel=1e-5)
        assert at(difference, significance, place) == pytest.approx(np.sqrt((z**2).mean()), rel=1e-5)
        assert at(difference, difference.change(Component.Y), place) == pytest.approx(delta[1], rel=1e-4, abs=1e-4)
        changed += np.linalg.norm(delta) > 10.0
        significant += bool(np.linalg.norm(delta) > 10.0 and np.sqrt((z**2).mean()) > SIGNIFICANT)
    found = difference.summary(10.0)
    assert 0 < significant < changed < len(both)
    assert (found.compared, found.changed, found.significant) == (len(both), changed, significant)
    assert found.newly_mapped == len(mine.keys() - theirs.keys())
    assert found.no_longer_mapped == len(theirs.keys() - mine.keys())


def test_a_version_does_not_differ_from_itself() -> None:
    one = version(3)
    found = diff_maps(one, one).summary(0.0)
    assert (found.changed, found.newly_mapped, found.no_longer_mapped, found.box) == (0, 0, 0, None)
    assert {statistics.largest for statistics in found.change} == {0.0}


def test_swapping_the_versions_turns_the_signs() -> None:
    new, old = version(1), version(2, rows=8, x0=-2.0)
    there, back = diff_maps(new, old), diff_maps(old, new)
    np.testing.assert_array_equal(there.change(Component.Z), -back.change(Component.Z))
    np.testing.assert_array_equal(there.change(Component.ALL), back.change(Component.ALL))
    assert there.summary().newly_mapped == back.summary().no_longer_mapped > 0


def test_a_planted_change_is_found_where_it_is_and_nowhere_else() -> None:
    old = grid_map(features=FeatureSet.VECTOR)
    mean = old.mean.copy()
    mean[2, 20:30, 40:50] += 15.0
    found = diff_maps(replace(old, mean=mean), old).summary()
    assert (found.changed, found.cell_m) == (100, 0.5)
    assert found.box == (old.x0 + 20.0, old.y0 + 10.0, old.x0 + 24.5, old.y0 + 14.5)
    by_component = {one.component: one for one in found.change}
    assert by_component[Component.Z].largest == pytest.approx(15.0, rel=1e-5)
    assert by_component[Component.X].largest == 0.0
    assert by_component[Component.ALL].rms == pytest.approx(15.0 * np.sqrt(100 / found.compared), rel=1e-4)


@pytest.mark.parametrize(("rich", "poor"), [("vector", "hv"), ("vector", "total"), ("hv", "total")])
def test_versions_of_different_features_are_compared_in_the_poorer_ones(rich: str, poor: str) -> None:
    new = version(1, features=rich)
    mean, sd = as_features(new.mean, new.sd, new.features, FeatureSet(poor))
    old = replace(new, features=FeatureSet(poor), mean=mean, sd=sd)
    for difference in (diff_maps(new, old), diff_maps(old, new)):
        found = difference.summary()
        assert found.features == poor
        assert [one.component for one in found.change] == list(COMPONENTS[FeatureSet(poor)])
        assert found.changed == 0
    with pytest.raises(InputError, match="does not follow"):
        diff_maps(new, old).change(Component.X)


def test_a_magnitude_has_the_deviation_that_its_components_give_it() -> None:
    rng = np.random.default_rng(5)
    mean, sd = np.array([30.0, -20.0, 5.0]), np.array([0.5, 1.0, 2.0])
    drawn = np.linalg.norm(rng.normal(mean, sd, (200_000, 3)), axis=1)
    norm, norm_sd = magnitude(mean[:, None].astype(np.float32), sd[:, None].astype(np.float32))
    assert norm_sd[0] == pytest.approx(drawn.std(), rel=0.02)
    assert norm[0] == pytest.approx(np.linalg.norm(mean))


@pytest.mark.parametrize(
    ("changes", "field"), [({"cell_m": 0.25}, "cell_m"), ({"x0": -1.4}, "x0"), ({"level_id": "other"}, "level_id")]
)
def test_maps_whose_nodes_do_not_coincide_are_refused(changes: dict[str, object], field: str) -> None:
    with pytest.raises(InputError) as caught:
        diff_maps(version(1), replace(version(2), **changes))  # type: ignore[arg-type]
    assert caught.value.field == field


def test_versions_that_share_no_node_have_nothing_to_compare() -> None:
    new, old = version(1), version(2, x0=100.0)
    found = diff_maps(new, old).summary()
    assert (found.compared, found.change) == (0, ())
    assert found.newly_mapped == int(new.mapped.sum())
