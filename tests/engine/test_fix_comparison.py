"""Comparison of what was told then and now."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.engine.localization.comparison import compare_fixes
from app.engine.types import Status
from tests.support.builders import T0, fix


def test_fixes_are_paired_by_time_and_measured_on_one_level() -> None:
    then = [fix(T0 + i, x=float(i)) for i in range(10)]
    now = [replace(one, x=one.x + 3.0, y=one.y - 4.0) for one in then[2:]] + [fix(T0 + 100)]
    now[0] = replace(now[0], level_id="other")
    now[1] = replace(now[1], sure=False, status=Status.AMBIGUOUS, x=now[1].x + 20.0)
    found = compare_fixes(then, now)
    assert (found.n_then, found.n_now, found.n_compared, found.n_other_level) == (10, 9, 8, 1)
    assert found.distance is not None
    assert found.sure_distance is not None
    assert (found.distance.n, found.distance.p50) == (7, pytest.approx(5.0))
    assert found.distance.largest == pytest.approx((23.0**2 + 16.0) ** 0.5)
    assert (found.sure_distance.n, found.sure_distance.largest) == (6, pytest.approx(5.0))
    assert found.status_then == {Status.OK: 1.0}
    assert found.status_now == {Status.OK: pytest.approx(8 / 9), Status.AMBIGUOUS: pytest.approx(1 / 9)}
    assert (found.sure_then, found.sure_now) == (1.0, pytest.approx(8 / 9))


def test_nothing_told_is_nothing_compared() -> None:
    found = compare_fixes([], [fix()])
    assert (found.n_compared, found.distance, found.sure_distance) == (0, None, None)
    assert (found.status_then, found.sure_then) == ({}, 0.0)
