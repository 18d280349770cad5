"""Changes of how a phone is carried: attitude survives, the change is told, the walk goes on the way it went."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.engine.inertial import advance, level_samples
from app.engine.inertial.carrying import Carrying, follow
from tests.support.motion import held, turning
from tests.support.walks import Field, cut, walk_through

FIELD = Field.random(np.random.default_rng(1))
WALK = walk_through(np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 20.0]]), FIELD, np.random.default_rng(5))
AT = float(WALK.samples.t[0]) + 12.0
POCKETS = {
    "upright": (70.0, 0.0, 20.0),
    "upside down": (-85.0, 20.0, 60.0),
    "sideways": (0.0, 80.0, -40.0),
    "screen to the leg": (-60.0, 70.0, 100.0),
}


@pytest.mark.parametrize("name", list(POCKETS))
class TestHandToPocket:
    def test_the_levelled_field_is_that_of_the_hand(self, name: str) -> None:
        """Vertical and horizontal part do not depend on how the phone is held."""
        samples = held(WALK.samples, turning(WALK.samples.t, AT, POCKETS[name]))
        flat, _ = level_samples(WALK.samples)
        pocket, _ = level_samples(samples)
        np.testing.assert_allclose(pocket.mag[:, 2], flat.mag[:, 2], atol=1.5)
        horizontal = np.hypot(pocket.mag[:, 0], pocket.mag[:, 1])
        np.testing.assert_allclose(horizontal, np.hypot(flat.mag[:, 0], flat.mag[:, 1]), atol=1.5)

    def test_the_azimuth_goes_on(self, name: str) -> None:
        """The field in the free-azimuth frame, whatever axis of the phone is called forward."""
        samples = held(WALK.samples, turning(WALK.samples.t, AT, POCKETS[name]))
        flat, _ = level_samples(WALK.samples)
        pocket, _ = level_samples(samples)
        turn = (pocket.mag[:, 0] + 1j * pocket.mag[:, 1]) * np.exp(1j * pocket.heading)
        turn *= np.conj((flat.mag[:, 0] + 1j * flat.mag[:, 1]) * np.exp(1j * flat.heading))
        assert np.abs(np.angle(turn)).max() < 0.1

    @pytest.mark.parametrize("seconds", [1000.0, 1.7])
    def test_it_is_told_and_the_walk_goes_on_the_way_it_went(self, name: str, seconds: float) -> None:
        samples = held(WALK.samples, turning(WALK.samples.t, AT, POCKETS[name]))
        state, told, headings, times = None, [], [], []
        for piece in cut(samples, seconds=seconds):
            state, events = advance(state, piece)
            told += events.t[events.carrying].tolist()
            headings += events.motion_heading.tolist()
            times += events.t.tolist()
        assert len(told) == 1
        assert AT < told[0] < AT + 2.5
        truth = np.interp(times, WALK.samples.t, WALK.heading) - WALK.heading[0]
        off = np.abs(np.array(headings) - truth)
        assert off[np.array(times) < AT + 5.0].max() < 0.3, (
            "the first step of the change still looks like the ones before it"
        )
        assert np.median(off[np.array(times) > told[0]]) < 0.05


def test_a_walk_round_corners_is_no_change() -> None:
    events = advance(None, WALK.samples)[1]
    assert not events.carrying.any()


def test_a_swinging_arm_is_no_change() -> None:
    angle = np.radians(30.0) * np.sin(2 * np.pi * 0.9 * (WALK.samples.t - AT))
    swing = Rotation.from_rotvec(angle[:, None] * np.array([1.0, 0.0, 0.0]))
    assert not advance(None, held(WALK.samples, swing))[1].carrying.any()


class TestFollow:
    FLAT, UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])

    def test_a_glance_is_no_change(self) -> None:
        up = np.array([self.FLAT, self.FLAT, self.UP, self.FLAT])
        carrying, walking, changed = follow(None, up, np.array([0.1, 0.1, 2.0, 0.1]))
        assert not changed.any()
        np.testing.assert_allclose(walking, 0.1)
        assert carrying is not None
        assert not carrying.doubtful

    def test_a_change_is_told_at_the_second_step_and_turned_back(self) -> None:
        up = np.array([self.FLAT, self.UP, self.UP, self.UP])
        carrying, walking, changed = follow(None, up, np.array([0.1, 1.0, 2.1, 2.6]))
        assert changed.tolist() == [False, False, True, False]
        np.testing.assert_allclose(walking, [0.1, 0.1, 0.1, 0.6])
        assert carrying == Carrying((0.0, 1.0, 0.0), 2.6, 2.1, 2.0)

    def test_no_steps_change_nothing(self) -> None:
        before = Carrying((0.0, 0.0, 1.0), 0.3, 0.3)
        after, walking, changed = follow(before, np.empty((0, 3)), np.empty(0))
        assert after is before
        assert len(walking) == len(changed) == 0
