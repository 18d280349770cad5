"""Compiled kernels when several test processes share a cache.

numba's cache survives readers beside a writer, not two writers: both may number their file alike, and the index then
names the machine code of another signature. And two processes that need the same kernel would both compile it. So each
kernel gets a lock between processes; whoever waited for it finds the kernel in the cache.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from tests.support.locks import between_processes


class KernelLocks:
    """One lock file a kernel. A process may take a lock again that it holds: kernels of several signatures nest."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._held: Counter[str] = Counter()

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        # The compiler's own lock comes first, always: two threads that took the two in different orders would wait
        # for each other for ever. Between processes, the calls of kernels order the locks (no kernel calls back).
        with global_compiler_lock:
            self._held[name] += 1
            try:
                if self._held[name] > 1:
                    yield
                else:
                    with between_processes(self._folder / name):
                        yield
            finally:
                self._held[name] -= 1


def compile_one_at_a_time(folder: Path) -> None:
    """From now on a kernel is compiled, or loaded from the cache, by one process at a time."""
    locks = KernelLocks(folder)
    compile_or_load = Dispatcher.compile

    def compile_locked(dispatcher: Dispatcher, signature: Any) -> Any:
        function = dispatcher.py_func
        with locks.of(f"{function.__module__}.{function.__qualname__}"):
            return compile_or_load(dispatcher, signature)

    Dispatcher.compile = compile_locked
