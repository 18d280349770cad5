"""What the dispatcher adds to a segment: from the wake-up of a lane to the news that its job is done.

    python -m tests.workers.dispatch_benchmark

The queue is in memory and the task returns its spec, so neither database nor numerics are in the figures: claim, spec,
hand-over to a worker and back, completion. 145 kB is a 5-second segment with the state of 2,000 particles.
"""

from __future__ import annotations

import multiprocessing
import pickle
import sys
import time

import numpy as np

from app.services.records import JobKind
from app.telemetry import Metrics
from app.workers.pools import ThreadExecutor
from app.workers.processes import ProcessExecutor
from app.workers.runner import Lane, Work
from tests.workers import sample_tasks
from tests.workers.fakes import Ear, FakeProcessing, queued
from tests.workers.polling import eventually

ROUNDS, WARM_UP = 400, 50


def measure(pool: ThreadExecutor | ProcessExecutor, payload: object) -> list[float]:
    """Seconds per job, one after the other."""
    queue, ear = FakeProcessing(), Ear()
    work: Work[object, object] = Work(
        kind=JobKind.LOCATE_SEGMENT,
        executor=pool,
        capacity=4,
        task=sample_tasks.echo,
        prepare=lambda job: payload,
        complete=queue.complete,
        affinity=lambda spec: "map",
    )
    lane = Lane(work, processing=queue, listener=ear, metrics=Metrics())
    lane.start()
    times = []
    for number in range(ROUNDS):
        job = queued(f"job_{number:05}")
        queue.jobs = {job.id: job}
        started = time.perf_counter()
        lane.wake()
        while len(ear.finished) <= number:
            time.sleep(2e-5)
        times.append(time.perf_counter() - started)
    lane.stop()
    lane.join(5.0)
    pool.close()
    return times[WARM_UP:]


def main() -> None:
    for payload in (b"x" * 100, (np.zeros((250, 10)), b"x" * 125_000)):
        processes = ProcessExecutor(2, multiprocessing.get_context("forkserver"), warm_up=sample_tasks.warm)
        processes.start()
        eventually(lambda processes=processes: processes.alive == 2)  # type: ignore[misc]
        for name, pool in (("threads", ThreadExecutor(2)), ("processes", processes)):
            p50, p95 = 1e3 * np.percentile(measure(pool, payload), [50, 95])
            size = len(pickle.dumps(payload)) / 1e3
            sys.stdout.write(f"{name:<10} {size:6.1f} kB   p50 {p50:.2f} ms   p95 {p95:.2f} ms\n")


if __name__ == "__main__":
    main()
