"""Smoothed trajectories: which segments go to the worker, and what is refused before."""

from __future__ import annotations

import pytest

from app.engine.types import Progress
from app.services import stored_segments
from app.services.errors import NotFoundError, NotSmoothableError
from app.services.ids import seed_of
from app.services.ports import WorkerLostError
from app.services.records import JobKind, JobState
from app.services.tasks import SmoothResult, SmoothSpec
from app.services.trajectories import TrajectoryService
from tests.support.builders import T0, CallingExecutor, World, answer_smooth, locate_result, new_segment


class Worker:
    """A task that remembers its specs and loses its worker a number of times."""

    def __init__(self, losses: int = 0) -> None:
        self.losses = losses
        self.specs: list[SmoothSpec] = []

    def __call__(self, spec: SmoothSpec, progress: Progress) -> SmoothResult:
        self.specs.append(spec)
        if len(self.specs) <= self.losses:
            raise WorkerLostError
        return answer_smooth(spec, progress)


def _service(world: World, worker: Worker) -> TrajectoryService:
    return TrajectoryService(
        uow=world.database, clock=world.clock, executor=CallingExecutor(), cache=world.cache, task=worker
    )


def _processed(world: World, *states: JobState) -> str:
    """A session whose segments went these ways."""
    session = world.session()
    processing = world.services.processing
    for seq, state in enumerate(states):
        accepted = world.services.sessions.accept(session.id, new_segment(seq))
        if state is JobState.QUEUED:
            continue
        (job,) = processing.claim(1, JobKind.LOCATE_SEGMENT)
        assert job.id == accepted.job.id
        if state is JobState.DONE:
            processing.complete_locate(job, locate_result(seq, level_id=session.level_id))
        else:
            processing.fail(job, "no")
    return session.id


def test_all_processed_segments_are_smoothed_at_once_and_nothing_is_stored(world: World) -> None:
    session_id = _processed(world, JobState.DONE, JobState.FAILED, JobState.DONE, JobState.QUEUED)
    session, worker, before = world.services.sessions.get(session_id), Worker(), world.services.stats.stats()
    answer = _service(world, worker).trajectory(session_id)
    (spec,) = worker.specs
    assert (spec.method, spec.parameters, spec.prior) == ("particle", session.parameters, session.prior)
    assert spec.seed == seed_of(session_id)
    assert [ref.hash for ref in spec.maps] == [world.services.maps.get(session.maps[0].map_id).hash]
    assert [segment.samples.t[0] for segment in spec.segments] == [T0, T0 + 10.0]
    assert (answer.session_id, answer.level_id, answer.method) == (session_id, session.level_id, "particle")
    assert answer.maps == session.maps
    assert [fix.t for fix in answer.fixes] == [T0, T0 + 10.0]
    assert world.services.stats.stats() == before


def test_the_map_is_the_one_the_session_was_opened_with(world: World) -> None:
    session_id, worker = _processed(world, JobState.DONE), Worker()
    session = world.services.sessions.get(session_id)
    world.build(session.level_id, seed=1)
    assert _service(world, worker).trajectory(session_id).maps == session.maps
    assert worker.specs[0].maps[0].hash == world.services.maps.get(session.maps[0].map_id).hash


def test_a_session_in_a_venue_is_smoothed_on_all_its_maps(world: World) -> None:
    venue_id, levels = world.venue(0, 1)
    session, worker = world.services.sessions.create(None, "particle", {}, venue_id=venue_id), Worker()
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    world.services.processing.complete_locate(job, locate_result(0, level_id=levels[1].id))
    answer = _service(world, worker).trajectory(session.id)
    assert (answer.level_id, answer.maps) == (None, session.maps)
    assert worker.specs[0].prior.level_id is None
    assert [ref.level_id for ref in worker.specs[0].maps] == [level.id for level in levels]


def test_a_session_without_processed_segments_has_no_fixes(world: World) -> None:
    worker = Worker()
    assert _service(world, worker).trajectory(_processed(world, JobState.QUEUED)).fixes == ()
    assert worker.specs == []


def test_a_lost_worker_is_tried_once_more(world: World) -> None:
    session_id = _processed(world, JobState.DONE)
    assert _service(world, Worker(losses=1)).trajectory(session_id).fixes
    with pytest.raises(WorkerLostError):
        _service(world, Worker(losses=2)).trajectory(session_id)


def test_what_cannot_be_smoothed_is_refused_before_a_worker_sees_it(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = Worker()
    smooth = _service(world, worker).trajectory
    with pytest.raises(NotFoundError):
        smooth("ses_none")
    session_id = _processed(world, JobState.DONE, JobState.DONE)
    level_id = world.services.sessions.get(session_id).level_id
    other = world.services.sessions.create(level_id, "dead_reckoning", {})
    with pytest.raises(NotSmoothableError, match="dead_reckoning") as caught:
        smooth(other.id)
    assert caught.value.field == "method"
    monkeypatch.setattr(stored_segments, "MAX_SEGMENTS", 1)
    with pytest.raises(NotSmoothableError, match="2 segments") as caught:
        smooth(session_id)
    assert caught.value.field == "session_id"
    monkeypatch.setattr(stored_segments, "MAX_SEGMENTS", 2)
    monkeypatch.setattr(stored_segments, "MAX_SPAN_S", 9.0)
    with pytest.raises(NotSmoothableError, match="minutes of samples"):
        smooth(session_id)
    assert worker.specs == []
    monkeypatch.setattr(stored_segments, "MAX_SPAN_S", 10.0)
    assert smooth(session_id).fixes


def test_the_bound_is_half_an_hour_of_usual_segments() -> None:
    assert (stored_segments.MAX_SEGMENTS, stored_segments.MAX_SPAN_S) == (360, 1800.0)
