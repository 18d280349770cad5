"""Tasks for the executors' contract tests; importable, as tasks of worker processes must be."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from app.engine.errors import InputError
from app.engine.types import Progress


def warm() -> None:
    """Nothing to prepare."""


def fail_to_warm() -> None:
    os._exit(3)


def double(spec: int, progress: Progress) -> int:
    return 2 * spec


def echo(spec: object, progress: Progress) -> object:
    return spec


def shout(spec: str, progress: Progress) -> object:
    return spec.upper() + "!"


def who(spec: object, progress: Progress) -> int:
    return os.getpid()


def report(spec: int, progress: Progress) -> int:
    for i in range(spec):
        progress((i + 1) / spec, f"step {i + 1}")
    return spec


def complain(spec: str, progress: Progress) -> None:
    raise InputError("mag", spec)


class OddError(Exception):
    """Pickles in no ordinary way: wants two arguments, hands one on."""

    def __init__(self, field: str, number: int) -> None:
        super().__init__(f"{field} {number}")
        self.field = field
        self.number = number


def complain_oddly(spec: int, progress: Progress) -> None:
    raise OddError("t", spec)


def complain_locally(spec: object, progress: Progress) -> None:
    class LocalError(Exception):
        pass

    raise LocalError("from inside a function")


def unpicklable(spec: object, progress: Progress) -> object:
    return lambda: None


@dataclass(frozen=True)
class Gate:
    """A file that says "I run" and one that says "go on"."""

    folder: Path

    @property
    def entered(self) -> Path:
        return self.folder / "entered"

    @property
    def opened(self) -> Path:
        return self.folder / "opened"


def wait_at_gate(spec: Gate, progress: Progress) -> int:
    spec.entered.write_text(str(os.getpid()))
    while not spec.opened.exists():
        progress(0.5, "waiting")
        time.sleep(0.005)
    return os.getpid()


def die(spec: object, progress: Progress) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(spec: Path, progress: Progress) -> str:
    if not spec.exists():
        spec.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def spin(spec: Path, progress: Progress) -> None:
    """Busy for ever, without a report: only a time limit or a death ends it."""
    spec.write_text(str(os.getpid()))
    while True:
        pass


def environment(spec: str, progress: Progress) -> str | None:
    return os.environ.get(spec)


def main_module(spec: object, progress: Progress) -> str | None:
    import sys

    return getattr(sys.modules["__main__"], "__file__", None)
