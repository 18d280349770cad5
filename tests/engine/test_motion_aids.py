"""What wheels, counters, disturbances, changes of carrying and pauses do to a tracked session."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from app.engine.filtering import Advance, Cloud, FilterGrid, ParticleNoise, prepare_grid
from app.engine.inertial import StepEvents
from app.engine.localization import create_tracker
from app.engine.localization.initial import InitialSpread, initial_cloud
from app.engine.localization.integrity import Integrity, IntegrityPolicy, judge
from app.engine.localization.motion import loosen, take_step
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import estimate_of
from app.engine.localization.smoothing import smooth_session
from app.engine.types import FeatureSet, Fix, GridMap, ImuSamples, Prior, Segment, SpeedReadings, Status, StepCounts
from tests.engine.conftest import CORNERS, OneMap
from tests.support.motion import chained, drive_through, held, shifted, standing, turning
from tests.support.walks import CADENCE_HZ, Field, SimulatedWalk, cut, walk_through

PRIOR = Prior("sim", 2.5, 1.5, 3.0)


def segments(
    samples: ImuSamples, *, speed: SpeedReadings | None = None, steps: StepCounts | None = None, seconds: float = 5.0
) -> list[Segment]:
    """Pieces of a recording, each with its share of the readings."""
    pieces, since = [], -np.inf
    for piece in cut(samples, seconds=seconds):
        until = piece.t[-1]
        pieces.append(
            Segment(
                piece,
                speed=None if speed is None else SpeedReadings(*between(speed.t, speed.speed, since, until)),
                steps=None if steps is None else StepCounts(*between(steps.t, steps.count, since, until)),
            )
        )
        since = until
    return pieces


def between(t: np.ndarray, values: np.ndarray, since: float, until: float) -> tuple[np.ndarray, np.ndarray]:
    own = (t > since) & (t <= until)
    return t[own], values[own]


def track(pieces: Iterable[Segment], grid_map: GridMap, *, method: str = "particle", prior: Prior = PRIOR) -> list[Fix]:
    tracker = create_tracker(method)
    state, fixes = tracker.start(prior, seed=1), list[Fix]()
    for piece in pieces:
        state, new = tracker.step(state, piece, OneMap(grid_map))
        fixes += new
    return fixes


def errors(fixes: list[Fix], walk: SimulatedWalk, after_s: float = 5.0) -> np.ndarray:
    late = [fix for fix in fixes if fix.t > walk.samples.t[0] + after_s]
    return np.array([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in late])


class TestWheels:
    @pytest.mark.parametrize("speed_m_s", [0.4, 1.5])
    def test_a_robot_is_tracked(self, field: Field, field_map: GridMap, speed_m_s: float) -> None:
        robot, speed = drive_through(CORNERS, field, np.random.default_rng(2), speed_m_s=speed_m_s)
        iron = replace(robot.samples, mag=robot.samples.mag + np.array([3.0, -4.0, 5.0]))
        fixes = track(segments(iron, speed=speed), field_map)
        error = errors(fixes, robot, 10.0)
        assert np.median(error) < 1.0
        assert np.percentile(error, 95) < 2.0

    def test_its_place_is_searched_where_it_is_unknown(self, field: Field, field_map: GridMap) -> None:
        robot, speed = drive_through(CORNERS, field, np.random.default_rng(2))
        fixes = track(segments(robot.samples, speed=speed), field_map, prior=Prior("sim"))
        assert errors(fixes, robot, 60.0).max() < 2.0

    def test_dead_reckoning_goes_by_them(self, field: Field, field_map: GridMap) -> None:
        robot, speed = drive_through(CORNERS, field, np.random.default_rng(2))
        prior = Prior("sim", 2.0, 2.0, 0.5, heading=0.0)
        fixes = track(segments(robot.samples, speed=speed), field_map, method="dead_reckoning", prior=prior)
        assert errors(fixes, robot).max() < 2.5

    def test_it_waits_where_it_stands(self, field: Field, field_map: GridMap) -> None:
        """Wheels at rest: the fix stays to the last digit."""
        robot, speed = drive_through(CORNERS, field, np.random.default_rng(2))
        first = cut(robot.samples, seconds=20.0)[0]
        rest = standing(30.0, np.random.default_rng(3), at=first, gyro_offset=np.zeros(3))
        t = np.arange(first.t[0], rest.t[-1], 0.1)
        stopped = SpeedReadings(t, np.where(t < first.t[-1], speed.speed[0], 0.0))
        fixes = track(segments(chained(first, rest), speed=stopped), field_map)
        waiting = [fix for fix in fixes if fix.t > first.t[-1] + 1.0]
        assert len({(fix.x, fix.y, fix.cov_xx) for fix in waiting}) == 1


def test_a_counter_carries_a_walk_that_the_detector_misses(
    walk: SimulatedWalk, field: Field, field_map: GridMap
) -> None:
    muffled = replace(walk.samples, acc=np.tile([0.0, 0.0, 9.81], (len(walk.samples), 1)))
    t = np.arange(muffled.t[0], muffled.t[-1], 2.0)
    steps = StepCounts(t, np.floor(CADENCE_HZ * (t - muffled.t[0])))
    assert np.median(errors(track(segments(muffled), field_map), walk, 20.0)) > 8.0
    assert np.median(errors(track(segments(muffled, steps=steps), field_map), walk, 20.0)) < 2.0


class TestDisturbance:
    @staticmethod
    def beside_a_magnet(walk: SimulatedWalk, seconds: tuple[float, float]) -> ImuSamples:
        s = walk.samples
        near = (s.t - s.t[0] > seconds[0]) & (s.t - s.t[0] < seconds[1])
        return replace(s, mag=s.mag + 200.0 * near[:, None])

    def test_its_fixes_say_so_and_are_never_sure(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        fixes = track(segments(self.beside_a_magnet(walk, (30.0, 40.0))), field_map)
        t0 = walk.samples.t[0]
        told = [fix for fix in fixes if fix.status is Status.DISTURBED]
        assert {fix.t for fix in fixes if 34.0 < fix.t - t0 < 39.5} <= {fix.t for fix in told}
        assert not any(fix.sure for fix in told)
        assert min(fix.t for fix in told) - t0 > 30.0
        assert max(fix.t for fix in told) - t0 < 46.0

    def test_the_track_survives_it(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        fixes = track(segments(self.beside_a_magnet(walk, (30.0, 40.0))), field_map)
        assert errors(fixes, walk, 30.0).max() < 4.0
        assert errors(fixes, walk, 50.0).max() < 2.0
        assert fixes[-1].status is Status.OK

    @pytest.mark.parametrize("magnet", [(20.0, -15.0, 20.0), (80.0, 30.0, -30.0)])
    def test_a_magnet_that_stays_becomes_the_offset(
        self, walk: SimulatedWalk, field_map: GridMap, magnet: tuple[float, float, float]
    ) -> None:
        """Without that the fixes are sure and 8 m off."""
        s = walk.samples
        on = (s.t - s.t[0] > 25.0)[:, None]
        fixes = track(segments(replace(s, mag=s.mag + on * np.array(magnet))), field_map)
        assert errors(fixes, walk, 25.0).max() < 1.5
        assert fixes[-1].sure

    def test_the_trajectory_tells_where_it_was(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        pieces = segments(self.beside_a_magnet(walk, (20.0, 30.0)))
        smoothed = smooth_session(ParticleTracker(), PRIOR, pieces, OneMap(field_map), seed=1)
        told = [fix.t - walk.samples.t[0] for fix in smoothed if fix.status is Status.DISTURBED]
        assert 20.0 < min(told) < max(told) < 36.0

    def test_a_magnetic_start_does_not_decide_between_levels(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """A search leaves a disturbed step out of the likelihood."""
        grid = prepare_grid(field_map, FeatureSet.VECTOR)
        moved = step(grid, events(disturbed=True))
        assert moved.estimate.likelihood == 1.0

    @pytest.mark.parametrize(("share", "status"), [(0.4, Status.OK), (0.6, Status.DISTURBED)])
    def test_verdict(self, field_map: GridMap, share: float, status: Status) -> None:
        grid = prepare_grid(field_map, FeatureSet.VECTOR)
        cloud = initial_cloud(
            Prior("sim", 20.0, 10.0, 1.0), grid, np.ones(3), 200, InitialSpread(), np.random.default_rng(0)
        )
        integrity = Integrity(settled=True, disturbed=share, borne_out=True)
        verdict = judge(estimate_of(cloud, grid), integrity, IntegrityPolicy())
        assert verdict.status is status
        assert verdict.sure == (status is Status.OK)


def events(shift: float = 0.0, **flags: bool) -> StepEvents:
    """One step, due east, in a field that fits the middle of the map badly."""
    one = np.ones(1)
    told = {name: np.array([flags.get(name, False)]) for name in ("measured", "disturbed", "carrying")}
    mag = np.array([[200.0, 0.0, 0.0]])
    return StepEvents(one, 6.0 * one, 0.0 * one, 0.0 * one, mag, 0.7 * one, shift=shift * one, **told)


def start(grid: FilterGrid, n: int = 500) -> Cloud:
    prior = Prior("sim", 20.0, 10.0, 3.0, heading=0.0)
    return initial_cloud(prior, grid, np.array([30.0, 0.0, -30.0]), n, InitialSpread(), np.random.default_rng(0))


def step(grid: FilterGrid, one: StepEvents) -> Advance:
    rng = np.random.default_rng(1)
    return take_step(start(grid), grid, ParticleNoise(), InitialSpread(), one, 0, 0.0, rng)


class TestTakeStep:
    @pytest.fixture
    def grid(self, field_map: GridMap) -> FilterGrid:
        return prepare_grid(field_map, FeatureSet.VECTOR)

    def test_a_disturbed_step_moves_and_does_not_weigh(self, grid: FilterGrid) -> None:
        moved = step(grid, events(disturbed=True))
        assert moved.estimate.x == pytest.approx(20.7, abs=0.4)
        np.testing.assert_allclose(moved.weighted.p[14], 1 / 500, rtol=1e-3)
        np.testing.assert_allclose(moved.weighted.p[6:9], 0.0, atol=1e-3)
        assert not moved.cloud.moved
        weighed = step(grid, events())
        assert weighed.cloud.moved
        assert weighed.weighted.p[14].max() > 2 / 500

    def test_a_change_of_carrying_opens_angle_and_offset(self, grid: FilterGrid) -> None:
        cloud = start(grid, 5000)
        cloud.p[6:9], cloud.p[12:14], cloud.p[5] = 7.0, 0.5, 0.1
        x = cloud.p[0].copy()
        opened = loosen(cloud, InitialSpread(), np.random.default_rng(0))
        assert opened.p[5].std() == pytest.approx(0.5, abs=0.03)
        assert opened.p[5].mean() == pytest.approx(0.1, abs=0.03)
        np.testing.assert_allclose(opened.p[12:14], 5.5**2)
        np.testing.assert_array_equal(opened.p[6:9], 0.0)
        np.testing.assert_array_equal(opened.p[0], x)
        assert not opened.moved

    def test_wheels_spread_less_than_strides(self, grid: FilterGrid) -> None:
        stepped, driven = (step(grid, events(disturbed=True, measured=flag)) for flag in (False, True))
        before = start(grid).p
        ways = [np.std(m.weighted.p[0] - before[0]) for m in (stepped, driven)]
        assert ways[1] < 0.6 * ways[0]

    def test_wheels_leave_the_stride_scale(self, grid: FilterGrid) -> None:
        before = start(grid).p[4]
        moved = step(grid, events(disturbed=True, measured=True))
        np.testing.assert_allclose(moved.weighted.p[4], before, atol=0.06)
        assert moved.weighted.p[4].std() == pytest.approx(before.std(), rel=0.05)


@pytest.mark.parametrize("angles", [(-85.0, 20.0, 60.0), (70.0, 0.0, 20.0), (-60.0, 70.0, 100.0)])
def test_the_track_survives_the_way_into_a_pocket(
    field: Field, field_map: GridMap, angles: tuple[float, float, float]
) -> None:
    """Hard iron turns with the phone. Without a new offset it is 5 m off, without the old direction it is lost."""
    iron = np.array([12.0, -10.0, 8.0])
    walk = walk_through(CORNERS, field, np.random.default_rng(2), hard_iron=iron)
    turned = turning(walk.samples.t, float(walk.samples.t[0]) + 25.0, angles)
    pocket = held(walk.samples, turned)
    fixes = track(segments(replace(pocket, mag=pocket.mag - turned.inv().apply(iron) + iron)), field_map)
    assert errors(fixes, walk, 27.0).max() < 4.0
    assert np.median(errors(fixes, walk, 27.0)) < 0.6


class TestStanding:
    def test_the_fix_stays_and_its_ellipse_too(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """Two minutes at rest with a gyroscope that drifts, then on: no flicker, no false confidence, no bend."""
        first, *others = cut(walk.samples, seconds=25.0)
        rest = standing(120.0, np.random.default_rng(3), at=first, gyro_offset=np.array([0.004, -0.006, 0.012]))
        later = chained(*others)
        after = shifted(later, float(rest.t[-1]) + 0.02)
        fixes = track(segments(chained(first, rest, after)), field_map)
        still = [fix for fix in fixes if first.t[-1] + 1.0 < fix.t < rest.t[-1]]
        assert len(still) > 20
        assert len({(fix.x, fix.y, fix.cov_xx, fix.cov_yy, fix.sure) for fix in still}) == 1
        moved_on = [replace(fix, t=fix.t - (after.t[0] - later.t[0])) for fix in fixes if fix.t > after.t[0] + 5.0]
        assert np.median(errors(moved_on, walk)) < 1.0
        assert errors(moved_on, walk).max() < 2.5
