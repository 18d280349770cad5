"""Lanes over a queue in memory and an executor that is settled by hand; nothing here waits for a poll."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.services.errors import InvalidError, NotFoundError, StorageError
from app.services.ports import Executor, WorkerLostError
from app.services.records import Job, JobKind, JobState
from app.telemetry import Metrics
from app.workers import runner as module
from app.workers.pools import ThreadExecutor
from app.workers.processes import ProcessExecutor
from app.workers.runner import INTERNAL_ERROR, JobRunner, Lane, Work
from tests.workers import sample_tasks
from tests.workers.fakes import Ear, FakeProcessing, HandExecutor, queued
from tests.workers.polling import eventually


@dataclass
class Bench:
    """A lane and everything around it."""

    queue: FakeProcessing
    ear: Ear
    metrics: Metrics
    lane: Lane[str, object]
    executor: HandExecutor

    def offer(self, *jobs: Job) -> None:
        self.queue.add(*jobs)
        for _ in jobs:
            self.lane.wake()

    def value(self, sample: str) -> float:
        labels = {"kind": "locate_segment"} if "runner" not in sample else {}
        return self.metrics.registry.get_sample_value(sample, labels) or 0.0


def make_lane(
    queue: FakeProcessing, executor: Executor, ear: Ear, metrics: Metrics, *, capacity: int = 2
) -> Lane[str, object]:
    work: Work[str, object] = Work(
        kind=JobKind.LOCATE_SEGMENT,
        executor=executor,
        capacity=capacity,
        task=sample_tasks.shout,
        prepare=queue.prepare,
        complete=queue.complete,
        affinity=lambda spec: f"map of {spec}",
        shows_progress=True,
    )
    return Lane(work, processing=queue, listener=ear, metrics=metrics)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(module, "PROGRESS_EVERY_S", 0.0)
    monkeypatch.setattr(module, "POLL_S", 1000.0)
    queue, ear, metrics, executor = FakeProcessing(), Ear(), Metrics(), HandExecutor()
    lane = make_lane(queue, executor, ear, metrics)
    lane.start()
    yield Bench(queue, ear, metrics, lane, executor)
    lane.stop()
    for item in executor.submitted:
        if not item.future.done():
            item.future.set_exception(WorkerLostError("the test is over"))
    assert lane.join(10)


def test_a_job_goes_all_the_way(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.specs() == ["job_1"])
    assert bench.executor.of("job_1").affinity == "map of job_1"
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.ear.finished == [("job_1", JobState.DONE)])
    assert bench.queue.completed == [("job_1", "answer")]


def test_jobs_of_one_session_run_one_after_the_other(bench: Bench) -> None:
    bench.offer(queued("job_1", "ses_a"), queued("job_2", "ses_a"), queued("job_3", "ses_b"))
    eventually(lambda: bench.executor.specs() == ["job_1", "job_3"])
    bench.executor.of("job_1").future.set_result(1)
    eventually(lambda: bench.executor.specs() == ["job_1", "job_3", "job_2"])


def test_no_more_jobs_are_claimed_than_the_executor_should_have(bench: Bench) -> None:
    bench.offer(*(queued(f"job_{i}") for i in range(5)))
    eventually(lambda: len(bench.executor.submitted) == 2)
    assert bench.value("isodyn_jobs_running") == 2
    bench.executor.submitted[0].future.set_result(0)
    eventually(lambda: len(bench.executor.submitted) == 3)
    assert [bench.queue.state(f"job_{i}") for i in (3, 4)] == [JobState.QUEUED] * 2


def test_a_lost_worker_means_another_attempt_and_in_the_end_a_failure(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    for attempt in range(1, 4):
        eventually(lambda attempt=attempt: len(bench.executor.submitted) == attempt)  # type: ignore[misc]
        bench.executor.submitted[-1].future.set_exception(WorkerLostError("gone"))
    eventually(lambda: bench.ear.finished == [("job_1", JobState.FAILED)])
    assert bench.value("isodyn_jobs_retried_total") == 3


def test_an_error_of_the_engine_fails_the_job_with_its_text(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_exception(InputError("mag", "too strong"))
    eventually(lambda: bench.ear.finished == [("job_1", JobState.FAILED)])
    assert bench.queue.jobs["job_1"].error == "mag: too strong"
    assert bench.value("isodyn_runner_errors_total") == 0


def test_an_unexpected_error_of_a_task_fails_the_job_without_its_text(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_exception(ZeroDivisionError("secret detail"))
    eventually(lambda: bench.ear.finished == [("job_1", JobState.FAILED)])
    assert bench.queue.jobs["job_1"].error == INTERNAL_ERROR
    assert bench.value("isodyn_runner_errors_total") == 1
    assert "secret detail" in capsys.readouterr().out


@pytest.mark.parametrize(
    "error",
    [
        NotFoundError("session", "ses_1"),
        InputError("state", "of another version"),
        InvalidError("gnss", "cannot be used", "set the anchor"),
    ],
)
def test_a_job_that_cannot_be_prepared_fails_with_the_reason(
    bench: Bench, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(job: Job) -> str:
        raise error

    lane = make_lane(bench.queue, bench.executor, bench.ear, bench.metrics)
    object.__setattr__(lane._work, "prepare", refuse)
    bench.queue.add(queued("job_1"))
    lane.start()
    eventually(lambda: bench.ear.finished == [("job_1", JobState.FAILED)])
    assert bench.queue.jobs["job_1"].error == str(error)
    lane.stop()
    assert lane.join(10)


@pytest.mark.parametrize("step", ["claim", "prepare", "complete"])
def test_a_step_that_meets_trouble_is_done_again(bench: Bench, step: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)
    bench.queue.break_next[step] = 2
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.ear.finished == [("job_1", JobState.DONE)])
    assert bench.queue.completed == [("job_1", "answer")]
    assert bench.value("isodyn_runner_errors_total") == 2


def test_a_step_that_always_meets_trouble_fails_its_job_and_nothing_else(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)
    bench.queue.break_next["complete"] = 3
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.ear.finished == [("job_1", JobState.FAILED)])
    bench.offer(queued("job_2"))
    eventually(lambda: "job_2" in bench.executor.specs())
    bench.executor.of("job_2").future.set_result("answer")
    eventually(lambda: bench.ear.finished[-1] == ("job_2", JobState.DONE))


def test_trouble_with_the_database_is_waited_out(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk is not the segment's fault: however long it lasts, the result is stored in the end."""
    monkeypatch.setattr(module, "POLL_S", 0.001)
    monkeypatch.setattr(module, "MAX_PAUSE_S", 0.01)
    bench.queue.trouble = lambda _: StorageError()
    bench.queue.break_next |= {"claim": 5, "prepare": 9, "complete": 20}
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.ear.finished == [("job_1", JobState.DONE)])
    assert bench.queue.completed == [("job_1", "answer")]


