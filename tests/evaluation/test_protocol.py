"""Scenarios, priors and segments."""

from __future__ import annotations

import hashlib
import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.types import Prior, RadioScans
from app.evaluation.datasets.ilc20 import RadioLog
from app.evaluation.errors import OptionsError
from app.evaluation.protocol import (
    Aids,
    EvaluationOptions,
    Scenario,
    cut_segments,
    make_trip,
    segment_edges,
    walk_seed,
)
from tests.evaluation.fakes import straight_walk

WALK = straight_walk("abc", duration_s=23.0)


def test_seed_is_that_of_the_walk_id() -> None:
    digest = hashlib.sha256(b"abc").hexdigest()
    assert walk_seed("abc") == int(digest[:16], 16) // 2
    assert len({walk_seed("abc"), walk_seed("abd"), walk_seed("abc", 1)}) == 3
    assert 0 <= walk_seed("abc") < 2**63


def test_tracking_displaces_the_first_label() -> None:
    trips = [make_trip(straight_walk(f"w{i}", duration_s=6.0), "lvl", Scenario.TRACKING) for i in range(300)]
    offset = np.array([[trip.prior.x, trip.prior.y - 2.0] for trip in trips])
    distance = np.hypot(*offset.T)
    assert distance.max() <= 3.0
    # uniform over the disc: half of the area lies within 3 / sqrt(2) m, and no direction is preferred
    assert np.median(distance) == pytest.approx(3 / math.sqrt(2), abs=0.2)
    assert np.all(np.abs(offset.mean(axis=0)) < 0.3)
    assert {(t.prior.radius_m, t.prior.heading, t.prior.level_id) for t in trips} == {(3.0, None, "lvl")}


def test_pose_tells_the_first_label_and_leg() -> None:
    walk = straight_walk("abc")
    turned = replace(walk, waypoints=replace(walk.waypoints, x=walk.waypoints.y, y=walk.waypoints.x))
    for recorded, start, heading in ((walk, (0.0, 2.0), 0.0), (turned, (2.0, 0.0), math.pi / 2)):
        prior = make_trip(recorded, "lvl", Scenario.POSE, repeat=3).prior
        assert (prior.x, prior.y) == start
        assert prior.heading == pytest.approx(heading)
        assert 0.0 < prior.radius_m <= 1.0


def test_the_same_walk_gives_the_same_trip() -> None:
    first, second = (make_trip(straight_walk("abc"), "lvl", Scenario.TRACKING) for _ in range(2))
    assert (first.prior, first.seed) == (second.prior, second.seed)
    assert make_trip(straight_walk("abc"), "lvl", Scenario.TRACKING, repeat=1).prior != first.prior


def test_other_scenarios_tell_no_position() -> None:
    cold, venue = (make_trip(WALK, "lvl", scenario) for scenario in (Scenario.COLD, Scenario.VENUE))
    assert (cold.prior.x, cold.prior.y, cold.prior.level_id) == (None, None, "lvl")
    assert (venue.prior, venue.level_id) == (Prior(None), "lvl")


def test_segments_hold_every_sample_once_and_in_order() -> None:
    segments = cut_segments(WALK)
    for name in ("t", "mag", "acc", "gyro"):
        joined = np.concatenate([getattr(s.samples, name) for s in segments])
        np.testing.assert_array_equal(joined, getattr(WALK.samples, name))
    assert [round(s.samples.t[-1] - s.samples.t[0], 2) for s in segments] == [4.98, 4.98, 4.98, 4.98, 2.98]


def test_a_short_remainder_joins_the_segment_before() -> None:
    assert len(cut_segments(straight_walk(duration_s=10.9))) == 2
    assert len(cut_segments(straight_walk(duration_s=11.2))) == 3
    assert len(cut_segments(straight_walk(duration_s=0.5))) == 1


@given(st.lists(st.floats(0.001, 20.0), min_size=0, max_size=80), st.floats(0, 1.6e9))
def test_no_segment_is_empty_or_long(gaps: list[float], start: float) -> None:
    t = start + np.cumsum([0.0, *gaps])
    edges = segment_edges(t)
    assert edges[0] == 0
    assert edges[-1] == len(t)
    assert np.all(np.diff(edges) > 0)
    for a, b in itertools.pairwise(edges):
        assert t[b - 1] - t[a] <= 6.0 + 1e-6


def test_replay_begins_at_the_first_label() -> None:
    labels = replace(WALK.waypoints, t=WALK.waypoints.t + np.array([4.1, 0.0]))
    trip = make_trip(replace(WALK, waypoints=labels), "lvl", Scenario.TRACKING)
    assert trip.start_t == pytest.approx(labels.t[0] - 0.5, abs=0.021)
    too_late = replace(WALK.waypoints, t=WALK.waypoints.t + 100.0)
    assert make_trip(replace(WALK, waypoints=too_late), "lvl", Scenario.TRACKING).segments == ()


def test_wifi_goes_along_only_when_asked_and_never_early() -> None:
    start = WALK.samples.t[0]
    reported = start + np.array([0.5, 4.97, 5.5, 12.0, 22.0])
    log = RadioLog(RadioScans(reported - 0.4, ("a", "b", "c", "d", "e"), np.full(5, -60.0)), reported)
    walk = replace(WALK, wifi_log=log)
    assert all(s.wifi is None for s in make_trip(walk, "l", Scenario.TRACKING).segments)
    segments = make_trip(walk, "l", Scenario.TRACKING, aids=Aids(wifi=True)).segments
    assert [s.wifi.address if s.wifi else () for s in segments] == [("a", "b"), ("c",), ("d",), (), ("e",)]
    assert all(s.wifi is None for s in make_trip(WALK, "l", Scenario.TRACKING, aids=Aids(wifi=True)).segments)


def test_each_aid_goes_along_only_when_asked() -> None:
    heard = WALK.samples.t[0] + np.array([0.5, 12.0])
    ble = RadioLog(RadioScans(heard, ("beacon", "other"), np.full(2, -80.0)), heard)
    wifi = RadioLog(RadioScans(heard, ("ap", "other ap"), np.full(2, -60.0)), heard)
    walk = replace(WALK, wifi_log=wifi, ble_log=ble)
    for aids in (Aids(), Aids(wifi=True), Aids(ble=True), Aids(wifi=True, ble=True)):
        first = make_trip(walk, "l", Scenario.TRACKING, aids=aids).segments[0]
        assert (first.wifi.address if first.wifi else None) == (("ap",) if aids.wifi else None)
        assert (first.ble.address if first.ble else None) == (("beacon",) if aids.ble else None)


@pytest.mark.parametrize(
    ("text", "aids"),
    [
        ("none", Aids()),
        ("", Aids()),
        ("wifi", Aids(wifi=True)),
        ("ble", Aids(ble=True)),
        ("wifi,ble", Aids(wifi=True, ble=True)),
        (" ble , wifi", Aids(wifi=True, ble=True)),
    ],
)
def test_aids_by_name(text: str, aids: Aids) -> None:
    assert Aids.parse(text) == aids
    assert Aids.parse(str(aids)) == aids
    assert bool(aids) == (aids != Aids())


def test_unknown_aids_are_named() -> None:
    with pytest.raises(OptionsError, match="knows no lidar; name none, wifi, ble or wifi,ble"):
        Aids.parse("wifi,lidar")


@pytest.mark.parametrize("wrong", [{"jobs": 0}, {"limit": 0}])
def test_options_that_make_no_sense(wrong: dict[str, int]) -> None:
    with pytest.raises(OptionsError, match=next(iter(wrong))):
        EvaluationOptions(Path(), **wrong)
