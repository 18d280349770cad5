"""Fixes on the earth and as ROS messages: covariance turned with the anchor, speeds of the moment."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client import Anchor, Status
from isodyn_client.bridges import Georeference, nav_sat_fix, pose_with_covariance
from isodyn_client.bridges.ros import UNKNOWN_VARIANCE, stamp
from isodyn_client.follow import PlanFix
from test_client_nmea import FIX

ANCHOR = Anchor(latitude_deg=48.0, longitude_deg=11.0, bearing_deg=30.0)
PLAN = PlanFix(0, 1_764_000_000_000.0, 10.0, 5.0, 4.0, 0.6, 1.0, 0.0, Status.OK, True, "lev_1")


@given(st.floats(0, 360), st.floats(0.1, 20), st.floats(0.1, 20), st.floats(-0.9, 0.9))
def test_the_covariance_turns_with_the_anchor(bearing: float, sx: float, sy: float, correlation: float) -> None:
    plan = replace(PLAN, cov_xx=sx**2, cov_xy=correlation * sx * sy, cov_yy=sy**2)
    fix = Georeference(ANCHOR.model_copy(update={"bearing_deg": bearing})).place(plan)
    b = math.radians(bearing)
    turn = np.array([[math.cos(b), math.sin(b)], [-math.sin(b), math.cos(b)]])
    plane = np.array([[plan.cov_xx, plan.cov_xy], [plan.cov_xy, plan.cov_yy]])
    expected = turn @ plane @ turn.T
    found = [[fix.var_east, fix.cov_east_north], [fix.cov_east_north, fix.var_north]]
    np.testing.assert_allclose(found, expected, atol=1e-9 * sx * sy + 1e-9)


def test_plus_y_is_the_bearing() -> None:
    place = Georeference(ANCHOR)
    assert place.azimuth(90.0) == 30.0
    assert place.azimuth(0.0) == 120.0
    latitude, longitude = place.degrees(0.0, 100.0)
    north = (latitude - 48.0) * 111_200
    east = (longitude - 11.0) * 111_320 * math.cos(math.radians(48.0))
    assert math.degrees(math.atan2(east, north)) == pytest.approx(30.0, abs=0.2)
    assert math.hypot(east, north) == pytest.approx(100.0, abs=0.3)


@pytest.mark.parametrize(
    ("status", "sure", "sure_only", "claimed"),
    [
        (Status.OK, True, True, True),
        (Status.OK, False, True, False),
        (Status.OK, False, False, True),
        (Status.AMBIGUOUS, False, False, False),
        (Status.OFF_MAP, True, False, False),
    ],
)
def test_what_is_claimed(status: Status, sure: bool, sure_only: bool, claimed: bool) -> None:
    plan = replace(PLAN, status=status, sure=sure)
    assert Georeference(ANCHOR, sure_only).place(plan).claimed is claimed


def walked(*rows: tuple[float, float, str]) -> list[float | None]:
    """Speeds of fixes at (s, x, level)."""
    place = Georeference(ANCHOR)
    plans = [replace(PLAN, t_ms=PLAN.t_ms + 1000 * t, x=x, level_id=level) for t, x, level in rows]
    return [place.place(plan).speed_m_s for plan in plans]


def test_speeds_are_told_over_a_second_or_more() -> None:
    assert walked((0, 0, "a"), (0.5, 1, "a"), (1.0, 2, "a"), (1.5, 3, "a")) == [None, None, 2.0, 2.0]
    assert walked((0, 0, "a"), (20, 1, "a"), (21, 2, "a")) == [None, None, 1.0]
    assert walked((0, 0, "a"), (2, 1, "b"), (4, 3, "b")) == [None, None, 1.0]


def test_at_rest_there_is_no_course() -> None:
    place = Georeference(ANCHOR)
    place.place(PLAN)
    still = place.place(replace(PLAN, t_ms=PLAN.t_ms + 1000, x=PLAN.x + 0.1))
    assert still.speed_m_s == pytest.approx(0.1)
    assert still.course_deg is None
    moving = place.place(replace(PLAN, t_ms=PLAN.t_ms + 2000, x=PLAN.x + 1.1))
    assert moving.course_deg == 120.0


def test_nav_sat_fix() -> None:
    message = nav_sat_fix(replace(FIX, cov_east_north=1.5), "map")
    assert message["header"] == {"stamp": {"sec": 1_764_000_000, "nanosec": 250_000_000}, "frame_id": "map"}
    assert message["status"] == {"status": 0, "service": 0}
    assert message["position_covariance"] == [9.0, 1.5, 0.0, 1.5, 4.0, 0.0, 0.0, 0.0, UNKNOWN_VARIANCE]
    assert message["position_covariance_type"] == 3
    assert math.isnan(message["altitude"])
    none = nav_sat_fix(replace(FIX, claimed=False))
    assert none["status"]["status"] == -1
    assert math.isnan(none["latitude"])
    assert none["position_covariance_type"] == 0


def test_pose_with_covariance() -> None:
    message = pose_with_covariance(replace(PLAN, heading_deg=90.0))
    assert message["header"]["frame_id"] == "lev_1"
    pose = message["pose"]["pose"]
    assert (pose["position"]["x"], pose["position"]["y"]) == (10.0, 5.0)
    assert pose["orientation"]["z"] == pytest.approx(math.sqrt(0.5))
    covariance = np.array(message["pose"]["covariance"]).reshape(6, 6)
    np.testing.assert_array_equal(covariance, covariance.T)
    np.testing.assert_array_equal(covariance[:2, :2], [[4.0, 0.6], [0.6, 1.0]])
    assert (np.linalg.eigvalsh(covariance) > 0).all()


@pytest.mark.parametrize(
    ("t", "told"), [(1.9999996, (2, 0)), (0.0, (0, 0)), (1_764_000_000.000001, (1764000000, 1000))]
)
def test_stamps(t: float, told: tuple[int, int]) -> None:
    assert tuple(stamp(t).values()) == told
