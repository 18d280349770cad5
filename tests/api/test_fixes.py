from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.api.schemas.fixes import CHI2_95, FixesOut, PositionOut, ellipse95, fix_columns, heading_deg, position_object
from app.engine.types import Hypothesis
from tests.support.builders import fix

sds = st.floats(0.05, 50.0)


@given(major=sds, minor=sds, angle=st.floats(0.0, math.pi))
def test_the_ellipse_is_that_of_the_covariance(major: float, minor: float, angle: float) -> None:
    """Built from axes and angle, and given back; an eigenvalue decomposition is the twin."""
    major, minor = max(major, minor), min(major, minor)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance = turn @ np.diag([major**2, minor**2]) @ turn.T
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    shown = ellipse95(replace(fix(), cov_xx=xx, cov_xy=xy, cov_yy=yy))
    axes = np.sqrt(CHI2_95 * np.linalg.eigvalsh(covariance))
    assert shown["semi_major_m"] == pytest.approx(axes[1], abs=2e-3)
    assert shown["semi_minor_m"] == pytest.approx(axes[0], abs=2e-3)
    assert 0.0 <= shown["angle_deg"] < 180.0
    if major > 1.05 * minor:
        difference = math.radians(shown["angle_deg"]) - angle
        assert abs(math.sin(difference)) < 2e-3


def test_the_scale_is_the_95_percent_quantile() -> None:
    inside = np.random.default_rng(0).chisquare(2, 200_000) <= CHI2_95
    assert inside.mean() == pytest.approx(0.95, abs=0.002)


@given(heading=st.floats(-20.0, 20.0))
def test_headings_are_degrees_of_one_turn(heading: float) -> None:
    shown = heading_deg(replace(fix(), heading=heading))
    assert 0.0 <= shown < 360.0
    assert shown == round(shown, 2)
    assert math.cos(math.radians(shown) - heading) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("degrees", "shown"), [(-96.66, 263.34), (-1e-9, 0.0), (359.999, 0.0), (360.0, 0.0)])
def test_headings_are_rounded_last(degrees: float, shown: float) -> None:
    assert heading_deg(replace(fix(), heading=math.radians(degrees))) == shown


def test_columns_and_objects_say_the_same() -> None:
    fixes = [fix(t=100.0 + i, x=i / 3, y=-i / 7) for i in range(4)]
    fixes[2] = replace(fixes[2], walk_on_m=12.5, sure=False)
    columns = fix_columns(fixes)
    FixesOut.model_validate(columns)
    for i, one in enumerate(fixes):
        shown = position_object(one)
        PositionOut.model_validate(shown)
        assert {name: column[i] for name, column in columns.items()} == {name: shown[name] for name in columns}
        assert (shown["x"], shown["y"]) == pytest.approx((one.x, one.y), abs=5e-4)
    assert columns["walk_on_m"] == [None, None, 12.5, None]
    assert columns["t_ms"] == [100_000.0, 101_000.0, 102_000.0, 103_000.0]


def test_every_hypothesis_names_its_level() -> None:
    first = Hypothesis("lvl", 1.23456, 2.0, 3.0, 0.5, 2.0, 0.77777)
    second = Hypothesis("lvl_2", 4.0, 5.0, 1.0, 0.0, 1.0, 0.2)
    shown = position_object(replace(fix(), hypotheses=(first, second)))
    PositionOut.model_validate(shown)
    assert shown["hypotheses"] == [
        {"level_id": "lvl", "x": 1.235, "y": 2.0, "cov_xx": 3.0, "cov_xy": 0.5, "cov_yy": 2.0, "weight": 0.7778},
        {"level_id": "lvl_2", "x": 4.0, "y": 5.0, "cov_xx": 1.0, "cov_xy": 0.0, "cov_yy": 1.0, "weight": 0.2},
    ]


def test_no_fixes_are_empty_columns() -> None:
    assert all(column == [] for column in fix_columns(()).values())
