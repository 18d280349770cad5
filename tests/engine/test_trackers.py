"""Contract of every tracker in the registry, and the honesty of the particle tracker on simulated walks."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.calibration import unknown_device
from app.engine.errors import InputError, StateError
from app.engine.inertial.steps import SETTLE_S
from app.engine.localization import METHODS, create_tracker
from app.engine.localization.integrity import CHI2_95
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.smoothing import smooth_session
from app.engine.types import FeatureSet, Fix, GridMap, Prior, Segment, Status, Tracker, TrackerState
from tests.engine.conftest import CORNERS, LevelMaps, OneMap
from tests.support.walks import Field, SimulatedWalk, cut, true_map, walk_through

PRIOR = Prior("sim", 2.5, 1.5, 3.0)


def track(
    tracker: Tracker,
    walk: SimulatedWalk,
    grid_map: GridMap | dict[str, GridMap],
    prior: Prior = PRIOR,
    *,
    seed: int = 1,
    seconds: float = 5.0,
) -> list[Fix]:
    source = LevelMaps(grid_map) if isinstance(grid_map, dict) else OneMap(grid_map)
    state = tracker.start(prior, seed=seed)
    fixes: list[Fix] = []
    for samples in cut(walk.samples, seconds=5.0):
        state, new = tracker.step(state, Segment(samples), source)
        fixes += new
    return fixes


def errors(fixes: list[Fix], walk: SimulatedWalk, after_s: float = 5.0) -> np.ndarray:
    late = [fix for fix in fixes if fix.t > walk.samples.t[0] + after_s]
    return np.array([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in late])


# Batch methods are served by one and the same tracker, and have a contract of their own: a few stand for all.
SERVED = ("magcom", "icm", "particle_swarm")


@pytest.fixture(params=[name for name, method in METHODS.items() if method.kind == "tracker" or name in SERVED])
def tracker(request: pytest.FixtureRequest) -> Tracker:
    return create_tracker(request.param)


class TestContract:
    def test_the_same_input_gives_the_same_answer(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap
    ) -> None:
        assert track(tracker, walk, field_map) == track(tracker, walk, field_map)

    def test_any_worker_may_take_the_next_segment(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap
    ) -> None:
        """State survives pickling and another instance; the answer does not depend on who computed the last one."""
        first, second = (Segment(s) for s in cut(walk.samples, seconds=5.0)[:2])
        state, _ = tracker.step(tracker.start(PRIOR, seed=1), first, OneMap(field_map))
        _, expected = tracker.step(state, second, OneMap(field_map))
        again = create_tracker(state.method)
        _, found = again.step(pickle.loads(pickle.dumps(state)), second, OneMap(field_map))
        assert found == expected

    def test_input_is_not_changed(self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap) -> None:
        segment = Segment(cut(walk.samples, seconds=5.0)[0])
        before = pickle.dumps(segment)
        mean = field_map.mean.copy()
        tracker.step(tracker.start(PRIOR, seed=1), segment, OneMap(field_map))
        assert pickle.dumps(segment) == before
        np.testing.assert_array_equal(field_map.mean, mean)

    def test_fixes_are_in_order_finite_and_reach_the_end(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap
    ) -> None:
        fixes = track(tracker, walk, field_map)
        times = [fix.t for fix in fixes]
        assert times == sorted(times)
        assert times[-1] == pytest.approx(walk.samples.t[-1] - SETTLE_S, abs=1e-6)
        for fix in fixes:
            assert np.isfinite([fix.x, fix.y, fix.cov_xx, fix.cov_xy, fix.cov_yy, fix.heading]).all()
            assert fix.cov_xx * fix.cov_yy > fix.cov_xy**2
            assert 0 <= fix.quality <= 1

    @pytest.mark.parametrize("n", [1, 2, 3])
    def test_a_segment_of_a_few_samples_is_taken(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap, n: int
    ) -> None:
        s = walk.samples
        tiny = Segment(type(s)(s.t[:n], s.mag[:n], s.acc[:n], s.gyro[:n]))
        _, fixes = tracker.step(tracker.start(PRIOR, seed=1), tiny, OneMap(field_map))
        assert len(fixes) == 1

    @pytest.mark.parametrize("features", list(FeatureSet))
    def test_maps_of_every_feature_set_serve(
        self, tracker: Tracker, walk: SimulatedWalk, field: Field, features: FeatureSet
    ) -> None:
        vector = true_map(field, (0.0, 0.0, 42.0, 22.0))
        planes = {
            FeatureSet.VECTOR: vector.mean,
            FeatureSet.HV: np.stack([np.hypot(vector.mean[0], vector.mean[1]), vector.mean[2]]),
            FeatureSet.TOTAL: np.linalg.norm(vector.mean, axis=0)[None],
        }[features]
        grid_map = GridMap(
            "sim", features, 0.0, 0.0, 0.5, planes, np.ones_like(planes), vector.support, 1.5, (1.0,) * len(planes)
        )
        fixes = track(tracker, walk, grid_map, Prior("sim", 2.0, 2.0, 1.0, heading=0.0, heading_sd=0.1))
        assert len(fixes) > 50

    def test_a_state_of_another_kind_is_refused(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap
    ) -> None:
        segment = Segment(cut(walk.samples, seconds=5.0)[0])
        state = tracker.start(PRIOR, seed=1)
        kind, payload = state.method, state.payload
        for bad in (
            TrackerState("other", payload),
            TrackerState(kind, b"\xc1"),
            TrackerState(kind, b""),
        ):
            with pytest.raises(StateError):
                tracker.step(bad, segment, OneMap(field_map))

    def test_rest_stays_where_it_is(self, tracker: Tracker, field: Field, field_map: GridMap) -> None:
        """A phone on a table gives one fix a segment, all in one place, and no shrinking ellipse."""
        n = 1000
        t = 1_700_000_000.0 + np.arange(n) / 50
        still = walk_through(np.array([[5.0, 5.0], [40.0, 5.0]]), field, np.random.default_rng(0)).samples
        zeros = np.zeros((n, 3))
        samples = type(still)(t, np.tile(still.mag[0], (n, 1)), np.tile([0.0, 0.0, 9.81], (n, 1)), zeros)
        fixes = track(tracker, SimulatedWalk(samples, zeros[:, :2], zeros[:, 0]), field_map)
        assert len(fixes) == 4
        assert len({(fix.x, fix.y, fix.cov_xx) for fix in fixes}) == 1


class TestRegistry:
    @pytest.mark.parametrize(
        ("method", "parameters", "field"),
        [
            ("nothing", {}, "method"),
            ("particle", {"nothing": 1}, "parameters.nothing"),
            ("particle", {"particles": "many"}, "parameters.particles"),
            ("particle", {"particles": True}, "parameters.particles"),
            ("particle", {"particles": 10}, "parameters.particles"),
            ("particle", {"particles": 1000.5}, "parameters.particles"),
            ("particle", {"particles": float("nan")}, "parameters.particles"),
            ("particle", {"features": "scent"}, "parameters.features"),
            ("dead_reckoning", {"stride_constant": 9}, "parameters.stride_constant"),
        ],
    )
    def test_what_cannot_be_is_named(self, method: str, parameters: dict, field: str) -> None:
        with pytest.raises(InputError) as error:
            create_tracker(method, parameters)
        assert error.value.field == field

    def test_parameters_arrive(self) -> None:
        made = create_tracker("particle", {"particles": 500, "features": "hv"})
        assert isinstance(made, ParticleTracker)
        assert made.parameters.particles == 500
        assert made.parameters.features is FeatureSet.HV

    def test_every_numeric_parameter_has_bounds(self) -> None:
        for method in METHODS.values():
            numeric = {
                name
                for name in method.parameters.__dataclass_fields__
                if isinstance(getattr(method.parameters(), name), int | float)
                and not isinstance(getattr(method.parameters(), name), bool)
            }
            assert numeric == set(method.bounds)


class TestParticleTracker:
    def test_dead_reckoning_goes_by_the_stride_of_a_known_device(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        prior = Prior("sim", *walk.xy[0], 0.5, heading=float(walk.heading[0]), heading_sd=0.05)
        tracker = create_tracker("dead_reckoning")
        tall = replace(unknown_device(), stride_scale=1.25)
        plain, known = (track(tracker, walk, field_map, replace(prior, calibration=c))[-1] for c in (None, tall))
        start = walk.xy[0]
        np.testing.assert_allclose(
            [known.x - start[0], known.y - start[1]], 1.25 * np.array([plain.x - start[0], plain.y - start[1]])
        )

    def test_it_beats_dead_reckoning(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """From a start three metres off: the map takes the error away, dead reckoning keeps it."""
        prior = Prior("sim", 2.0, 4.5, 3.0)
        ours = errors(track(create_tracker("particle"), walk, field_map, prior), walk, 20.0)
        plain = errors(track(create_tracker("dead_reckoning"), walk, field_map, prior), walk, 20.0)
        assert np.median(ours) < 1.0
        assert np.median(ours) < 0.5 * np.median(plain)

    def test_hard_iron_is_learned(self, field: Field, field_map: GridMap) -> None:
        iron = np.array([6.0, -5.0, 7.0])
        shifted = walk_through(CORNERS, field, np.random.default_rng(2), hard_iron=iron, carry=0.15)
        assert np.median(errors(track(create_tracker("particle"), shifted, field_map), shifted, 20.0)) < 1.2

    def test_the_claimed_ellipse_holds_the_truth(self, field: Field, field_map: GridMap) -> None:
        """Thirty simulated walks: the 95 % ellipse holds at least 90 % of fixes, and is not absurdly wide."""
        rng = np.random.default_rng(11)
        tracker = create_tracker("particle", {"particles": 1000})
        inside, wide = [], []
        for i in range(30):
            corners = CORNERS[: int(rng.integers(3, 7))]
            w = walk_through(corners, field, rng, hard_iron=rng.normal(0, 3, 3), carry=rng.normal(0, 0.1))
            start = w.xy[0] + rng.uniform(-1.5, 1.5, 2)
            for fix in track(tracker, w, field_map, Prior("sim", *start, 3.0), seed=i)[10:]:
                d = w.at(fix.t) - [fix.x, fix.y]
                cov = np.array([[fix.cov_xx, fix.cov_xy], [fix.cov_xy, fix.cov_yy]])
                inside.append(d @ np.linalg.solve(cov, d) <= CHI2_95)
                wide.append(np.sqrt(np.linalg.eigvalsh(cov)[-1]))
        assert np.mean(inside) > 0.9
        assert np.median(wide) < 3.0

    def test_the_answer_moves_with_the_map(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        g = field_map
        shifted = GridMap(
            g.level_id, g.features, g.x0 + 64.0, g.y0 - 32.0, g.cell_m, g.mean, g.sd, g.support, g.mapped_m, g.noise_sd
        )
        here = track(create_tracker("particle"), walk, g)
        there = track(create_tracker("particle"), walk, shifted, Prior("sim", 2.5 + 64.0, 1.5 - 32.0, 3.0))
        moved = np.array([[b.x - a.x, b.y - a.y] for a, b in zip(here, there, strict=True)])
        # single precision rounds differently elsewhere, so particles part ways slowly; the place stays the same
        np.testing.assert_allclose(np.median(moved, axis=0), [64.0, -32.0], atol=0.3)

    def test_unmapped_ground_neither_draws_nor_repels(self, field: Field) -> None:
        """Only a strip far from the walk is mapped: the track must stay where dead reckoning puts it, and say so."""
        full = true_map(field, (0.0, 0.0, 42.0, 60.0))
        far = np.broadcast_to(np.arange(full.shape[0])[:, None] * 0.5 > 30.0, full.shape)
        level = full.mean[:, far].mean(axis=1)[:, None, None]
        grid_map = GridMap(
            "sim", full.features, 0.0, 0.0, 0.5,
            np.where(far, full.mean, level).astype(np.float32), np.where(far, 0.5, 5.0).repeat(1)
            .reshape(full.shape)[None].repeat(3, 0).astype(np.float32),
            np.where(far, 0.0, 50.0).astype(np.float32), 1.5, (1.0,) * 3,
        )  # fmt: skip
        prior = Prior("sim", 2.0, 2.0, 1.0, heading=0.0, heading_sd=0.05)
        there = walk_through(CORNERS[:4], field, np.random.default_rng(2))
        fixes = track(create_tracker("particle"), there, grid_map, prior)
        blank = np.full_like(grid_map.mean, 30.0)
        nothing = replace(grid_map, sd=blank, support=blank[0])
        plain = track(create_tracker("particle"), there, nothing, prior)
        assert np.median(errors(fixes, there)) < 1.5 * np.median(errors(plain, there)) + 0.5
        assert np.mean([fix.y > 27.0 for fix in fixes]) < 0.1
        assert np.mean([fix.status is Status.OFF_MAP for fix in fixes[20:]]) > 0.7
        assert not any(fix.sure for fix in fixes[20:])

    def test_an_unknown_start_claims_nothing_at_first(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        first = track(create_tracker("particle"), walk, field_map, Prior("sim"))[0]
        assert first.status is Status.INSUFFICIENT
        assert not first.sure
        assert first.walk_on_m is not None
        assert first.walk_on_m > 0

    def test_an_unknown_start_is_found(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """Places are listed until one stands out; what is claimed from then on is right."""
        fixes = track(create_tracker("particle"), walk, field_map, Prior("sim"))
        away = errors(fixes, walk, 0.0)
        found = [fix.status is Status.OK for fix in fixes]
        first = found.index(True)
        assert {fix.status for fix in fixes[:first]} <= {Status.INSUFFICIENT, Status.AMBIGUOUS}
        assert not any(fix.sure for fix in fixes[:first])
        assert away[first:].max() < 4.0
        assert any(fix.sure for fix in fixes)
        for fix in fixes:
            weights = [h.weight for h in fix.hypotheses]
            assert weights == sorted(weights, reverse=True)
            assert sum(weights) <= 1.0 + 1e-6
            if weights:
                assert (fix.x, fix.y, fix.level_id) == (
                    fix.hypotheses[0].x, fix.hypotheses[0].y, fix.hypotheses[0].level_id,
                )  # fmt: skip
        assert any(fix.hypotheses for fix in fixes[:first])

    def test_the_level_is_found(self, walk: SimulatedWalk, field: Field) -> None:
        """Of several levels, the one whose field the walk shows."""
        maps = {
            "other": true_map(Field.random(np.random.default_rng(77)), (0.0, 0.0, 42.0, 22.0), level_id="other"),
            "sim": true_map(field, (0.0, 0.0, 42.0, 22.0)),
        }
        fixes = track(create_tracker("particle"), walk, maps, Prior(None))
        assert fixes[-1].status is Status.OK
        assert fixes[-1].level_id == "sim"
        assert errors(fixes, walk, 0.0)[-1] < 3.0

    def test_at_rest_nothing_flickers(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """A walker who stands still while the place is searched gets the same answer again and again."""
        tracker = create_tracker("particle")
        state = tracker.start(Prior("sim"), seed=3)
        pieces = cut(walk.samples, seconds=5.0)
        state, _ = tracker.step(state, Segment(pieces[0]), OneMap(field_map))
        still = pieces[1]
        still = replace(still, acc=np.tile(still.acc.mean(axis=0), (len(still), 1)), gyro=np.zeros_like(still.gyro))
        places = set()
        for k in range(3):
            later = replace(still, t=still.t + 5.0 * k)
            state, fixes = tracker.step(state, Segment(later), OneMap(field_map))
            places.add((fixes[-1].x, fixes[-1].y))
        assert len(places) == 1

    def test_walls_hold(self, field: Field) -> None:
        """With a wall beside the corridor, particles stay inside it."""
        grid_map = true_map(field, (0.0, 0.0, 42.0, 12.0))
        y = np.arange(grid_map.shape[0])[:, None] * 0.5
        depth = np.maximum(np.abs(y - 6.0) - 1.0, 0.0) * np.ones(grid_map.shape)
        blind = np.full(grid_map.mean.shape, 30.0, dtype=np.float32)
        walled = GridMap(
            "sim", grid_map.features, 0.0, 0.0, 0.5, grid_map.mean, blind, grid_map.support, 1.5, (30.0,) * 3,
            depth.astype(np.float32),
        )  # fmt: skip
        straight = walk_through(np.array([[2.0, 6.0], [40.0, 6.0]]), field, np.random.default_rng(0), carry=0.2)
        fixes = track(create_tracker("particle"), straight, walled, Prior("sim", 2.0, 6.0, 1.0, heading=0.2))
        assert max(abs(fix.y - 6.0) for fix in fixes) < 1.2


class TestGaps:
    """A phone sleeps between two segments while its owner walks on."""

    @staticmethod
    def after_gap(tracker: Tracker, walk: SimulatedWalk, grid_map: GridMap, gap_s: float) -> list[Fix]:
        """Fixes after ``gap_s`` of the walk were not sent (as much of it as there is; the clock runs on)."""
        pieces = cut(walk.samples, seconds=5.0)
        skipped = min(int(gap_s // 5.0), 8)
        late = gap_s - 5.0 * skipped
        state = tracker.start(PRIOR, seed=1)
        for samples in pieces[:4]:
            state, _ = tracker.step(state, Segment(samples), OneMap(grid_map))
        fixes: list[Fix] = []
        for samples in pieces[4 + skipped : 10 + skipped]:
            delayed = replace(samples, t=samples.t + late)
            state, new = tracker.step(state, Segment(delayed), OneMap(grid_map))
            fixes += [replace(fix, t=fix.t - late) for fix in new]
        return fixes

    def test_what_was_not_watched_is_not_claimed(
        self, tracker: Tracker, walk: SimulatedWalk, field_map: GridMap
    ) -> None:
        spreads = []
        for gap_s in (10.0, 30.0):
            fixes = self.after_gap(tracker, walk, field_map, gap_s)
            assert not fixes[0].sure
            assert all(np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) < 4.0 for fix in fixes if fix.sure)
            inside = []
            for fix in fixes:
                d = walk.at(fix.t) - [fix.x, fix.y]
                cov = np.array([[fix.cov_xx, fix.cov_xy], [fix.cov_xy, fix.cov_yy]])
                inside.append(d @ np.linalg.solve(cov, d) <= CHI2_95)
            assert np.mean(inside) > 0.85
            spreads.append(fixes[0].cov_xx + fixes[0].cov_yy)
        assert spreads[1] > 2.0 * spreads[0] > 20.0

    def test_a_short_gap_is_bridged(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        fixes = self.after_gap(create_tracker("particle"), walk, field_map, 2.0)
        assert np.median(errors(fixes, walk, 0.0)) < 2.5
        assert fixes[-1].status is Status.OK

    @pytest.mark.parametrize("gap_s", [600.0, 1e9])
    def test_after_a_long_gap_the_session_starts_anew(
        self, walk: SimulatedWalk, field_map: GridMap, gap_s: float
    ) -> None:
        fixes = self.after_gap(create_tracker("particle"), walk, field_map, gap_s)
        assert fixes[0].status is Status.INSUFFICIENT
        assert not any(fix.sure for fix in fixes[:10])
        assert errors(fixes, walk, 0.0)[[fix.status is Status.OK for fix in fixes]].max(initial=0.0) < 4.0

    def test_a_gap_does_not_turn_the_heading(self, walk: SimulatedWalk, field_map: GridMap) -> None:
        """The gyroscope's last rate must not be integrated over the gap."""
        s = walk.samples
        first, second = cut(s, seconds=10.0)[:2]
        spun = replace(second, t=second.t + 4.0, gyro=second.gyro.copy())
        spun.gyro[0, 2] = 2.0
        tracker = create_tracker("particle")
        state, _ = tracker.step(tracker.start(PRIOR, seed=1), Segment(first), OneMap(field_map))
        _, fixes = tracker.step(state, Segment(spun), OneMap(field_map))
        assert fixes[-1].status is Status.OK


