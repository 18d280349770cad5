"""What worker processes need before they exist: pinned threads, a place for compiled kernels, a warm fork server.

The fork server imports the engine and runs every kernel once; workers are forked from it, so that a new one is ready
within milliseconds and shares the memory of numba, LLVM and scipy with the others. Forking is safe there because that
process has one thread only.
"""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing import forkserver
from multiprocessing.context import BaseContext
from pathlib import Path

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
KERNEL_CACHE = "NUMBA_CACHE_DIR"
PRELOAD = "app.workers.preload"


def worker_context(kernel_cache: Path) -> BaseContext:
    """Prepare this process's environment for its workers, start the fork server, and return how to make them.

    Call it in the composition root before other threads run: it sets environment variables, which workers inherit
    (libraries read them once, when they are imported). A ``NUMBA_CACHE_DIR`` that is set already is respected. The
    fork server warms up on its own meanwhile, for seconds, so the earlier it is called the better; calling it again
    changes nothing.
    """
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    if KERNEL_CACHE not in os.environ:
        kernel_cache.mkdir(parents=True, exist_ok=True)
        os.environ[KERNEL_CACHE] = str(kernel_cache.resolve())
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([PRELOAD])
    forkserver.ensure_running()
    return context


def warm_up() -> None:
    """Import what tasks need and run every kernel once: compiled the first time, loaded from the cache afterwards."""
    # Imported here: the service process hands tasks out, it need not hold the numerics.
    import app.workers.tasks  # noqa: F401
    from app.engine.localization import warm_up as warm_up_engine

    warm_up_engine()
