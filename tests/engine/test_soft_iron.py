"""Soft iron: told by turning, never by going straight on, with errors as large as it says; and it makes the next
session better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from app.engine.calibration import Reading, SoftIron, next_session, remember, unknown_device, without_soft_iron
from app.engine.calibration.soft_iron import matrix
from app.engine.filtering import ParticleNoise, prepare_grid
from app.engine.localization.distortion import DistortionPolicy, learn
from app.engine.localization.integrity import Integrity
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import SessionState
from app.engine.types import DeviceCalibration, FeatureSet, Float64Array, GridMap, Prior, Segment
from tests.engine.conftest import OneMap
from tests.support.walks import Field, SimulatedWalk, cut, true_map, walk_through

TURNS = np.array(
    [[2, 2], [38, 2], [38, 18], [20, 18], [20, 8], [8, 16], [2, 28], [30, 28], [38, 22], [25, 5], [4, 5], [4, 24]],
    float,
)
STRAIGHT = np.array([[2.0, 6.0], [160.0, 6.0]])
ELEMENTS = np.array([0.07, -0.08, 0.05, 0.06, -0.05, 0.05])
STRONG = np.array([0.1, -0.1, 0.05, 0.08, 0.06, -0.06])
KNOWN_SD = (0.0112,) * 6


@pytest.fixture(scope="module")
def hall(field: Field) -> GridMap:
    return true_map(field, (0.0, 0.0, 42.0, 32.0))


def world_of(field: Field, seed: int) -> Field:
    """The field as it is, about a map of it that is off and noisy by what the map says."""
    rng = np.random.default_rng(500 + seed)
    return field.with_errors(Field.random(rng, sd=0.5, length_m=5.0), Field.random(rng, sd=1.0, length_m=2.0))


def session_of(
    walk: SimulatedWalk, hall: GridMap, known: DeviceCalibration | None = None, seed: int = 1
) -> tuple[SessionState, Float64Array]:
    """State at the end of a walk, handed from worker to worker, and errors of its fixes after 5 s, m."""
    tracker = ParticleTracker()
    x, y = walk.xy[0] + 0.5
    session, errors = SessionState(Prior("sim", x, y, 3.0, calibration=known), seed), []
    for samples in cut(walk.samples, seconds=5.0):
        for fix, _ in tracker.walk(session, Segment(samples), OneMap(hall)):
            errors.append(np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])))
        session = SessionState.decode(session.encode())
    return session, np.array(errors[10:])


def ended(session: SessionState) -> SoftIron:
    assert session.track is not None
    return session.track.soft_iron


def turning(field: Field, seed: int, elements: Float64Array, hard_iron: Float64Array | None = None) -> SimulatedWalk:
    rng = np.random.default_rng(seed)
    hard_iron = rng.normal(0, 4, 3) if hard_iron is None else hard_iron
    return walk_through(TURNS, field, rng, hard_iron=hard_iron, soft_iron=matrix(elements), carry=rng.normal(0, 0.1))


def readings(
    rng: np.random.Generator, elements: Float64Array, n: int = 150, *, headings: Float64Array | None = None
) -> list[Reading]:
    """Of a device whose heading is off by 0.1 rad and wanders, with noise of 2 uT and a hard iron of some uT."""
    hard_iron, variance = rng.normal(0, 4, 3), np.full(3, 4.0)
    headings = rng.uniform(-np.pi, np.pi, n) if headings is None else headings
    drift = 0.1 * rng.standard_normal() + np.cumsum(0.0075 * rng.standard_normal(n))
    made = []
    for heading, off in zip(headings, drift, strict=True):
        field = np.array([3.0, 30.0, -30.0]) + rng.normal(0, 4, 3)
        c, s = np.cos(heading + off), np.sin(heading + off)
        m = np.array([c * field[0] + s * field[1], c * field[1] - s * field[0], field[2]])
        measured = m + matrix(elements) @ m + hard_iron + np.sqrt(variance) * rng.standard_normal(3)
        made.append(Reading(measured, field, variance, float(heading), float(heading), 1.0))
    return made


def after(made: list[Reading], start: SoftIron | None = None) -> SoftIron:
    iron = SoftIron.start(None) if start is None else start
    for reading in made:
        iron = iron.observe(reading)
    return iron


def squared_error(iron: SoftIron, elements: Float64Array) -> float:
    """Normalized, six elements."""
    error = np.array(iron.elements) - elements
    return float(error @ np.linalg.solve(iron.cov[:6, :6], error))


def within_chi_square(values: list[float], degrees: int = 6) -> bool:
    low, high = chi2.ppf([0.005, 0.995], degrees * len(values))
    return bool(low < sum(values) < high)


class TestRegression:
    def test_errors_are_as_large_as_claimed(self) -> None:
        rng = np.random.default_rng(1)
        drawn = [0.04 * rng.standard_normal(6) for _ in range(60)]
        assert within_chi_square([squared_error(after(readings(rng, elements)), elements) for elements in drawn])

    def test_straight_on_it_cannot_be_told_from_hard_iron(self) -> None:
        iron = after(readings(np.random.default_rng(2), ELEMENTS, headings=np.full(150, 0.7)))
        assert not iron.is_excited()
        assert not iron.renewed().applied.any()

    def test_a_heading_that_is_off_is_not_soft_iron(self) -> None:
        """Nor is the angle that a phone is carried at: both turn the field, and soft iron does not."""
        made = readings(np.random.default_rng(3), np.zeros(6))
        turned = after([replace(reading, azimuth=reading.azimuth + 0.4) for reading in made])
        np.testing.assert_allclose(turned.elements, after(made).elements, atol=2e-3)
        assert not turned.is_significant()

    def test_outliers_count_for_less(self) -> None:
        made = readings(np.random.default_rng(4), ELEMENTS)
        made[50] = replace(made[50], measured=made[50].measured + 80.0)
        np.testing.assert_allclose(after(made).elements, after(made[:50] + made[51:]).elements, atol=0.005)

    def test_the_correction_takes_it_off(self) -> None:
        iron = after(readings(np.random.default_rng(5), STRONG, 2000)).renewed()
        field = np.random.default_rng(6).normal(0, 30, (50, 3))
        np.testing.assert_allclose(iron.correct(field + field @ matrix(STRONG)), field, atol=2.5)
        assert SoftIron.start(None).correct(field) is field

    def test_a_correction_is_kept_while_it_is_about_right(self) -> None:
        iron = after(readings(np.random.default_rng(7), STRONG, 400)).renewed()
        near = replace(iron, mean=iron.mean + 0.01).renewed()
        assert near.applied is iron.applied
        far = replace(iron, mean=iron.mean + 0.02).renewed()
        np.testing.assert_array_equal(far.applied, far.mean[:6])
        assert not replace(iron, mean=0.0 * iron.mean).renewed().applied.any()

    def test_a_gap_opens_the_heading_only(self) -> None:
        iron = after(readings(np.random.default_rng(8), ELEMENTS))
        again = iron.after_gap()
        assert (again.elements, again.sd, again.turned) == (iron.elements, iron.sd, None)
        assert not again.cov[9, :9].any()

    def test_a_magnet_that_came_to_stay_opens_the_hard_iron(self) -> None:
        rng = np.random.default_rng(9)
        before, magnet = readings(rng, ELEMENTS), np.array([30.0, -20.0, 10.0])
        later = [replace(reading, measured=reading.measured + magnet) for reading in before]
        iron = after(later, after(before).shifted(35.0))
        assert squared_error(iron, ELEMENTS) < chi2.ppf(0.99, 6)

    def test_what_is_known_of_a_device_counts_if_it_is_beyond_doubt(self) -> None:
        field, sure = np.ones((2, 3)), replace(unknown_device(), soft_iron=tuple(STRONG), soft_iron_sd=KNOWN_SD)
        np.testing.assert_allclose(without_soft_iron(field + field @ matrix(STRONG), sure), field)
        for known in (None, unknown_device(), replace(sure, soft_iron_sd=(0.03,) * 6)):
            assert without_soft_iron(field, known) is field


class TestInSessions:
    def test_it_is_recovered_and_taken_off(self, field: Field, hall: GridMap) -> None:
        iron = ended(session_of(turning(field, 3, ELEMENTS), hall)[0])
        assert iron.is_excited()
        assert max(iron.sd[k] for k in (0, 1, 3, 4, 5)) < 0.02
        np.testing.assert_array_less(np.abs(np.array(iron.elements) - ELEMENTS), 2.5 * np.array(iron.sd))
        np.testing.assert_allclose(iron.applied, ELEMENTS, atol=0.08)
        assert iron.applied.any()

    def test_errors_are_as_large_as_claimed(self, field: Field, hall: GridMap) -> None:
        """Maps that are off, hard iron, carrying angles and all: 20 sessions of 20 devices."""
        squared = []
        for seed in range(20):
            elements = 0.04 * np.random.default_rng(900 + seed).standard_normal(6)
            session, _ = session_of(turning(world_of(field, seed), seed, elements), hall)
            squared.append(squared_error(ended(session), elements))
        assert within_chi_square(squared)

    def test_a_corridor_does_not_tell(self, field: Field) -> None:
        rng = np.random.default_rng(4)
        walk = walk_through(STRAIGHT, field, rng, hard_iron=np.array([3.0, -2.0, 4.0]), soft_iron=matrix(ELEMENTS))
        iron = ended(session_of(walk, true_map(field, (0.0, 0.0, 165.0, 12.0)))[0])
        assert iron.turned is not None  # it was asked
        assert not iron.is_excited()
        assert not iron.applied.any()

    def test_without_any_nothing_changes(self, field: Field, hall: GridMap, monkeypatch: pytest.MonkeyPatch) -> None:
        walks = [turning(world_of(field, seed), seed, np.zeros(6)) for seed in range(3)]
        learned = [session_of(walk, hall)[1] for walk in walks]
        monkeypatch.setattr("app.engine.localization.particle.learn", lambda *_: None)
        for walk, errors in zip(walks, learned, strict=True):
            np.testing.assert_array_equal(errors, session_of(walk, hall)[1])

    def test_the_next_session_of_the_device_is_better(self, field: Field, hall: GridMap) -> None:
        """It begins corrected, and not only because it knows the hard iron.

        One of the four may stay in doubt: which it is depends on the last digits, and so on the processor.
        """
        first, second, offset_only, corrected = [], [], [], 0
        for seed in range(4):
            world, hard_iron = world_of(field, seed), np.random.default_rng(seed).normal(0, 4, 3)
            session, errors = session_of(turning(world, seed, STRONG, hard_iron), hall, seed=seed)
            assert session.track is not None
            memory = next_session(remember(unknown_device(), None, session.track.calibration()))
            again = turning(world, seed + 100, STRONG, hard_iron)
            corrected += int(SoftIron.start(memory).applied.any())
            blank = replace(memory, soft_iron=(0.0,) * 6, soft_iron_sd=unknown_device().soft_iron_sd)
            first.append(errors)
            second.append(session_of(again, hall, memory, seed)[1])
            offset_only.append(session_of(again, hall, blank, seed)[1])
        assert corrected >= 3
        pooled = [np.percentile(np.concatenate(errors), 90) for errors in (first, second, offset_only)]
        assert pooled[1] < 0.85 * pooled[0]
        assert pooled[1] < 0.9 * pooled[2]

    def test_state_and_memory_survive_storage(self, field: Field, hall: GridMap) -> None:
        session, _ = session_of(turning(field, 3, ELEMENTS), hall)
        iron, again = ended(session), ended(SessionState.decode(session.encode()))
        for name in ("mean", "cov", "applied"):
            np.testing.assert_array_equal(getattr(again, name), getattr(iron, name))
        assert again.turned == iron.turned
        known = session.track and session.track.calibration()
        assert known is not None
        assert (known.soft_iron, known.soft_iron_sd) == (iron.elements, iron.sd)
        begun = SessionState.decode(SessionState(Prior("sim", calibration=known), 1).encode())
        assert begun.prior.calibration == known

    @pytest.mark.parametrize("doubted", [False, True])
    def test_only_a_track_without_doubt_teaches(self, field: Field, hall: GridMap, *, doubted: bool) -> None:
        session, _ = session_of(turning(field, 3, ELEMENTS), hall)
        assert session.track is not None
        before = session.track.soft_iron
        session.track.integrity = Integrity(walked_m=99.0, settled=True, doubted=doubted, borne_out=True)
        session.track.trail = replace(session.track.trail, waiting=99)
        pause = walk_through(
            TURNS[-2:], field, np.random.default_rng(1), t0=float(session.pedestrian.tail.t[-1]) + 0.02
        )
        list(ParticleTracker().walk(session, Segment(cut(pause.samples, seconds=5.0)[0]), OneMap(hall)))
        assert (ended(session).mean is before.mean) == doubted

    def test_a_device_that_was_turned_is_another_one(self, field: Field, hall: GridMap) -> None:
        """Into the pocket: what was learned of it held level is no longer so."""
        walk = turning(field, 3, ELEMENTS)
        session, _ = session_of(walk, hall)
        track = session.track
        assert track is not None
        assert track.soft_iron.applied.any()
        events = replace(track.trail.events, carrying=np.ones(len(track.trail.events), dtype=np.bool_))
        track.integrity = replace(track.integrity, borne_out=False)
        grid = prepare_grid(hall, FeatureSet.VECTOR)
        learn(track, track.cloud, grid, events, 0, ParticleNoise(), DistortionPolicy())
        assert track.soft_iron.elements == (0.0,) * 6
        assert track.soft_iron.sd == pytest.approx(unknown_device().soft_iron_sd)
        assert not track.soft_iron.applied.any()