def test_smoothing_beats_tracking(walk: SimulatedWalk, field_map: GridMap) -> None:
    """With samples of both sides in time, the early part of a track from a poor start becomes good."""
    segments = [Segment(samples) for samples in cut(walk.samples, seconds=5.0)]
    prior = Prior("sim", 2.0, 4.5, 3.0)
    tracker = ParticleTracker()
    smooth = smooth_session(tracker, prior, segments, OneMap(field_map), seed=1)
    causal = track(tracker, walk, field_map, prior)
    early = walk.samples.t[0] + 10.0
    before = errors([fix for fix in causal if fix.t < early], walk, 0.0)
    after = errors([fix for fix in smooth if fix.t < early], walk, 0.0)
    assert np.mean(after) < np.mean(before)
    assert np.median(errors(list(smooth), walk, 0.0)) < 1.0
    assert smooth_session(tracker, prior, [], OneMap(field_map), seed=1) == ()


def test_smoothing_does_not_follow_particles_across_a_gap(walk: SimulatedWalk, field_map: GridMap) -> None:
    """Nobody knows where a walker went meanwhile: what comes after a gap says nothing about what came before."""
    pieces = cut(walk.samples, seconds=10.0)[:2]
    prior = Prior("sim", 2.0, 4.5, 3.0)
    tracker, source = ParticleTracker(), OneMap(field_map)
    alone = smooth_session(tracker, prior, [Segment(pieces[0])], source, seed=1)
    for gap_s in (4.0, 600.0):
        later = replace(pieces[1], t=pieces[1].t + gap_s)
        both = smooth_session(tracker, prior, [Segment(pieces[0]), Segment(later)], source, seed=1)
        assert both[: len(alone)] == alone
        assert len(both) > len(alone)
        assert (np.diff([fix.t for fix in both]) > 0).all()
