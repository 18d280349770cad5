from __future__ import annotations

import pytest

from app.services.errors import ConflictError, NotFoundError
from app.services.jobs import CANCELLED
from app.services.records import JobKind, JobState
from tests.support.builders import World, locate_result, new_segment


def test_a_queued_segment_is_cancelled_and_the_next_one_runs(world: World) -> None:
    session = world.session()
    jobs = [world.services.sessions.accept(session.id, new_segment(seq)).job for seq in range(2)]
    cancelled = world.services.jobs.cancel(jobs[0].id)
    assert (cancelled.state, cancelled.error) == (JobState.CANCELLED, CANCELLED)
    assert world.listener.finished == [cancelled]
    assert world.services.jobs.cancel(jobs[0].id) == cancelled
    assert world.listener.finished == [cancelled]
    segment = world.services.sessions.segment(session.id, 0)
    assert (segment.job_state, segment.error, segment.processed_at) == (
        JobState.CANCELLED,
        CANCELLED,
        cancelled.finished_at,
    )
    assert [job.subject["seq"] for job in world.services.processing.claim(9)] == [1]


def test_the_answer_to_a_cancelled_job_is_dropped(world: World) -> None:
    session = world.session()
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1)
    world.services.jobs.cancel(job.id)
    assert world.services.processing.complete_locate(job, locate_result(level_id=session.level_id)) is None
    assert world.services.sessions.positions(session.id).items == ()
    assert world.services.processing.retry(job).state is JobState.CANCELLED
    assert world.services.processing.fail(job, "late").state is JobState.CANCELLED


def test_a_finished_job_cannot_be_cancelled(world: World) -> None:
    session = world.session()
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1)
    world.services.processing.complete_locate(job, locate_result(level_id=session.level_id))
    with pytest.raises(ConflictError, match="done already"):
        world.services.jobs.cancel(job.id)
    assert world.services.jobs.get(job.id).state is JobState.DONE


def test_jobs_are_listed_by_kind_and_state(world: World) -> None:
    session = world.session()
    accepted = world.services.sessions.accept(session.id, new_segment(0)).job
    jobs = world.services.jobs
    assert jobs.list(kinds=(JobKind.LOCATE_SEGMENT,)).items == (accepted,)
    assert [job.kind for job in jobs.list(state=JobState.DONE).items] == [JobKind.BUILD_MAP]
    assert len(jobs.list().items) == 2
    with pytest.raises(NotFoundError):
        jobs.get("job_none")
    with pytest.raises(NotFoundError):
        jobs.cancel("job_none")
