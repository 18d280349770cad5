"""The protocol of the corners."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from app.engine.types import Fix, ImuSamples, Waypoints
from app.evaluation.corners import (
    Corners,
    CornerSummary,
    corner_errors,
    run_error,
    scored_corners,
    summarize_runs,
    turn_times,
)
from tests.evaluation.fakes import fix
from tests.evaluation.halls import Recording, record

ZIGZAG = np.array([[0.0, 0], [12, 0], [12, 10], [2, 10], [2, 20], [14, 20], [14, 30]])


def waypoints(recording: Recording) -> Waypoints:
    t = recording.samples.t[0] + recording.t
    return Waypoints(t, recording.corners[:, 0], recording.corners[:, 1])


def exact_fixes(recording: Recording) -> list[Fix]:
    points = waypoints(recording)
    t = np.arange(points.t[0], points.t[-1], 0.1)
    x, y = np.interp(t, points.t, points.x), np.interp(t, points.t, points.y)
    return [fix(float(a), float(b), float(c)) for a, b, c in zip(t, x, y, strict=True)]


@pytest.fixture(scope="module")
def zigzag() -> Recording:
    return record("test-1", "test", ZIGZAG, seed=3)


def test_every_corner_but_start_and_end_is_found(zigzag: Recording) -> None:
    corners = scored_corners(zigzag.samples, waypoints(zigzag))
    assert corners.index.tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(corners.t, waypoints(zigzag).t[1:-1], atol=0.6)


def test_a_straight_walk_has_no_turns() -> None:
    line = record("test-1", "test", np.array([[0.0, 0], [20, 0]]))
    assert len(turn_times(line.samples)) == 0
    assert len(scored_corners(line.samples, waypoints(line))) == 0


def test_of_turns_close_together_the_sharpest_counts() -> None:
    """Two corners two steps apart are one turn, as for the source."""
    track = np.array([[0.0, 0], [12, 0], [12, 1.4], [24, 12]])
    recording = record("test-1", "test", track, seed=3)
    assert len(turn_times(recording.samples)) == 1
    assert scored_corners(recording.samples, waypoints(recording)).index.tolist() in ([1], [2])


def test_a_wiggle_far_from_all_labels_shifts_nothing(zigzag: Recording) -> None:
    samples = zigzag.samples
    since = samples.t - samples.t[0]
    gyro = samples.gyro.copy()
    gyro[(since > 5.0) & (since < 5.3), 2] += 3.0
    gyro[(since > 5.5) & (since < 5.8), 2] -= 3.0
    wiggled = replace(samples, gyro=gyro)
    assert len(turn_times(wiggled)) > len(turn_times(samples))
    assert scored_corners(wiggled, waypoints(zigzag)).index.tolist() == [1, 2, 3, 4, 5]


def test_exact_fixes_are_off_by_what_lies_between_turn_and_label(zigzag: Recording) -> None:
    points = waypoints(zigzag)
    errors = corner_errors(exact_fixes(zigzag), scored_corners(zigzag.samples, points), points)
    assert errors.max() < 0.8
    shifted = [replace(f, x=f.x + 30.0, y=f.y + 40.0) for f in exact_fixes(zigzag)]
    away = corner_errors(shifted, scored_corners(zigzag.samples, points), points)
    np.testing.assert_allclose(away, 50.0, atol=0.8)


def test_the_newest_fix_counts_and_a_later_one_does_not() -> None:
    points = Waypoints(np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0, 20.0]), np.zeros(3))
    corners = Corners(np.array([1]), np.array([10.0]))
    fixes = [fix(12.0, 99.0), fix(9.0, 8.0), fix(8.0, 0.0), fix(9.5, math.nan)]
    assert corner_errors(fixes, corners, points).tolist() == [2.0]
    assert corner_errors(fixes[:1], corners, points).tolist() == [math.inf]
    assert corner_errors([], corners, points).tolist() == [math.inf]


def test_the_first_two_corners_are_left_out() -> None:
    assert run_error(np.array([50.0, 40.0, 1.0, 2.0, 3.0])) == pytest.approx(2.0)
    assert run_error(np.array([50.0, 40.0])) is None
    assert run_error(np.array([0.0, 0.0, math.inf])) == math.inf


def test_summary_of_runs() -> None:
    summary = summarize_runs([1.0, 2.0, 9.0, 20.0, None])
    assert summary == CornerSummary(4, 0.5, 1.5, 8.0)
    assert summary.as_dict() == {"n_runs": 4, "converged_share": 0.5, "mean_converged": 1.5, "mean_all": 8.0}
    assert summarize_runs([math.inf, 1.0]) == CornerSummary(2, 0.5, 1.0, None)
    assert summarize_runs([10.0]) == CornerSummary(1, 0.0, None, 10.0)
    assert summarize_runs([None]) == CornerSummary(0, None, None, None)


def test_a_handful_of_samples() -> None:
    few = ImuSamples(np.arange(3.0), np.ones((3, 3)), np.ones((3, 3)), np.zeros((3, 3)))
    assert len(turn_times(few)) == 0
