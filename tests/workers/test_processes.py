"""What only worker processes can do: die, and be replaced."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import wait
from multiprocessing.context import BaseContext
from pathlib import Path

import psutil
import pytest

from app.services.ports import WorkerLostError
from app.workers.outcomes import RemoteTaskError
from app.workers.processes import ProcessExecutor
from tests.workers import sample_tasks as tasks
from tests.workers.polling import eventually, gone

MakeProcesses = Callable[..., ProcessExecutor]
ROOT = Path(__file__).resolve().parents[2]


def test_tasks_run_outside_the_service(make_processes: MakeProcesses) -> None:
    assert make_processes(1).submit(tasks.who, None).result(30) != os.getpid()


def test_a_dying_worker_fails_its_task_and_is_replaced(make_processes: MakeProcesses) -> None:
    lost: list[int] = []
    pool = make_processes(1, on_lost=lambda: lost.append(1))
    first = pool.submit(tasks.who, None).result(30)
    with pytest.raises(WorkerLostError):
        pool.submit(tasks.die, None).result(30)
    assert pool.submit(tasks.who, None).result(30) != first
    assert lost == [1]


def test_a_killed_worker_takes_only_its_own_task_along(make_processes: MakeProcesses, tmp_path: Path) -> None:
    pool = make_processes(2)
    gates = [tasks.Gate(tmp_path / name) for name in ("a", "b")]
    for gate in gates:
        gate.folder.mkdir()
    doomed, other = (pool.submit(tasks.wait_at_gate, gate) for gate in gates)
    waiting = [pool.submit(tasks.double, i) for i in range(10)]
    eventually(lambda: all(gate.entered.exists() and gate.entered.read_text() for gate in gates))
    os.kill(int(gates[0].entered.read_text()), signal.SIGKILL)
    assert isinstance(doomed.exception(30), WorkerLostError)
    gates[1].opened.touch()
    assert other.result(30) == int(gates[1].entered.read_text())
    assert [future.result(30) for future in waiting] == [2 * i for i in range(10)]
    eventually(lambda: pool.alive == 2)


def test_an_idle_worker_that_is_killed_is_replaced_and_costs_nothing(make_processes: MakeProcesses) -> None:
    pool = make_processes(2)
    eventually(lambda: pool.alive == 2)
    before = set(pool.pids)
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    eventually(lambda: pool.alive == 2 and not before & set(pool.pids))
    assert [pool.submit(tasks.double, i).result(30) for i in range(5)] == [0, 2, 4, 6, 8]


def test_a_worker_that_takes_too_long_is_replaced(make_processes: MakeProcesses, tmp_path: Path) -> None:
    pool = make_processes(1, time_limit_s=0.3)
    with pytest.raises(WorkerLostError, match="took longer"):
        pool.submit(tasks.spin, tmp_path / "pid").result(30)
    pid = int((tmp_path / "pid").read_text())
    assert pool.submit(tasks.who, None).result(30) != pid
    eventually(lambda: gone(pid))


def test_a_map_returns_to_the_worker_that_holds_it(make_processes: MakeProcesses) -> None:
    pool = make_processes(2)
    eventually(lambda: pool.alive == 2)
    homes = {name: pool.submit(tasks.who, None, affinity=name).result(30) for name in ("a", "b")}
    assert homes["a"] != homes["b"]
    for name in "abbaabab":
        assert pool.submit(tasks.who, None, affinity=name).result(30) == homes[name]


def test_a_busy_favourite_does_not_hold_a_task_up(make_processes: MakeProcesses, tmp_path: Path) -> None:
    pool = make_processes(2)
    eventually(lambda: pool.alive == 2)
    gate = tasks.Gate(tmp_path)
    held = pool.submit(tasks.wait_at_gate, gate, affinity="a")
    eventually(gate.entered.exists)
    assert pool.submit(tasks.double, 1, affinity="a").result(30) == 2
    gate.opened.touch()
    wait([held], 30)


def test_a_spec_that_cannot_be_sent_is_refused_at_once(make_processes: MakeProcesses) -> None:
    pool = make_processes(1)
    with pytest.raises((AttributeError, TypeError)):
        pool.submit(tasks.double, lambda: None)  # type: ignore[arg-type]
    assert pool.submit(tasks.double, 1).result(30) == 2


def test_a_result_that_cannot_be_sent_fails_its_task_only(make_processes: MakeProcesses) -> None:
    pool = make_processes(1)
    with pytest.raises(RemoteTaskError, match="cannot be sent"):
        pool.submit(tasks.unpicklable, None).result(30)
    assert pool.submit(tasks.double, 1).result(30) == 2


def test_an_exception_carries_the_traceback_of_the_worker(make_processes: MakeProcesses) -> None:
    error = make_processes(1).submit(tasks.complain, "x").exception(30)
    assert error is not None
    assert "in complain" in "".join(error.__notes__)


def test_workers_that_cannot_start_leave_the_pool_empty_but_closable(context: BaseContext) -> None:
    lost: list[int] = []
    pool = ProcessExecutor(1, context, warm_up=tasks.fail_to_warm, on_lost=lambda: lost.append(1))
    pool.start()
    future = pool.submit(tasks.double, 1)
    eventually(lambda: len(lost) >= 2)
    assert pool.alive == 0
    pool.close()
    assert future.cancelled()


def test_cancelling_a_running_task_ends_it_and_no_other(make_processes: MakeProcesses, tmp_path: Path) -> None:
    lost: list[int] = []
    pool = make_processes(2, on_lost=lambda: lost.append(1))
    gate = tasks.Gate(tmp_path)
    endless, other = pool.submit(tasks.spin, tmp_path / "pid"), pool.submit(tasks.wait_at_gate, gate)
    eventually(lambda: (tmp_path / "pid").exists() and gate.entered.exists())
    assert not endless.cancel()
    assert isinstance(endless.exception(30), WorkerLostError)
    gate.opened.touch()
    other.result(30)
    assert not other.cancel(), "it is over: its worker may have another task by now"
    assert [pool.submit(tasks.double, i).result(30) for i in range(4)] == [0, 2, 4, 6]
    eventually(lambda: pool.alive == 2)
    assert lost == []


def test_the_pool_survives_the_death_of_the_fork_server(make_processes: MakeProcesses) -> None:
    pool = make_processes(1)
    worker = psutil.Process(pool.submit(tasks.who, None).result(30))
    fork_server = worker.parent()
    assert fork_server is not None
    fork_server.kill()
    worker.kill()
    eventually(lambda: worker.pid not in pool.pids)
    assert pool.submit(tasks.who, None).result(60) != worker.pid


def test_closing_ends_all_processes(make_processes: MakeProcesses, tmp_path: Path) -> None:
    pool = make_processes(2)
    eventually(lambda: pool.alive == 2)
    pids = pool.pids
    pool.submit(tasks.spin, tmp_path / "pid")
    eventually((tmp_path / "pid").exists)
    pool.close()
    eventually(lambda: all(gone(pid) for pid in pids))


def test_workers_do_not_import_the_program_that_started_them(make_processes: MakeProcesses) -> None:
    assert make_processes(1).submit(tasks.main_module, None).result(30) is None


def test_workers_ignore_the_signals_of_the_group(make_processes: MakeProcesses) -> None:
    pool = make_processes(1)
    pid = pool.submit(tasks.who, None).result(30)
    os.kill(pid, signal.SIGINT)
    os.kill(pid, signal.SIGTERM)
    assert pool.submit(tasks.who, None).result(30) == pid


def test_no_worker_outlives_a_killed_service(tmp_path: Path) -> None:
    """One worker is idle, one busy in a loop that looks at nothing: both must notice."""
    command = [sys.executable, "-m", "tests.workers.orphans", str(tmp_path / "pid")]
    family: list[psutil.Process] = []
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as service:
        try:
            assert service.stdout is not None
            line = next(line for line in service.stdout if line.startswith("workers "))
            family = psutil.Process(service.pid).children(recursive=True)
        finally:
            service.kill()
    workers = {int(word) for word in line.split()[1:]}
    try:
        assert len(workers) == 2
        assert {process.pid for process in family} > workers
        eventually(lambda: all(gone(process.pid) for process in family))
    finally:
        for process in family:
            if process.is_running():
                process.kill()


def test_a_service_that_ends_without_closing_its_pool_ends(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.workers.orphans", str(tmp_path / "pid"), "leave"]
    assert subprocess.run(command, check=False, cwd=ROOT, stdout=subprocess.DEVNULL, timeout=60).returncode == 7
    assert gone(int((tmp_path / "pid").read_text()))
