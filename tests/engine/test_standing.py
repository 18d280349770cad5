"""Standing still: no steps, and nothing drifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.engine.inertial import advance, level_samples
from app.evaluation.datasets.ilc20 import open_ilc20
from tests.support.motion import chained, shifted, standing
from tests.support.walks import Field, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
WALK = walk_through(np.array([[0.0, 0.0], [25.0, 0.0]]), FIELD, np.random.default_rng(5)).samples
OFFSET = np.array([0.004, -0.006, 0.012])


def paused(seconds: float, gyro_offset: np.ndarray) -> tuple[float, float, object]:
    """A walk, a rest, and the walk again."""
    rest = standing(seconds, np.random.default_rng(3), at=WALK, gyro_offset=gyro_offset)
    return float(WALK.t[-1]), float(rest.t[-1]), chained(WALK, rest, shifted(WALK, float(rest.t[-1]) + 0.02))


def test_a_rest_has_no_steps_and_its_heading_stays() -> None:
    """Two minutes with a gyroscope off by 0.7 degrees a second: 82 degrees, were it believed."""
    begin, end, samples = paused(120.0, OFFSET)
    levelled, attitude = level_samples(samples)
    events = advance(None, samples)[1]
    assert not ((events.t > begin + 0.4) & (events.t < end)).any()
    before, after = np.interp([begin, end], levelled.t, levelled.heading)
    assert abs(after - before) < 0.1
    np.testing.assert_allclose(attitude.rest[:3], OFFSET, atol=1e-3)


def test_cutting_a_rest_changes_nothing() -> None:
    _, _, samples = paused(20.0, OFFSET)
    _, whole = advance(None, samples)
    state, headings = None, []
    for piece in cut(samples, seconds=3.3):
        state, events = advance(state, piece)
        headings.append(events.heading)
    np.testing.assert_allclose(np.concatenate(headings), whole.heading, atol=1e-9)


def test_a_slow_turn_is_no_rest() -> None:
    """Two degrees a second, as smooth as can be."""
    turn = np.array([0.0, 0.0, np.radians(2.0)])
    begin, end, samples = paused(30.0, turn)
    levelled, _ = level_samples(samples)
    before, after = np.interp([begin, end], levelled.t, levelled.heading)
    assert after - before == pytest.approx(np.radians(60.0), abs=0.05)


def test_wheels_that_turn_are_no_rest() -> None:
    """A robot glides along a bend of 100 m: half a degree a second, and nothing shakes."""
    bend = standing(30.0, np.random.default_rng(3), at=WALK, gyro_offset=np.array([0.0, 0.0, 0.01]))
    glided, _ = level_samples(bend, moving=np.ones(len(bend), dtype=bool))
    rested, _ = level_samples(bend)
    assert glided.heading[-1] == pytest.approx(0.3, abs=0.02)
    assert rested.heading[-1] < 0.1


def test_pauses_of_real_walks_have_no_lone_steps() -> None:
    """A step with nobody walking for more than a second before and after it is a gesture."""
    lone = total = 0
    for walk in open_ilc20(Path("maps/samples")).level("site1-F2").walks("train"):
        t = advance(None, walk.samples)[1].t
        gap = np.diff(t, prepend=-np.inf, append=np.inf)
        lone += int(((gap[:-1] > 1.2) & (gap[1:] > 1.2)).sum())
        total += len(t)
    assert total > 3000
    assert lone < 0.004 * total
