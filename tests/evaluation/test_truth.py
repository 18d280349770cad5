"""Truth at steps and the surveyed area, on cases whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.inertial import detect_steps
from app.engine.types import Waypoints
from app.evaluation.truth import SurveyedArea, WalkTruth, interpolate, survey_track, truth_at_steps
from tests.evaluation.fakes import PACE_S, step_samples

L_SHAPE = Waypoints(np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0, 10.0]), np.array([0.0, 0.0, 5.0]))


def test_equal_steps_give_equal_distances() -> None:
    steps = np.arange(0.5, 20.1, 0.5)
    truth = truth_at_steps(steps, L_SHAPE)
    assert len(truth) == 40
    np.testing.assert_allclose(truth.x[:20], np.arange(1, 21) * 0.5)
    np.testing.assert_allclose(truth.y[20:], np.arange(1, 21) * 0.25)
    assert truth.travelled[-1] == pytest.approx(15.0 - 0.5)


def test_a_pause_costs_no_distance() -> None:
    """Ten steps, a stop of 5 s, ten steps: half the way is made before the stop."""
    leg = Waypoints(np.array([0.0, 15.0]), np.array([0.0, 20.0]), np.zeros(2))
    steps = np.concatenate((np.arange(0.5, 5.1, 0.5), np.arange(10.5, 15.1, 0.5)))
    truth = truth_at_steps(steps, leg)
    np.testing.assert_allclose(truth.x, np.arange(1, 21) * 1.0)
    x, _ = interpolate(np.array([6.0, 9.0]), steps, leg)
    np.testing.assert_allclose(x, [10.0, 10.0])  # by time it would have been 8 and 12


@pytest.mark.parametrize("steps", [np.empty(0), np.array([12.0, 12.5])], ids=["none", "on the other leg"])
def test_a_leg_without_steps_runs_in_time(steps: np.ndarray) -> None:
    x, y = interpolate(np.array([2.5, 5.0]), steps, L_SHAPE)
    np.testing.assert_allclose(x, [2.5, 5.0])
    np.testing.assert_allclose(y, 0.0)


def test_there_is_no_truth_outside_the_labels() -> None:
    truth = truth_at_steps(np.array([-3.0, -0.1, 0.0, 7.0, 20.0, 20.1]), L_SHAPE)
    np.testing.assert_array_equal(truth.t, [0.0, 7.0, 20.0])
    x, y = interpolate(np.array([-5.0, 30.0]), np.empty(0), L_SHAPE)
    np.testing.assert_allclose((x, y), [[0.0, 10.0], [0.0, 5.0]])


def test_no_steps_no_truth() -> None:
    truth = truth_at_steps(np.empty(0), L_SHAPE)
    assert (len(truth), len(truth.travelled)) == (0, 0)


def test_labels_are_reached_when_they_are_labelled() -> None:
    x, y = interpolate(L_SHAPE.t, np.arange(0.3, 19.0, 0.55), L_SHAPE)
    np.testing.assert_allclose(x, L_SHAPE.x)
    np.testing.assert_allclose(y, L_SHAPE.y)


def test_steps_felt_in_samples_give_an_even_walk() -> None:
    samples = step_samples(30.0)
    labels = Waypoints(samples.t[[0, -1]], np.array([0.0, 40.0]), np.zeros(2))
    truth = truth_at_steps(detect_steps(samples), labels)
    assert len(truth) == pytest.approx(30.0 / PACE_S, abs=2)
    # first and last step touch the edges of the recording, where a step is felt late or not at all
    np.testing.assert_allclose(np.diff(truth.x)[2:-2], 40.0 / len(truth), rtol=0.2)


steps_s = st.lists(st.floats(0.3, 3.0), min_size=0, max_size=60).map(lambda gaps: np.cumsum([0.0, *gaps])[1:])


@given(steps_s, st.floats(-100, 100), st.floats(-100, 100))
def test_moving_the_labels_moves_the_truth(steps: np.ndarray, dx: float, dy: float) -> None:
    moved = Waypoints(L_SHAPE.t, L_SHAPE.x + dx, L_SHAPE.y + dy)
    here, there = truth_at_steps(steps, L_SHAPE), truth_at_steps(steps, moved)
    np.testing.assert_allclose(there.x, here.x + dx, atol=1e-9)
    np.testing.assert_allclose(there.y, here.y + dy, atol=1e-9)


@given(steps_s)
def test_truth_never_walks_backwards_on_a_straight_line(steps: np.ndarray) -> None:
    line = Waypoints(np.array([0.0, 8.0, 20.0]), np.array([0.0, 10.0, 30.0]), np.zeros(3))
    t = np.linspace(-1.0, 21.0, 200)
    x, _ = interpolate(t, steps, line)
    assert np.all(np.diff(x) >= -1e-9)
    assert x[0] == pytest.approx(0.0)
    assert x[-1] == pytest.approx(30.0)


def _line_of_steps(n: int) -> WalkTruth:
    return WalkTruth(np.arange(n, dtype=float), np.arange(n, dtype=float), np.zeros(n))


def test_share_covered_counts_steps_within_a_metre() -> None:
    """Survey along y = 0.9 from x = 0 to 4: of the steps at x = 0 ... 9 those up to 4 are within 1 m."""
    x = np.linspace(0.0, 4.0, 400)
    area = SurveyedArea.from_tracks([(x, np.full(400, 0.9))])
    assert area.share_covered(_line_of_steps(10)) == pytest.approx(0.5)
    assert area.share_covered(_line_of_steps(5)) == 1.0


def test_the_metre_is_met_to_a_centimetre() -> None:
    for offset, covered in ((1.0, 1.0), (1.03, 0.0)):
        area = SurveyedArea.from_tracks([(np.array([3.0]), np.array([offset]))])
        assert area.share_covered(WalkTruth(np.zeros(1), np.array([3.0]), np.zeros(1))) == covered


def test_nothing_surveyed_covers_nothing() -> None:
    assert SurveyedArea.from_tracks([]).share_covered(_line_of_steps(3)) == 0.0
    area = SurveyedArea.from_tracks([(np.zeros(3), np.zeros(3))])
    assert len(area.positions) == 1  # standing still is one position
    assert area.share_covered(_line_of_steps(0)) == 0.0


def test_survey_track_holds_the_labelled_part_only() -> None:
    x, y = survey_track(np.array([-1.0, 0.0, 10.0, 20.0, 21.0]), np.empty(0), L_SHAPE)
    np.testing.assert_allclose(x, [0.0, 10.0, 10.0])
    np.testing.assert_allclose(y, [0.0, 0.0, 5.0])
