"""Locks between the processes of one test run (and of others on this machine)."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def between_processes(path: Path) -> Iterator[None]:
    """Hold the lock of this name; the file stays, for whoever waits. It goes with the process, however that ends."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
