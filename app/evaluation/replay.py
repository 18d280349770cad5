"""Replay and score walks of one level: the unit of work that is handed to a pool."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from app.engine.errors import EngineError
from app.engine.inertial import detect_steps
from app.engine.types import DeviceCalibration, Fix, GridMap, Tracker
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.drivers import Driver, EngineDriver, GridMaps, Smoother
from app.evaluation.metrics import interpolate_fixes, score_steps
from app.evaluation.protocol import Aids, Scenario, Trip, make_trip
from app.evaluation.results import BASELINE, Dropped, ScoredTrack, WalkResult
from app.evaluation.truth import MIN_STEPS, SurveyedArea, truth_at_steps

CreateTracker = Callable[[str, Mapping[str, object]], Tracker]
Smooth = Callable[[Trip], Sequence[Fix] | None]


@dataclass(frozen=True, slots=True)
class Job:
    """Walks of one level, and how they are replayed. Truth stays on this side of the driver.

    ``level_id`` and ``venue_id`` are what the driver calls the level and its building (names in the engine, ids in a
    service).
    """

    level: str
    level_id: str
    venue_id: str
    walks: tuple[RecordedWalk, ...]
    area: SurveyedArea
    scenario: Scenario
    aids: Aids
    repeat: int
    calibration: DeviceCalibration | None = None
    """What is known of the walks' device before they begin."""


@dataclass(frozen=True, slots=True)
class EngineJob:
    """A job for the engine; pickles, if ``create_tracker`` and ``smoother`` are module-level functions."""

    job: Job
    maps: Mapping[str, GridMap]
    method: str
    parameters: Mapping[str, object]
    create_tracker: CreateTracker
    smoother: Smoother | None = None


Results = tuple[WalkResult | Dropped, ...]


def replay_in_engine(work: EngineJob) -> Results:
    """Replay the walks through the engine, with dead reckoning and the smoothed track beside them."""
    maps = GridMaps(work.maps)
    tracker = work.create_tracker(work.method, work.parameters)
    smoother = work.smoother
    smooth = None if smoother is None else lambda trip: smoother(tracker, trip, maps)
    baseline = EngineDriver(work.create_tracker(BASELINE, {}), maps)
    return replay_walks(work.job, EngineDriver(tracker, maps), baseline, smooth)


def replay_walks(
    job: Job,
    driver: Driver,
    baseline: Driver | None,
    smooth: Smooth | None = None,
) -> Results:
    """Replay and score the walks of a job, in its order."""
    return tuple(_replay_walk(job, walk, driver, baseline, smooth) for walk in job.walks)


def _replay_walk(
    job: Job,
    walk: RecordedWalk,
    driver: Driver,
    baseline: Driver | None,
    smooth: Smooth | None,
) -> WalkResult | Dropped:
    truth = truth_at_steps(detect_steps(walk.samples), walk.waypoints, even_pace=walk.even_pace)
    if len(truth) < MIN_STEPS:
        return Dropped(job.level, walk.walk_id, f"{len(truth)} steps, fewer than {MIN_STEPS}")
    trip = make_trip(walk, job.level_id, job.scenario, venue_id=job.venue_id, aids=job.aids, repeat=job.repeat)
    trip = replace(trip, prior=replace(trip.prior, calibration=job.calibration))
    if not trip.segments:
        return Dropped(job.level, walk.walk_id, "no samples after the first label")

    def scored(fixes: Sequence[Fix]) -> ScoredTrack:
        scores = score_steps(truth, fixes, start_t=trip.start_t, level_id=trip.level_id, prior=trip.prior)
        return ScoredTrack(tuple(fixes), scores)

    if not len(scored(()).scores):
        return Dropped(job.level, walk.walk_id, "no step after the first seconds")
    replay = driver.replay(trip)
    result = WalkResult(
        walk_id=walk.walk_id,
        level=job.level,
        level_id=job.level_id,
        covered_share=job.area.share_covered(truth),
        length_m=walk.path_length_m,
        start_t=trip.start_t,
        end_t=float(trip.segments[-1].samples.t[-1]),
        prior=trip.prior,
        waypoints=walk.waypoints,
        truth=truth,
        causal=scored(replay.fixes),
        n_segments=len(trip.segments),
        segment_s=replay.segment_s,
        failures=replay.failures,
    )
    if baseline and result.prior.x is not None:  # else it has nothing to start from
        result = replace(result, baseline=scored(baseline.replay(trip).fixes))
    return _with_smoothed(result, trip, smooth, scored) if smooth else result


def _with_smoothed(
    result: WalkResult, trip: Trip, smooth: Smooth, scored: Callable[[Sequence[Fix]], ScoredTrack]
) -> WalkResult:
    try:
        fixes = smooth(trip)
    except EngineError as error:
        return replace(result, failures=(*result.failures, f"smoothing: {error}"))
    if fixes is None:
        return result
    scores = scored(interpolate_fixes(fixes, result.truth.t)).scores
    return replace(result, smoothed=ScoredTrack(tuple(fixes), scores))


def aids_change_answers(work: EngineJob) -> bool:
    """Whether the method's answers change when it gets the walks' readings.

    Asked of the method itself, by replaying the job's walks with and without: a report must not claim an aid that
    was only carried along.
    """
    driver = EngineDriver(work.create_tracker(work.method, work.parameters), GridMaps(work.maps))
    for walk in work.job.walks:
        answers = [
            driver.replay(
                make_trip(walk, work.job.level_id, work.job.scenario, aids=aids, repeat=work.job.repeat)
            ).fixes
            for aids in (Aids(), work.job.aids)
        ]
        if answers[0] != answers[1]:
            return True
    return False
