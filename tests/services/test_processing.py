"""From claim to result: exactly once in effect, in order, across crashes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from app.engine.types import FixKind
from app.services.ids import seed_of
from app.services.processing import MAX_ATTEMPTS
from app.services.records import Job, JobState
from app.services.tasks import LocateResult
from tests.support.builders import World, locate_result, new_segment


def _accepted(world: World, n: int = 1) -> str:
    session = world.session()
    for seq in range(n):
        world.services.sessions.accept(session.id, new_segment(seq))
    return session.id


def _claim(world: World) -> Job:
    (job,) = world.services.processing.claim(9)
    return job


def _result(world: World, job: Job) -> LocateResult:
    session = world.services.sessions.get(str(job.subject["session_id"]))
    return locate_result(int(job.subject["seq"]), level_id=session.level_id)


def _n_positions(world: World, session_id: str) -> int:
    return len(world.services.sessions.positions(session_id).items)


def test_a_spec_carries_all_a_worker_needs(world: World) -> None:
    session_id = _accepted(world, 2)
    processing = world.services.processing
    job = _claim(world)
    spec = processing.locate_spec(job)
    session = world.services.sessions.get(session_id)
    assert (spec.method, spec.prior, spec.state) == ("particle", session.prior, None)
    assert spec.seed == seed_of(session_id)
    (ref,) = spec.maps
    assert ref.hash == world.services.maps.get(session.maps[0].map_id).hash
    assert ref.path.exists()
    result = _result(world, job)
    processing.complete_locate(job, result)
    following = processing.locate_spec(_claim(world))
    assert following.state == result.state
    assert following.seed == spec.seed


def test_a_result_is_stored_with_its_job(world: World) -> None:
    session_id = _accepted(world)
    job = _claim(world)
    done = world.services.processing.complete_locate(job, _result(world, job))
    assert done is not None
    assert (done.state, done.result["n_fixes"]) == (JobState.DONE, 3)
    assert world.services.jobs.get(job.id) == done
    segment = world.services.sessions.segment(session_id, 0)
    assert (segment.job_state, segment.processed_at) == (JobState.DONE, done.finished_at)
    assert _n_positions(world, session_id) == 3


def test_what_is_told_later_is_stored_with_the_rest_or_not_at_all(world: World) -> None:
    session_id = _accepted(world, 2)
    processing, sessions = world.services.processing, world.services.sessions
    processing.complete_locate(job := _claim(world), _result(world, job))
    job = _claim(world)
    told = locate_result(1, n_lagged=2, level_id=sessions.get(session_id).level_id or "")
    broken = replace(told, state=None)  # type: ignore[arg-type]
    with pytest.raises(AttributeError):
        processing.complete_locate(job, broken)
    assert sessions.positions(session_id, kind=FixKind.FIXED_LAG).items == ()
    for _ in range(2):
        processing.complete_locate(job, told)
    positions = sessions.positions(session_id, kind=FixKind.FIXED_LAG).items
    assert tuple(position.fix for position in positions) == told.lagged
    assert {position.seq for position in positions} == {1}
    result = sessions.result(session_id, 1)
    assert (result.segment, result.fixes, result.lagged) == (sessions.segment(session_id, 1), told.fixes, told.lagged)


def test_a_position_told_later_that_is_not_finite_fails_the_segment(world: World) -> None:
    session_id = _accepted(world)
    told = locate_result(0, n_lagged=2)
    broken = replace(told, lagged=(told.lagged[0], replace(told.lagged[1], cov_xx=math.inf)))
    failed = world.services.processing.complete_locate(_claim(world), broken)
    assert failed is not None
    assert failed.state is JobState.FAILED
    assert _n_positions(world, session_id) == 0


def test_the_same_result_twice_counts_once(world: World) -> None:
    session_id = _accepted(world)
    job = _claim(world)
    assert world.services.processing.complete_locate(job, _result(world, job)) is not None
    before = world.services.jobs.get(job.id)
    assert world.services.processing.complete_locate(job, _result(world, job)) is None
    assert world.services.jobs.get(job.id) == before
    assert _n_positions(world, session_id) == 3


def test_a_result_that_cannot_be_stored_leaves_the_job_running(world: World) -> None:
    session_id = _accepted(world)
    job = _claim(world)
    broken = replace(_result(world, job), state=None)  # type: ignore[arg-type]
    with pytest.raises(AttributeError):
        world.services.processing.complete_locate(job, broken)
    assert world.services.jobs.get(job.id).state is JobState.RUNNING
    assert _n_positions(world, session_id) == 0
    assert world.services.processing.complete_locate(job, _result(world, job)) is not None


def test_segments_of_a_session_run_in_order_and_sessions_in_parallel(world: World) -> None:
    one, other = _accepted(world, 3), _accepted(world, 1)
    claimed = world.services.processing.claim(9)
    assert [(job.order_key, job.subject["seq"]) for job in claimed] == [(one, 0), (other, 0)]
    assert world.services.processing.claim(9) == ()
    world.services.processing.complete_locate(claimed[0], _result(world, claimed[0]))
    assert _claim(world).subject == {"session_id": one, "seq": 1}


def test_a_crash_between_claim_and_result_loses_nothing(tmp_path: Path) -> None:
    before = World.at(tmp_path)
    session_id = _accepted(before, 2)
    lost = _claim(before)
    # the process dies here: nothing is closed or given back
    after = World.at(tmp_path)
    assert after.services.processing.recover() == 1
    assert after.services.processing.recover() == 0
    again = _claim(after)
    assert (again.id, again.attempts) == (lost.id, 2)
    done = after.services.processing.complete_locate(again, _result(after, again))
    assert done is not None
    assert _claim(after).subject["seq"] == 1
    # the dead process's answer, should it still arrive, is dropped
    assert before.services.processing.complete_locate(lost, _result(before, lost)) is None
    assert _n_positions(after, session_id) == 3
    before.close()
    after.close()


def test_a_late_answer_of_a_lost_worker_is_dropped(world: World) -> None:
    session_id = _accepted(world)
    first = _claim(world)
    assert world.services.processing.retry(first).state is JobState.QUEUED
    second = _claim(world)
    assert second.attempts == 2
    assert world.services.processing.complete_locate(first, _result(world, first)) is None
    assert world.services.processing.retry(first).state is JobState.RUNNING  # of the second attempt, undisturbed
    assert world.services.processing.fail(first, "late").state is JobState.RUNNING
    assert _n_positions(world, session_id) == 0
    assert world.services.processing.complete_locate(second, _result(world, second)) is not None
    assert _n_positions(world, session_id) == 3


def test_a_job_that_kills_its_workers_is_given_up(world: World) -> None:
    session_id = _accepted(world, 2)
    for attempt in range(1, MAX_ATTEMPTS + 1):
        job = _claim(world)
        assert job.attempts == attempt
        after = world.services.processing.retry(job)
    assert after.state is JobState.FAILED
    assert after.error == "the worker died in each of 3 attempts"
    assert world.services.sessions.segment(session_id, 0).error == after.error
    assert _claim(world).subject["seq"] == 1


def test_after_a_failed_segment_the_session_goes_on_with_its_state(world: World) -> None:
    session_id = _accepted(world, 3)
    processing = world.services.processing
    first = _claim(world)
    processing.complete_locate(first, _result(world, first))
    failed = processing.fail(_claim(world), "InputError: mag")
    assert (failed.state, failed.error) == (JobState.FAILED, "InputError: mag")
    segment = world.services.sessions.segment(session_id, 1)
    assert (segment.job_state, segment.error) == (JobState.FAILED, "InputError: mag")
    assert segment.processed_at == failed.finished_at
    third = _claim(world)
    assert processing.locate_spec(third).state == _result(world, first).state
    processing.complete_locate(third, _result(world, third))
    positions = world.services.sessions.positions(session_id).items
    assert [position.number for position in positions] == list(range(6))
    assert {position.seq for position in positions} == {0, 2}


@pytest.mark.parametrize("field", ["x", "cov_xy", "heading", "walk_on_m"])
def test_a_position_that_is_not_finite_fails_the_segment_only(world: World, field: str) -> None:
    session_id = _accepted(world, 2)
    job = _claim(world)
    result = _result(world, job)
    broken = replace(result, fixes=(*result.fixes[:2], replace(result.fixes[2], **{field: math.nan})))  # type: ignore[arg-type]
    failed = world.services.processing.complete_locate(job, broken)
    assert failed is not None
    assert failed.state is JobState.FAILED
    assert _n_positions(world, session_id) == 0
    assert _claim(world).subject["seq"] == 1


def test_progress_is_written_in_steps(world: World) -> None:
    _accepted(world)
    job = _claim(world)
    shown = []
    for fraction in (0.0, 0.004, 0.5, 0.505, 1.0):
        world.services.processing.progress(job, fraction, f"at {fraction}")
        shown.append(world.services.jobs.get(job.id).progress_text)
    assert shown == ["at 0.0", "at 0.0", "at 0.5", "at 0.5", "at 1.0"]
