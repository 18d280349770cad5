"""Survey walks moved to where they agree: simulated walks whose labels are off by a known way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping import build_map
from app.engine.mapping.adjustment import AdjustmentPolicy, OthersMap, adjust_walks, displacement
from app.engine.mapping.samples import PlacedSamples, place_samples
from app.engine.types import GridMap, MapBuildSettings, SurveyWalk, Waypoints
from tests.support.walks import Field, SimulatedWalk, survey_of, true_map, walk_through

LATE_S = 0.9
"""Labels set late by this put a walker of 1.17 m/s a metre back."""


@pytest.fixture(scope="module")
def placed(survey: tuple[SurveyWalk, ...]) -> list[PlacedSamples]:
    return [place_samples(walk) for walk in survey]


def _late(walk: SurveyWalk, by_s: float) -> SurveyWalk:
    labels = walk.waypoints
    return replace(walk, waypoints=Waypoints(labels.t + by_s, labels.x, labels.y))


def _error(walk: PlacedSamples, true: PlacedSamples) -> float:
    """Root mean square distance of samples from where they are, at the times both have, m."""
    x, y = (np.interp(walk.t, true.t, true.xy[:, axis]) for axis in (0, 1))
    return float(np.sqrt(((walk.xy - np.stack([x, y], axis=1)) ** 2).sum(axis=1).mean()))


def test_a_walk_with_late_labels_is_brought_back(survey: tuple[SurveyWalk, ...], placed: list[PlacedSamples]) -> None:
    late = place_samples(_late(survey[4], LATE_S))
    before = _error(late, placed[4])
    after = _error(adjust_walks([*placed[:4], late, *placed[5:]])[4], placed[4])
    assert before == pytest.approx(1.05, abs=0.15)
    assert after < 0.5 * before


def test_walks_that_agree_stay(placed: list[PlacedSamples]) -> None:
    moved = adjust_walks(placed)
    assert np.mean([_error(after, before) for after, before in zip(moved, placed, strict=True)]) < 0.3
    for after, before in zip(moved, placed, strict=True):
        np.testing.assert_array_equal(after.t, before.t)
        np.testing.assert_array_equal(after.mag, before.mag)


def test_a_survey_with_late_labels_still_gives_the_field(survey: tuple[SurveyWalk, ...], field: Field) -> None:
    """Late labels smear the map, since people walk both ways; adjusted, the map is nearer to the field again."""
    rng = np.random.default_rng(7)
    late = [_late(walk, max(rng.normal(0.0, LATE_S), -0.5)) for walk in survey]

    def error(*, align: bool) -> float:
        grid = build_map("sim", late, MapBuildSettings(align=align, extent=(0.0, 0.0, 40.0, 20.0))).grid_map
        truth = true_map(field, (0.0, 0.0, 40.0, 20.0)).mean
        wrong = (grid.mean - truth)[:, grid.support < 0.7]
        return float(np.sqrt(((wrong - wrong.mean(axis=1, keepdims=True)) ** 2).mean()))

    assert error(align=True) < 0.75 * error(align=False)


def test_where_the_others_never_were_a_walk_stays(placed: list[PlacedSamples]) -> None:
    away = replace(placed[0], xy=placed[0].xy + 500.0)
    moved = adjust_walks([away, *placed[1:]])[0]
    np.testing.assert_allclose(moved.xy, away.xy, atol=0.02)


def test_too_few_walks_are_left_as_they_are(placed: list[PlacedSamples]) -> None:
    assert adjust_walks(placed[:3]) == placed[:3]


def test_it_is_the_same_each_time_and_goes_with_the_origin(placed: list[PlacedSamples]) -> None:
    shift = np.array([100.0, -50.0])
    moved, again = adjust_walks(placed), adjust_walks(placed)
    elsewhere = adjust_walks([replace(walk, xy=walk.xy + shift) for walk in placed])
    for one, two, other in zip(moved, again, elsewhere, strict=True):
        np.testing.assert_array_equal(one.xy, two.xy)
        np.testing.assert_allclose(other.xy, one.xy + shift, atol=0.02)


@pytest.mark.parametrize(("along", "across"), [(0.75, 0.0), (-0.75, 0.0), (0.0, 0.5), (0.5, -0.25)])
def test_a_displacement_is_found(field: Field, along: float, across: float) -> None:
    walk = walk_through(np.array([[3.0, 5.0], [37.0, 5.0]]), field, np.random.default_rng(5))
    true, grid = _placed(walk), true_map(field, (0.0, 0.0, 42.0, 22.0))
    labelled = replace(true, xy=true.xy - [along, across])
    found = displacement(labelled, field.at(true.xy), _others(grid), AdjustmentPolicy())
    np.testing.assert_allclose(found.mean(axis=0), [along, across], atol=0.2)


def test_a_standing_walker_has_no_direction_and_does_not_break_it(field: Field) -> None:
    walk = walk_through(np.array([[3.0, 5.0], [20.0, 5.0]]), field, np.random.default_rng(5))
    true, grid = _placed(walk), true_map(field, (0.0, 0.0, 42.0, 22.0))
    standing = replace(true, xy=np.repeat(true.xy[:1], len(true), axis=0))
    found = displacement(standing, field.at(standing.xy), _others(grid), AdjustmentPolicy())
    assert np.isfinite(found).all()


def _placed(walk: SimulatedWalk) -> PlacedSamples:
    return place_samples(survey_of(walk, "walk"))


def _others(grid: GridMap) -> OthersMap:
    layers = grid.mean.astype(np.float64), grid.sd.astype(np.float64)
    return OthersMap(grid.x0, grid.y0, *layers, np.ones(3))
