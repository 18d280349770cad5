from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.localization.marks import CHI2_95, Mark, match_mark
from app.engine.types import Status
from tests.support.builders import fix

FIXES = [fix(10.0, x=0.0, y=0.0), fix(11.0, x=2.0, y=0.0), fix(12.0, x=4.0, y=0.0)]


def test_between_two_fixes_the_position_is_interpolated() -> None:
    found = match_mark(Mark(10.25, 0.5, 3.0), FIXES)
    assert found is not None
    assert (found.x, found.y, found.error_m) == pytest.approx((0.5, 0.0, 3.0))
    assert found.apart_s == 0.25


def test_at_a_fix_it_is_that_fix() -> None:
    found = match_mark(Mark(11.0, 2.0, 0.0), FIXES)
    assert found is not None
    assert (found.x, found.error_m, found.normalized, found.inside) == (2.0, 0.0, 0.0, True)


@pytest.mark.parametrize(("t", "matched"), [(8.9, False), (9.1, True), (12.9, True), (13.1, False)])
def test_only_what_is_near_in_time_counts(t: float, matched: bool) -> None:
    assert (match_mark(Mark(t, 0.0, 0.0), FIXES) is not None) == matched


def test_across_a_gap_the_nearest_counts() -> None:
    found = match_mark(Mark(10.9, 0.0, 0.0), [FIXES[0], replace(FIXES[1], t=40.0)])
    assert found is not None
    assert found.x == 0.0
    assert match_mark(Mark(20.0, 0.0, 0.0), [FIXES[0], replace(FIXES[1], t=40.0)]) is None


def test_levels_are_not_blended_and_another_level_is_a_miss() -> None:
    upstairs = replace(FIXES[1], level_id="up")
    found = match_mark(Mark(10.9, 2.0, 0.0, level_id="lvl"), [FIXES[0], upstairs])
    assert found is not None
    assert (found.level_id, found.x, found.error_m, found.inside) == ("up", 2.0, 0.0, False)


def test_the_ellipse_is_the_claimed_one_and_the_mark_has_its_own_spread() -> None:
    one = replace(FIXES[0], cov_xx=4.0, cov_xy=1.5, cov_yy=1.0)
    offset = np.array([3.0, 1.0])
    expected = float(offset @ np.linalg.solve([[4.0, 1.5], [1.5, 1.0]], offset))
    found = match_mark(Mark(10.0, 3.0, 1.0), [one])
    assert found is not None
    assert found.normalized == pytest.approx(expected**0.5)
    assert found.inside == (expected <= CHI2_95)
    # 3.6 standard deviations of the fix alone, under two with a mark that is known to two metres
    aside = Mark(10.0, 0.0, 3.6)
    assert not match_mark(aside, [one]).inside  # type: ignore[union-attr]
    assert match_mark(replace(aside, sd_m=2.0), [one]).inside  # type: ignore[union-attr]


def test_sure_only_if_all_are_and_the_status_of_the_nearest() -> None:
    unsure = replace(FIXES[1], sure=False, status=Status.AMBIGUOUS)
    found = match_mark(Mark(10.2, 0.0, 0.0), [FIXES[0], unsure])
    assert found is not None
    assert (found.sure, found.status) == (False, Status.OK)


def test_the_ellipse_holds_as_often_as_it_promises() -> None:
    rng = np.random.default_rng(4)
    covariance = np.array([[2.0, 0.7], [0.7, 0.5]])
    marks = rng.multivariate_normal([5.0, 6.0], covariance, size=4000)
    one = replace(FIXES[0], x=5.0, y=6.0, cov_xx=2.0, cov_xy=0.7, cov_yy=0.5)
    inside = [match_mark(Mark(10.0, x, y), [one]).inside for x, y in marks]  # type: ignore[union-attr]
    assert 0.94 < np.mean(inside) < 0.96


def test_a_claim_without_uncertainty_holds_only_at_the_place() -> None:
    exact = replace(FIXES[0], cov_xx=0.0, cov_xy=0.0, cov_yy=0.0)
    assert match_mark(Mark(10.0, 0.0, 0.0), [exact]).inside  # type: ignore[union-attr]
    assert not match_mark(Mark(10.0, 0.1, 0.0), [exact]).inside  # type: ignore[union-attr]
