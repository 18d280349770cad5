"""Contract of the executor port, over all its adapters."""

import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, wait

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.services.ports import WorkerLostError
from app.workers.pools import InlineExecutor, ThreadExecutor
from app.workers.processes import ProcessExecutor
from tests.workers import sample_tasks as tasks
from tests.workers.polling import eventually

Pool = InlineExecutor | ThreadExecutor | ProcessExecutor


@pytest.fixture(params=["inline", "threads", "processes"])
def pool(request: pytest.FixtureRequest) -> Iterator[Pool]:
    if request.param == "inline":
        executor: Pool = InlineExecutor()
    elif request.param == "threads":
        executor = ThreadExecutor(2)
    else:
        executor = request.getfixturevalue("make_processes")(2)
    yield executor
    executor.close()


@pytest.fixture(params=["threads", "processes"])
def parallel_pool(request: pytest.FixtureRequest) -> Iterator[Pool]:
    executor: Pool = ThreadExecutor(2) if request.param == "threads" else request.getfixturevalue("make_processes")(2)
    yield executor
    executor.close()


def test_each_future_gets_the_result_of_its_own_task(pool: Pool) -> None:
    futures = [pool.submit(tasks.double, i, affinity=f"map-{i % 3}") for i in range(60)]
    assert [future.result(30) for future in futures] == [2 * i for i in range(60)]


def test_engine_error_arrives_with_its_attributes(pool: Pool) -> None:
    with pytest.raises(InputError, match="too strong") as caught:
        pool.submit(tasks.complain, "too strong").result(30)
    assert caught.value.field == "mag"
    assert caught.value.message == "too strong"


def test_exception_that_pickle_cannot_rebuild_arrives_whole(pool: Pool) -> None:
    with pytest.raises(tasks.OddError) as caught:
        pool.submit(tasks.complain_oddly, 3).result(30)
    assert (caught.value.field, caught.value.number, str(caught.value)) == ("t", 3, "t 3")


def test_exception_of_a_local_class_arrives_as_some_exception(pool: Pool) -> None:
    with pytest.raises(Exception, match=r"LocalError|from inside a function"):
        pool.submit(tasks.complain_locally, None).result(30)


def test_pool_works_on_after_a_failed_task(pool: Pool) -> None:
    pool.submit(tasks.complain, "x").exception(30)
    assert pool.submit(tasks.double, 4).result(30) == 8


def test_progress_arrives_in_order_and_before_the_result(pool: Pool) -> None:
    seen: list[tuple[float, str]] = []
    done_after: list[int] = []
    future = pool.submit(tasks.report, 5, on_progress=lambda fraction, text: seen.append((fraction, text)))
    future.add_done_callback(lambda _: done_after.append(len(seen)))
    assert future.result(30) == 5
    assert seen == [((i + 1) / 5, f"step {i + 1}") for i in range(5)]
    eventually(lambda: done_after == [5])


def test_progress_nobody_listens_to_is_dropped(pool: Pool) -> None:
    assert pool.submit(tasks.report, 5).result(30) == 5


def test_submit_after_close_is_refused(pool: Pool) -> None:
    pool.close()
    with pytest.raises(RuntimeError):
        pool.submit(tasks.double, 1)
    assert pool.alive == 0


def test_close_twice_is_fine(pool: Pool) -> None:
    pool.close()
    pool.close()


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(specs=st.lists(st.tuples(st.integers(), st.sampled_from(["", "a", "b", "c"])), max_size=20))
def test_any_mix_of_affinities_answers_every_task(pool: Pool, specs: list[tuple[int, str]]) -> None:
    futures = [pool.submit(tasks.double, spec, affinity=affinity) for spec, affinity in specs]
    assert [future.result(30) for future in futures] == [2 * spec for spec, _ in specs]


def test_tasks_run_side_by_side(parallel_pool: Pool, tmp_path_factory: pytest.TempPathFactory) -> None:
    gates = [tasks.Gate(tmp_path_factory.mktemp("gate")) for _ in range(2)]
    futures = [parallel_pool.submit(tasks.wait_at_gate, gate) for gate in gates]
    eventually(lambda: all(gate.entered.exists() for gate in gates))
    for gate in gates:
        gate.opened.touch()
    wait(futures, 30)
    assert all(future.done() for future in futures)


def test_close_abandons_running_and_cancels_waiting_tasks(
    parallel_pool: Pool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    gates = [tasks.Gate(tmp_path_factory.mktemp("gate")) for _ in range(2)]
    running = [parallel_pool.submit(tasks.wait_at_gate, gate) for gate in gates]
    waiting = [parallel_pool.submit(tasks.double, i) for i in range(5)]
    eventually(lambda: all(gate.entered.exists() for gate in gates))
    parallel_pool.close()
    for future in running:
        assert isinstance(future.exception(30), WorkerLostError | CancelledError)
    for future in waiting:
        assert future.cancelled()


def test_a_waiting_task_can_be_cancelled(parallel_pool: Pool, tmp_path_factory: pytest.TempPathFactory) -> None:
    gates = [tasks.Gate(tmp_path_factory.mktemp("gate")) for _ in range(2)]
    running = [parallel_pool.submit(tasks.wait_at_gate, gate) for gate in gates]
    waiting = parallel_pool.submit(tasks.double, 1)
    assert waiting.cancel()
    for gate in gates:
        gate.opened.touch()
    wait(running, 30)
    assert parallel_pool.submit(tasks.double, 2).result(30) == 4


def test_a_running_task_that_is_cancelled_makes_room_at_once(
    parallel_pool: Pool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    gates = [tasks.Gate(tmp_path_factory.mktemp("gate")) for _ in range(2)]
    running = [parallel_pool.submit(tasks.wait_at_gate, gate) for gate in gates]
    eventually(lambda: all(gate.entered.exists() for gate in gates))
    assert not running[0].cancel()
    assert isinstance(running[0].exception(30), WorkerLostError | CancelledError)
    assert parallel_pool.submit(tasks.double, 2).result(30) == 4
    assert not running[1].done(), "only the one that was meant"
    gates[1].opened.touch()
    running[1].result(30)


def test_submitting_from_many_threads_loses_nothing(parallel_pool: Pool) -> None:
    results: list[int] = []
    lock = threading.Lock()

    def submit_some(start: int) -> None:
        for i in range(start, start + 50):
            value = parallel_pool.submit(tasks.double, i, affinity=str(i % 2)).result(30)
            with lock:
                results.append(value)

    threads = [threading.Thread(target=submit_some, args=(50 * k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(results) == [2 * i for i in range(200)]
