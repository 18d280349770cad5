"""One-dimensional maps of simulated lanes, whose field is known."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.mapping.routes import RouteProfile, extend_route, project
from app.engine.types import Float64Array
from tests.support.walks import Field

LINE = np.array([[0.0, 1.0], [30.0, 1.0], [30.0, 21.0]])
FIELD = Field.random(np.random.default_rng(5), length_m=3.0)


def _on_line(s: Float64Array) -> Float64Array:
    return np.stack([np.interp(s, [0, 30, 50], LINE[:, k]) for k in (0, 1)], axis=1)


def _readings(rng: np.random.Generator, *, passes: int = 12, noise: float = 0.5) -> tuple[Float64Array, Float64Array]:
    """Places and values of passes at a walking pace."""
    s = np.concatenate([np.arange(rng.uniform(0, 0.3), 50.0, 0.33) for _ in range(passes)])
    xy = _on_line(s)
    return xy, FIELD.at(xy) + noise * rng.standard_normal((len(s), 3))


def test_the_lane_is_found_between_the_points_too() -> None:
    profile = extend_route(LINE, *_readings(np.random.default_rng(1)))
    s = np.arange(0.0, 50.0, 0.1)
    away = np.abs(s - 30.0) > 2.0  # at the corner the field along the line has a kink
    mean, sd = profile.at(s)
    truth = FIELD.at(_on_line(s))
    error = (mean - truth)[away]
    assert np.sqrt((error**2).mean()) < 0.35
    straight = np.stack([np.interp(s, profile.along, column) for column in profile.mean.T], axis=1)
    assert np.sqrt((error**2).mean()) < 0.8 * np.sqrt(((straight - truth)[away] ** 2).mean())
    np.testing.assert_array_less(sd.min(), 0.5)
    np.testing.assert_allclose(profile.at(profile.along)[0], profile.mean, atol=1e-9)


def test_the_deviation_of_points_is_true() -> None:
    ratios = []
    for seed in range(8):
        profile = extend_route(LINE, *_readings(np.random.default_rng(seed), passes=8, noise=2.0))
        inner = np.abs(profile.along - 30.0) > 2.0
        ratios.append(((profile.mean - FIELD.at(_on_line(profile.along))) / profile.sd)[inner][1:-1] ** 2)
    assert 0.85 < np.concatenate(ratios).mean() < 1.25


def test_gross_errors_are_rejected() -> None:
    rng = np.random.default_rng(2)
    xy, values = _readings(rng)
    spoilt = values.copy()
    bad = rng.choice(len(values), len(values) // 50, replace=False)
    spoilt[bad] += 40.0
    clean, robust = extend_route(LINE, xy, values), extend_route(LINE, xy, spoilt)
    assert robust.rejected >= len(bad)
    assert np.sqrt(((clean.mean - robust.mean) ** 2).mean()) < 0.15


def test_a_gap_is_bridged_and_uncertain() -> None:
    xy, values = _readings(np.random.default_rng(3))
    s, _ = project(LINE, xy)
    known = (s < 10.0) | (s > 15.0)
    profile = extend_route(LINE, xy[known], values[known])
    mean, sd = profile.at(np.array([9.0, 12.5, 49.0]))
    assert np.isfinite(mean).all()
    assert (sd[1] > 2.0 * sd[0]).all()


def test_readings_off_the_line_are_not_of_it() -> None:
    xy, values = _readings(np.random.default_rng(4))
    aside = np.concatenate([xy, xy - np.array([0.0, 30.0])])
    both = extend_route(LINE[:2], aside, np.concatenate([values, values + 50.0]))
    np.testing.assert_array_equal(both.mean, extend_route(LINE[:2], xy, values).mean)


def test_projection_measures_along_and_across() -> None:
    s, away = project(LINE, np.array([[3.0, 2.0], [31.0, 5.0], [-2.0, 1.0]]))
    np.testing.assert_allclose(s, [3.0, 34.0, 0.0])
    np.testing.assert_allclose(away, [1.0, 1.0, 2.0])


@pytest.mark.parametrize(("line", "n", "named"), [(LINE[:1], 9, "line"), (LINE[[0, 0]], 9, "line"), (LINE, 2, "xy")])
def test_what_cannot_be_a_route(line: Float64Array, n: int, named: str) -> None:
    xy, values = _readings(np.random.default_rng(6))
    with pytest.raises(InputError, match=named):
        extend_route(line, xy[:n], values[:n])


def test_two_points_make_a_straight_line() -> None:
    profile = RouteProfile(
        np.array([0.0, 2.0]), np.zeros((2, 2)), np.array([[1.0], [3.0]]), np.full((2, 1), 0.1), np.zeros(1), 0
    )
    np.testing.assert_allclose(profile.at(np.array([-1.0, 1.0, 5.0]))[0][:, 0], [1.0, 2.0, 3.0])
