"""Main loop of a worker process: read a task, run it, send what comes of it.

Messages are bytes whose first one is a :class:`Tag`. The pipe is the worker's only tie to the service: its end is the
order to leave. While a task runs nobody reads it, so a watch thread ends the process when the service has died.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
from enum import IntEnum
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from typing import Any

from app.engine.types import Progress
from app.workers.outcomes import attempt, encode


class Tag(IntEnum):
    """First byte of what a worker sends."""

    READY = 1
    PROGRESS = 2
    OUTCOME = 3


def worker_main(connection: Connection, warm_up: bytes) -> None:
    """Serve tasks until the pipe ends. ``warm_up`` is a pickled callable, run before the first task."""
    # Ctrl-C and service managers signal the whole group; the service decides when its workers go.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, name="parent-watch", daemon=True).start()
    pickle.loads(warm_up)()  # noqa: S301 - from our own service
    try:
        connection.send_bytes(bytes([Tag.READY]))
        while True:
            _serve_one(connection)
    except (EOFError, OSError):
        # The service closed the pipe or is gone: either way there is nobody left to tell.
        return


def _serve_one(connection: Connection) -> None:
    payload = connection.recv_bytes()

    def progress(fraction: float, text: str) -> None:
        connection.send_bytes(bytes([Tag.PROGRESS]) + pickle.dumps((fraction, text)))

    outcome = attempt(_run, payload, progress)
    connection.send_bytes(bytes([Tag.OUTCOME]) + encode(outcome))


def _run(payload: bytes, progress: Progress) -> Any:
    task, spec = pickle.loads(payload)  # noqa: S301 - from our own service
    return task(spec, progress)


def _die_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
