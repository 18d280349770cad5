"""Sessions that change their level, told by the barometer."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import SessionState
from app.engine.localization.smoothing import smooth_session
from app.engine.types import Fix, GridMap, PressureReadings, Prior, Segment, Status
from tests.engine.conftest import CORNERS, LevelMaps
from tests.support.motion import chained, shifted, standing
from tests.support.walks import Field, cut, true_map, walk_through

FIELDS = {name: Field.random(np.random.default_rng(seed)) for name, seed in (("F1", 1), ("F2", 11), ("F3", 12))}
MAPS = {name: true_map(field, (0.0, 0.0, 42.0, 22.0), level_id=name) for name, field in FIELDS.items()}
BELOW = walk_through(CORNERS, FIELDS["F1"], np.random.default_rng(2))
ABOVE = walk_through(CORNERS[::-1], FIELDS["F2"], np.random.default_rng(3))
LIFT = standing(25.0, np.random.default_rng(4), at=BELOW.samples, gyro_offset=np.zeros(3))
UP = shifted(ABOVE.samples, float(LIFT.t[-1]) + 0.02)
DOORS = float(BELOW.samples.t[-1]), float(LIFT.t[-1])


def trip(climb_m: float, *, pressure: bool = True) -> list[Segment]:
    """A walk on the first level, a lift, a walk on the second: in segments of five seconds."""
    samples = chained(BELOW.samples, LIFT, UP)
    t = np.arange(samples.t[0], samples.t[-1], 0.2)
    risen = np.interp(t, [DOORS[0] + 4.0, DOORS[1] - 6.0], [0.0, climb_m])
    hpa = 950.0 - 0.1138 * risen + 0.02 * np.random.default_rng(0).standard_normal(len(t))
    pieces = []
    for piece in cut(samples, seconds=5.0):
        own = (t >= piece.t[0]) & (t <= piece.t[-1])
        pieces.append(Segment(piece, pressure=PressureReadings(t[own], hpa[own]) if pressure else None))
    return pieces


def run(pieces: list[Segment], maps: dict[str, GridMap], prior: Prior) -> list[Fix]:
    tracker, source = ParticleTracker(), LevelMaps(maps)
    state, fixes = tracker.start(prior, seed=1), list[Fix]()
    for piece in pieces:
        state, new = tracker.step(state, piece, source)
        assert SessionState.decode(state.payload).encode() == state.payload
        fixes += new
    return fixes


def errors_above(fixes: list[Fix]) -> np.ndarray:
    early = UP.t[0] - ABOVE.samples.t[0]
    return np.array([np.hypot(*(ABOVE.at(fix.t - early) - [fix.x, fix.y])) for fix in fixes])


@pytest.fixture(scope="module")
def through_the_lift() -> list[Fix]:
    return run(trip(4.5), MAPS, Prior(None))


class TestVenue:
    def test_the_session_arrives_on_the_next_level(self, through_the_lift: list[Fix]) -> None:
        before = [fix for fix in through_the_lift if DOORS[0] - 15.0 < fix.t < DOORS[0]]
        assert {fix.level_id for fix in before} == {"F1"}
        late = [fix for fix in through_the_lift if fix.t > UP.t[0] + 45.0]
        assert {fix.level_id for fix in late} == {"F2"}
        assert np.median(errors_above(late)) < 1.0

    def test_nothing_sure_is_said_in_between(self, through_the_lift: list[Fix]) -> None:
        between = [fix for fix in through_the_lift if DOORS[0] + 18.0 < fix.t < UP.t[0] + 10.0]
        assert between
        assert not any(fix.sure for fix in between)
        assert not any(fix.sure and fix.level_id != "F2" for fix in through_the_lift if fix.t > UP.t[0])

    def test_the_search_begins_about_the_lift_and_on_other_levels(self) -> None:
        tracker, source = ParticleTracker(), LevelMaps(MAPS)
        session = SessionState(Prior(None), 1)
        tracked = False
        for piece in trip(4.5):
            for _ in tracker.walk(session, piece, source):
                pass
            if tracked and session.quest is not None:
                break
            tracked = tracked or session.track is not None
        assert session.quest is not None
        place, level = session.quest.sightings
        xy, lift = np.array([[place.x, place.y], [place.x + 30.0, place.y]]), BELOW.at(DOORS[0])
        assert np.linalg.norm(xy[0] - lift) < 12.0
        near, far = place.log_weights("F2", xy[:, 0], xy[:, 1])
        assert near - far > 3.0
        assert (level.log_weights("F1", xy[:, 0], xy[:, 1]) < -2.0).all()
        assert (level.log_weights("F2", xy[:, 0], xy[:, 1]) == 0.0).all()

    def test_without_pressure_the_field_tells_later(self, through_the_lift: list[Fix]) -> None:
        """What the barometer is for: without it the old level is held until its track is found lost."""
        fixes = run(trip(4.5, pressure=False), MAPS, Prior(None))
        assert {fix.level_id for fix in fixes if DOORS[0] - 15.0 < fix.t < UP.t[0] + 10.0} == {"F1"}
        assert fixes[-1].level_id == "F2"
        first, told = (
            min(fix.t for fix in some if fix.level_id == "F2" and fix.sure) for some in (fixes, through_the_lift)
        )
        assert first > told

    def test_its_trajectory_has_both_levels_in_order(self) -> None:
        smoothed = smooth_session(ParticleTracker(), Prior(None), trip(4.5), LevelMaps(MAPS), seed=1)
        times = [fix.t for fix in smoothed]
        assert times == sorted(times)
        assert smoothed[-1].level_id == "F2"
        assert {fix.level_id for fix in smoothed if fix.t < DOORS[0]} == {"F1"}
        late = [fix for fix in smoothed if fix.t > UP.t[0] + 45.0]
        assert np.median(errors_above(late)) < 1.0


@pytest.mark.parametrize("maps", [MAPS, {"F1": MAPS["F1"]}], ids=["the session names its level", "there is one map"])
def test_a_level_without_a_map_is_off_it(maps: dict[str, GridMap]) -> None:
    prior = Prior("F1", 2.5, 1.5) if len(maps) > 1 else Prior(None)
    fixes = run(trip(4.5), maps, prior)
    assert any(fix.sure for fix in fixes if fix.t < DOORS[0])
    up = [fix for fix in fixes if fix.t > UP.t[0]]
    assert not any(fix.sure for fix in up)
    assert {fix.status for fix in up} <= {Status.OFF_MAP, Status.INSUFFICIENT}
    spread = [fix.cov_xx + fix.cov_yy for fix in (up[0], up[-1])]
    assert spread[1] > 3.0 * spread[0]


def test_a_ramp_changes_nothing() -> None:
    low, flat = (run(trip(climb)[:26], MAPS, Prior("F1", 2.5, 1.5)) for climb in (1.2, 0.0))
    assert low == flat
