import multiprocessing
from collections.abc import Callable, Iterator
from multiprocessing.context import BaseContext

import pytest

from app.workers.processes import ProcessExecutor
from tests.workers import sample_tasks

type_makes = Callable[..., ProcessExecutor]


@pytest.fixture(scope="session")
def context() -> BaseContext:
    """Bare fork server: the contract does not need the engine."""
    return multiprocessing.get_context("forkserver")


@pytest.fixture
def make_processes(context: BaseContext) -> Iterator[type_makes]:
    """Makes started process executors and closes them."""
    made: list[ProcessExecutor] = []

    def make(workers: int = 2, **options: object) -> ProcessExecutor:
        executor = ProcessExecutor(workers, context, warm_up=sample_tasks.warm, **options)  # type: ignore[arg-type]
        executor.start()
        made.append(executor)
        return executor

    yield make
    for executor in made:
        executor.close()
