"""Many threads, several processes' worth of databases, and processes that are killed: nothing lost, nothing twice."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from app.services.records import Job, JobState
from tests.support.builders import World, locate_result, new_segment

N_SESSIONS = 6
N_SEGMENTS = 12
DEADLINE_S = 60.0
ROOT = Path(__file__).parents[2]


class Crowd:
    """Threads whose exceptions are not lost."""

    def __init__(self) -> None:
        self.errors: list[BaseException] = []
        self._threads: list[threading.Thread] = []

    def start(self, work: Callable[[], None]) -> None:
        def guarded() -> None:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - shown by the test
                self.errors.append(error)

        self._threads.append(threading.Thread(target=guarded))
        self._threads[-1].start()

    def join(self) -> None:
        for thread in self._threads:
            thread.join(DEADLINE_S)
        assert self.errors == []
        assert not any(thread.is_alive() for thread in self._threads)


def _accept_all(world: World, session_id: str) -> None:
    for seq in range(N_SEGMENTS):
        accepted = world.services.sessions.accept(session_id, new_segment(seq, n=50))
        assert accepted.segment.seq == seq


def _process_until(world: World, total: int, claimed: list[Job], lock: threading.Lock) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        for job in world.services.processing.claim(3):
            with lock:
                claimed.append(job)
            spec = world.services.processing.locate_spec(job)
            result = locate_result(int(job.subject["seq"]), level_id=spec.prior.level_id)
            assert world.services.processing.complete_locate(job, result) is not None
        with lock:
            if len(claimed) >= total:
                return
    raise TimeoutError(f"{len(claimed)} of {total} jobs were claimed")


def _check(world: World, session_ids: Sequence[str], claimed: Sequence[Job]) -> None:
    order = defaultdict(list)
    for job in claimed:
        order[job.order_key].append(job.subject["seq"])
    assert dict(order) == {session_id: list(range(N_SEGMENTS)) for session_id in session_ids}
    for session_id in session_ids:
        positions = world.services.sessions.positions(session_id, limit=500).items
        assert [position.number for position in positions] == list(range(3 * N_SEGMENTS))
        assert [position.seq for position in positions] == [i // 3 for i in range(3 * N_SEGMENTS)]
    stats = world.services.stats.stats()
    assert stats.jobs_by_state[JobState.DONE] == len(claimed) + 1  # and the map's


def _run_crowd(accepting: Sequence[World], processing: Sequence[World]) -> None:
    world = accepting[0]
    level = world.mapped_level()
    session_ids = [world.session(level.id).id for _ in range(N_SESSIONS)]
    claimed: list[Job] = []
    lock, crowd = threading.Lock(), Crowd()
    for i, session_id in enumerate(session_ids):
        crowd.start(partial(_accept_all, accepting[i % len(accepting)], session_id))
    for at in processing:
        crowd.start(partial(_process_until, at, N_SESSIONS * N_SEGMENTS, claimed, lock))
    crowd.join()
    _check(world, session_ids, claimed)


def test_threads_accept_and_process_at_once(world: World) -> None:
    _run_crowd([world], [world, world])


def test_processes_accept_and_process_at_once(tmp_path: Path) -> None:
    # a World of its own has connections and a write lock of its own, as another process has
    worlds = [World.at(tmp_path) for _ in range(3)]
    _run_crowd(worlds[:2], worlds[1:])
    for world in worlds:
        world.close()


def test_one_of_several_equal_uploads_wins(world: World) -> None:
    session, crowd = world.session(), Crowd()
    barrier, answers = threading.Barrier(6), []

    def upload() -> None:
        barrier.wait(DEADLINE_S)
        answers.append(world.services.sessions.accept(session.id, new_segment(0)))

    for _ in range(6):
        crowd.start(upload)
    crowd.join()
    assert sorted(answer.repeated for answer in answers) == [False] + 5 * [True]
    assert len({answer.job.id for answer in answers}) == 1


def test_one_of_several_equal_results_counts(world: World) -> None:
    session, crowd = world.session(), Crowd()
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1)
    barrier, answers = threading.Barrier(6), []

    def answer() -> None:
        barrier.wait(DEADLINE_S)
        result = locate_result(level_id=session.level_id)
        answers.append(world.services.processing.complete_locate(job, result))

    for _ in range(6):
        crowd.start(answer)
    crowd.join()
    assert sum(answer is not None for answer in answers) == 1
    assert len(world.services.sessions.positions(session.id).items) == 3


_ACCEPT_UNTIL_KILLED = """
import itertools, sys
from pathlib import Path
from tests.support.builders import World, locate_result, new_segment
world = World.at(Path(sys.argv[1]))
processing = world.services.processing
for seq in itertools.count():
    world.services.sessions.accept(sys.argv[2], new_segment(seq, n=50))
    print(seq, flush=True)
    if seq % 3 == 2:
        (job,) = processing.claim(1)
        processing.complete_locate(job, locate_result(int(job.subject["seq"])))
"""


def test_accepted_segments_survive_kill_9(world: World, tmp_path: Path) -> None:
    session = world.session()
    command = [sys.executable, "-c", _ACCEPT_UNTIL_KILLED, str(tmp_path), session.id]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as child:
        assert child.stdout is not None
        heard = [int(child.stdout.readline()) for _ in range(20)]
        child.kill()
        heard += [int(line) for line in child.stdout.read().splitlines()[:-1]]
    again = World.at(tmp_path)
    again.services.processing.recover()
    while jobs := again.services.processing.claim(9):
        for job in jobs:
            again.services.processing.complete_locate(job, locate_result(int(job.subject["seq"])))
    segments = again.services.sessions.segments(session.id, limit=500).items
    assert len(segments) >= len(heard)
    assert [segment.seq for segment in segments] == list(range(len(segments)))
    assert {segment.job_state for segment in segments} == {JobState.DONE}
    positions = again.services.sessions.positions(session.id, limit=500).items
    assert [position.seq for position in positions] == [i // 3 for i in range(len(positions))][:500]
    assert again.services.sessions.get(session.id).next_seq == len(segments)
    again.close()
