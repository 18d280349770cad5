import time
from collections.abc import Callable

import psutil


def eventually(condition: Callable[[], object], timeout: float = 20.0) -> None:
    """Return as soon as the condition holds; fail when it does not in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


def gone(pid: int) -> bool:
    """Whether a process has ended (a zombie nobody has buried counts)."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
