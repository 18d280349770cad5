"""Work side by side: a process pool, or none for one job."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


@contextmanager
def process_pool(jobs: int, warm_up: Callable[[], None]) -> Iterator[Executor | None]:
    """A process pool, or None for one job. Tasks not begun are dropped when the run ends early."""
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=warm_up)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def map_tasks(
    pool: Executor | None, function: Callable[[T], R], tasks: Sequence[T], done: Callable[[int, int], None]
) -> list[R]:
    """Results in the order of the tasks; ``done(finished, all)`` after each."""
    if pool is None:
        results = []
        for number, task in enumerate(tasks, start=1):
            results.append(function(task))
            done(number, len(tasks))
        return results
    futures = [pool.submit(function, task) for task in tasks]
    for number, future in enumerate(as_completed(futures), start=1):
        future.result()  # the first failure ends the run
        done(number, len(tasks))
    return [future.result() for future in futures]
