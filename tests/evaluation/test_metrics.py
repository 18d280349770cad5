"""Errors and their summary, on cases whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.types import Prior, Status
from app.evaluation.metrics import (
    ELLIPSE95,
    Confidence,
    Ends,
    StepScores,
    Summary,
    confidence,
    ends_of,
    interpolate_fixes,
    mahalanobis2,
    score_steps,
    summarize,
)
from app.evaluation.truth import WalkTruth
from tests.evaluation.fakes import fix

LEVEL = "site-F1"
TRUTH = WalkTruth(np.arange(11.0), np.arange(11.0), np.zeros(11))
"""One step a second along +x, 1 m each."""


def scores(fixes, prior=None, truth=TRUTH) -> StepScores:
    return score_steps(truth, fixes, start_t=0.0, level_id=LEVEL, prior=prior)


def test_the_newest_fix_not_later_than_the_step_counts() -> None:
    """Fixes every second, 3 m to the left, the one at 7 s 4 m to the left; steps before 5 s are not scored."""
    fixes = [fix(float(t), float(t), 4.0 if t == 7 else 3.0) for t in range(11)]
    result = scores(fixes)
    np.testing.assert_array_equal(result.t, np.arange(5.0, 11.0))
    np.testing.assert_allclose(result.error, [3, 3, 4, 3, 3, 3])
    assert result.answered.all()
    np.testing.assert_allclose(result.travelled, np.arange(5.0, 11.0))


def test_a_fix_from_the_future_does_not_count() -> None:
    fixes = [fix(5.0, 5.0, 0.0), fix(7.051, 7.0, 0.0), fix(8.05, 8.0, 0.0)]
    np.testing.assert_allclose(scores(fixes).error, [0, 1, 2, 0, 1, 2])  # 7.051 is too late for the step at 7


def test_order_of_arrival_does_not_matter() -> None:
    fixes = [fix(float(t), float(t), 0.1 * t) for t in range(11)]
    np.testing.assert_array_equal(scores(fixes).error, scores(fixes[::-1]).error)


def test_silence_is_scored_by_the_prior() -> None:
    result = scores([fix(8.0, 8.0, 0.0)], Prior(LEVEL, 0.0, 4.0))
    np.testing.assert_allclose(result.error, [math.hypot(5, 4), math.hypot(6, 4), math.hypot(7, 4), 0, 1, 2])
    np.testing.assert_array_equal(result.answered, [False] * 3 + [True] * 3)
    assert not result.inside[:3].any()
    nothing = scores([], Prior(LEVEL))
    assert np.isnan(nothing.error).all()
    assert summarize([nothing]) == replace(summarize([]), n_walks=1, sure_share=0.0)


def test_a_fix_that_is_not_a_number_is_no_fix() -> None:
    result = scores([fix(5.0, 5.0, 0.0), fix(6.0, math.nan, 0.0)])
    np.testing.assert_allclose(result.error, [0, 1, 2, 3, 4, 5])


def test_inside_the_ellipse_and_on_the_level() -> None:
    """Standard deviation 1 m: 2.44 m are inside, 2.45 m are not (sqrt(5.991) = 2.4477)."""
    at = {5: 2.44, 6: 2.45}
    fixes = [fix(float(t), float(t), at.get(t, 0.0), level=LEVEL if t != 9 else "other") for t in range(5, 11)]
    result = scores(fixes)
    np.testing.assert_array_equal(result.inside, [True, False, True, True, False, True])
    np.testing.assert_array_equal(result.level_right, [True, True, True, True, False, True])


def test_mahalanobis_of_a_tilted_ellipse() -> None:
    """Variances 4 along (1, 1) and 1 along (1, -1)."""
    tilted = replace(fix(0.0), cov_xx=2.5, cov_xy=1.5, cov_yy=2.5)
    along, across = 2.0 / math.sqrt(2), 1.0 / math.sqrt(2)
    squared = mahalanobis2(np.array([along, across, 0.0]), np.array([along, -across, 0.0]), [tilted] * 3)
    np.testing.assert_allclose(squared, [1.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(("xx", "xy", "yy"), [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (-1.0, 0.0, -1.0), (1.0, 2.0, 1.0)])
def test_a_covariance_that_is_none_holds_nothing(xx: float, xy: float, yy: float) -> None:
    broken = replace(fix(0.0), cov_xx=xx, cov_xy=xy, cov_yy=yy)
    assert mahalanobis2(np.zeros(1), np.zeros(1), [broken])[0] == math.inf


@given(st.integers(0, 2**32 - 1))
def test_the_ellipse_of_a_true_covariance_holds_95_percent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    covariance = root @ root.T
    dx, dy = root @ rng.normal(size=(2, 4000))
    claimed = replace(fix(0.0), cov_xx=covariance[0, 0], cov_xy=covariance[0, 1], cov_yy=covariance[1, 1])
    share = np.mean(mahalanobis2(dx, dy, [claimed] * 4000) <= ELLIPSE95)
    assert share == pytest.approx(0.95, abs=0.02)


def step_scores(error: list[float], *, sure: list[bool] | None = None, right: list[bool] | None = None) -> StepScores:
    n = len(error)
    yes = np.ones(n, dtype=bool)
    return StepScores(
        np.arange(n) + 5.0, np.arange(n) * 2.0, np.array(error), yes, np.array(error) <= 3.0,
        np.array(sure) if sure else yes, np.array(right) if right else yes, yes,
    )  # fmt: skip


def test_the_grace_of_the_first_seconds() -> None:
    fixes = [fix(float(t), float(t)) for t in range(11)]
    assert scores(fixes).t.tolist() == [5, 6, 7, 8, 9, 10]
    whole = score_steps(TRUTH, fixes, start_t=-np.inf, level_id=LEVEL, grace_s=0.0)
    assert whole.t.tolist() == list(range(11))
    later = whole.since(8)
    assert (len(later), later.t.tolist(), later.travelled.tolist()) == (3, [8, 9, 10], [8, 9, 10])


def test_summary_of_two_walks() -> None:
    """Errors 0..10 pooled over both walks; they end at 4 m and at 10 m."""
    walks = [
        step_scores([0, 1, 2, 3, 4], sure=[True, True, False, False, False]),
        step_scores([5, 6, 7, 8, 9, 10], sure=[True, False, False, False, False, True]),
    ]
    result = summarize(walks, [0.010, 0.020, 0.060])
    assert result == Summary(
        n_walks=2, mean=pytest.approx(5.0), p50=pytest.approx(5.0), p75=pytest.approx(7.5), p90=pytest.approx(9.0),
        p95=pytest.approx(9.5), end_p50=pytest.approx(7.0), end_p90=pytest.approx(9.4), end_within_5m=0.5,
        ellipse95=pytest.approx(4 / 11), sure_share=pytest.approx(4 / 11), sure_within_5m=0.75,
        ms_per_segment=pytest.approx(30.0),
    )  # fmt: skip


def test_a_sure_fix_on_the_wrong_level_is_not_near() -> None:
    assert summarize([step_scores([1.0, 1.0], right=[True, False])]).sure_within_5m == 0.5


def test_a_fix_on_a_wrong_level_is_farther_off_than_any_other() -> None:
    fixes = [fix(5.0, 5.0), fix(6.0, 6.0, level="another"), fix(9.0, 9.0)]
    result = scores(fixes)
    np.testing.assert_array_equal(result.error, [0.0, math.inf, math.inf, math.inf, 0.0, 1.0])
    np.testing.assert_array_equal(result.level_right, [True, False, False, False, True, True])
    summary = summarize([result])
    assert (summary.mean, summary.p50, summary.p75, summary.end_p50) == (pytest.approx(1 / 3), None, None, 1.0)
    assert summary.sure_within_5m == 0.5


def test_quantiles_stay_known_up_to_the_wrong_levels() -> None:
    walk = step_scores([1.0, 2.0, 3.0, math.inf, math.inf])
    assert summarize([walk]).p50 == 3.0
    assert summarize([step_scores([1.0, 2.0, math.inf, math.inf])]).p50 is None  # half way to nowhere


def test_ends_count_those_that_end_nowhere() -> None:
    walks = [step_scores([9.0, error]) for error in (1.0, 4.0, 6.0, math.inf, math.nan)]
    assert ends_of(walks) == Ends(n_walks=5, end_within_5m=0.4, end_p50=6.0, end_p90=None)
    assert ends_of([]).as_dict() == {"n_walks": 0, "end_within_5m": None, "end_p50": None, "end_p90": None}


@given(st.lists(st.floats(0, 100), min_size=1, max_size=40))
def test_quantiles_are_those_of_numpy(errors: list[float]) -> None:
    found = summarize([step_scores(errors)])
    expected = np.quantile(errors, [0.5, 0.75, 0.9, 0.95])
    np.testing.assert_allclose([found.p50, found.p75, found.p90, found.p95], expected, atol=1e-12)


def test_nothing_gives_none() -> None:
    values = summarize([]).as_dict()
    assert values.pop("n_walks") == 0
    assert set(values.values()) == {None}


def test_confidence_of_the_sure_flags() -> None:
    walks = [
        step_scores([20.0, 3.0, 11.0], sure=[False, True, True]),
        step_scores([1.0, 1.0], sure=[True, True], right=[True, False]),
        step_scores([1.0], sure=[False]),
    ]
    assert confidence(walks, [0.0, 2.0, 0.0]) == Confidence(
        n_walks=3, n_sure_walks=2, first_sure_s=pytest.approx(4.5), first_sure_m=pytest.approx(1.0),
        sure_wrong_share=0.5, level_hit_rate=pytest.approx(5 / 6), end_level_hit_rate=pytest.approx(2 / 3),
        sure_level_hit_rate=0.75, answered_share=1.0, located_share=1.0,
    )  # fmt: skip


def test_insufficient_fixes_do_not_count_as_located() -> None:
    result = scores([fix(5.0, status=Status.INSUFFICIENT), fix(8.0, status=Status.AMBIGUOUS)])
    np.testing.assert_array_equal(result.located, [False] * 3 + [True] * 3)


def test_a_smoothed_track_is_scored_between_its_fixes() -> None:
    """Fixes at 4 s and 8 s on the truth, variance 1 and 3; the ends are held."""
    track = [fix(8.0, 8.0, 0.0, sd=3**0.5, sure=False), fix(4.0, 4.0, 0.0)]
    np.testing.assert_allclose(scores(interpolate_fixes(track, TRUTH.t)).error, [0, 0, 0, 0, 1, 2], atol=1e-12)
    at = interpolate_fixes(track, np.array([0.0, 5.0, 6.5, 9.0]))
    assert [(f.t, f.x, f.sure) for f in at] == [
        (0.0, 4.0, True),
        (5.0, 5.0, True),
        (6.5, 6.5, False),
        (9.0, 8.0, False),
    ]
    assert [f.cov_xx for f in at] == pytest.approx([1.0, 1.5, 2.25, 3.0])
    assert interpolate_fixes([], TRUTH.t) == ()


finite = st.floats(-1e3, 1e3)


# binary fractions: shifting them is exact, so no time falls to the other side of "not later than"
times = st.integers(0, 12 * 64).map(lambda n: n / 64)


@given(
    st.lists(st.tuples(times, finite, finite), min_size=1, max_size=20, unique_by=lambda row: row[0]),
    finite, finite, st.integers(-1000, 1000),
)  # fmt: skip
def test_moving_everything_leaves_the_errors(
    rows: list[tuple[float, float, float]], dx: float, dy: float, dt: int
) -> None:
    here = scores([fix(*row) for row in rows], Prior(LEVEL, 1.0, 2.0))
    moved_truth = WalkTruth(TRUTH.t + dt, TRUTH.x + dx, TRUTH.y + dy)
    moved = [fix(t + dt, x + dx, y + dy) for t, x, y in rows]
    there = score_steps(moved_truth, moved, start_t=dt, level_id=LEVEL, prior=Prior(LEVEL, 1.0 + dx, 2.0 + dy))
    np.testing.assert_allclose(there.error, here.error, atol=1e-8)
    np.testing.assert_array_equal(there.answered, here.answered)


@given(st.lists(st.floats(0, 100), min_size=2, max_size=40), st.randoms())
def test_the_order_of_walks_does_not_matter(errors: list[float], random) -> None:
    walks = [step_scores([error, error + 1]) for error in errors]
    before = summarize(walks)
    random.shuffle(walks)
    for name, value in summarize(walks).as_dict().items():
        assert value == pytest.approx(getattr(before, name), abs=1e-3), name


@given(st.lists(st.floats(0, 100), min_size=1, max_size=40))
def test_quantiles_rise(errors: list[float]) -> None:
    s = summarize([step_scores(errors)])
    assert s.p50 <= s.p75 <= s.p90 <= s.p95 <= max(errors)
    assert min(errors) - 1e-9 <= s.mean <= max(errors) + 1e-9