def test_a_job_whose_end_cannot_be_stored_stays_running_and_frees_its_place(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)
    bench.queue.break_next |= {"complete": 3, "fail": 3}
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.value("isodyn_runner_errors_total") == 6)
    bench.offer(queued("job_2"), queued("job_3"))
    eventually(lambda: len(bench.executor.submitted) == 3)
    assert bench.queue.state("job_1") is JobState.RUNNING
    assert bench.ear.finished == []


def test_progress_is_stored_and_trouble_with_it_costs_nothing(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    report = bench.executor.of("job_1").on_progress
    assert report is not None
    report(0.25, "a quarter")
    eventually(lambda: bench.queue.reports == [("job_1", 0.25, "a quarter")])
    bench.queue.break_next["progress"] = 1
    report(0.5, "half")
    bench.executor.of("job_1").future.set_result("answer")
    eventually(lambda: bench.ear.finished == [("job_1", JobState.DONE)])
    report(0.75, "too late")
    bench.offer(queued("job_2"))
    eventually(lambda: len(bench.executor.submitted) == 2)
    assert bench.queue.reports == [("job_1", 0.25, "a quarter")]


def test_a_result_that_comes_after_the_job_was_cancelled_is_dropped(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_running_or_notify_cancel()
    bench.lane.cancel(bench.queue.cancel("job_1"))
    bench.executor.of("job_1").future.set_result("answer")
    bench.offer(queued("job_2"))
    eventually(lambda: "job_2" in bench.executor.specs())
    assert bench.queue.completed == []
    assert bench.ear.finished == []


def test_a_cancelled_job_that_waits_in_the_executor_is_withdrawn(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.lane.cancel(bench.queue.cancel("job_1"))
    eventually(lambda: bench.executor.of("job_1").future.cancelled())
    eventually(lambda: bench.value("isodyn_jobs_running") == 0)


def test_a_cancelled_job_whose_worker_was_ended_is_not_tried_again(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.executor.of("job_1").future.set_running_or_notify_cancel()
    bench.lane.cancel(bench.queue.cancel("job_1"))
    bench.offer(queued("job_2"))
    eventually(lambda: "job_2" in bench.executor.specs())
    bench.executor.of("job_1").future.set_exception(WorkerLostError("stopped"))
    eventually(lambda: bench.value("isodyn_jobs_running") == 1)
    assert bench.queue.state("job_1") is JobState.CANCELLED
    assert bench.value("isodyn_jobs_retried_total") == 0


def test_stopping_waits_for_what_runs_and_takes_nothing_new(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.lane.stop()
    assert not bench.lane.join(0.05)
    bench.offer(queued("job_2"))
    bench.executor.of("job_1").future.set_result("answer")
    assert bench.lane.join(10)
    assert bench.ear.finished == [("job_1", JobState.DONE)]
    assert bench.executor.specs() == ["job_1"]


def test_what_a_stop_abandons_stays_marked_as_running(bench: Bench) -> None:
    bench.offer(queued("job_1"))
    eventually(lambda: bench.executor.submitted)
    bench.lane.stop()
    bench.executor.of("job_1").future.set_exception(WorkerLostError("the pool was closed"))
    assert bench.lane.join(10)
    assert bench.queue.state("job_1") is JobState.RUNNING


def test_work_is_found_without_being_told(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)
    bench.lane.wake()
    bench.queue.add(queued("job_1"))
    eventually(lambda: bench.executor.specs() == ["job_1"])


def test_the_runner_wakes_the_lane_of_the_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    queue, ear, metrics, executor = FakeProcessing(), Ear(), Metrics(), HandExecutor()
    runner = JobRunner({JobKind.LOCATE_SEGMENT: make_lane(queue, executor, ear, metrics)})
    runner.start()
    job = queued("job_1")
    queue.add(job)
    runner.job_queued(job)
    eventually(lambda: executor.specs() == ["job_1"])
    runner.job_finished(queue.cancel("job_1"))
    eventually(lambda: executor.of("job_1").future.cancelled())
    assert runner.stop(10)


def test_a_runner_that_never_started_stops_at_once() -> None:
    runner = JobRunner({JobKind.LOCATE_SEGMENT: make_lane(FakeProcessing(), HandExecutor(), Ear(), Metrics())})
    assert runner.stop(0)


def test_jobs_held_back_by_their_session_are_not_forgotten(bench: Bench) -> None:
    bench.lane.wake()
    eventually(lambda: bench.queue.claims >= 2)  # it has seen an empty queue
    bench.offer(*(queued(f"job_{i}", "ses_1") for i in range(3)))
    for i in range(3):
        eventually(lambda i=i: len(bench.executor.submitted) == i + 1)  # type: ignore[misc]
        bench.executor.submitted[-1].future.set_result(i)
    eventually(lambda: len(bench.ear.finished) == 3)


def test_the_queue_is_not_asked_in_vain_after_every_job(bench: Bench) -> None:
    """One session whose client waits for every answer: one claim a segment (and one that finds the queue empty)."""
    for i in range(20):
        bench.offer(queued(f"job_{i:02}", "ses_1"))
        eventually(lambda i=i: len(bench.executor.submitted) == i + 1)  # type: ignore[misc]
        bench.executor.submitted[-1].future.set_result(i)
        eventually(lambda i=i: len(bench.ear.finished) == i + 1)  # type: ignore[misc]
    assert bench.queue.claims <= 20 + 3


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    sessions=st.lists(st.sampled_from("abcd"), max_size=24),
    before=st.integers(0, 24),
    capacity=st.integers(1, 5),
)
def test_every_job_is_done_once_and_in_the_order_of_its_session(
    sessions: list[str], before: int, capacity: int
) -> None:
    """Some jobs are there before the start, the others are announced while it runs; no poll helps."""
    queue, ear, pool = FakeProcessing(), Ear(), ThreadExecutor(3)
    jobs = [queued(f"job_{i:03}", session) for i, session in enumerate(sessions)]
    queue.add(*jobs[:before])
    lane = make_lane(queue, pool, ear, Metrics(), capacity=capacity)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "POLL_S", 1000.0)
        lane.start()
        for job in jobs[before:]:
            queue.add(job)
            lane.wake()
        eventually(lambda: len(ear.finished) == len(sessions))
        lane.stop()
        assert lane.join(10)
    pool.close()
    done = [job_id for job_id, _ in queue.completed]
    assert sorted(done) == [f"job_{i:03}" for i in range(len(sessions))]
    for session in set(sessions):
        mine = [job_id for job_id in done if queue.jobs[job_id].order_key == session]
        assert mine == sorted(mine)


def test_killed_workers_cost_attempts_but_no_job(make_processes: Callable[..., ProcessExecutor]) -> None:
    """Real processes, one of which is killed again and again while 60 jobs of six sessions run."""
    queue, ear, pool = FakeProcessing(), Ear(), make_processes(2)
    queue.add(*(queued(f"job_{i:03}", f"ses_{i % 6}") for i in range(60)))
    lane = make_lane(queue, pool, ear, Metrics(), capacity=4)
    eventually(lambda: pool.alive == 2)
    lane.start()
    for done in (5, 20, 40):
        eventually(lambda done=done: len(ear.finished) >= done and pool.pids)  # type: ignore[misc]
        os.kill(pool.pids[0], 9)
    eventually(lambda: len(ear.finished) == 60)
    lane.stop()
    assert lane.join(10)
    assert sorted(queue.completed) == [(f"job_{i:03}", f"JOB_{i:03}!") for i in range(60)]
