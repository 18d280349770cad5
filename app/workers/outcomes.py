"""What comes of a task, in a form that crosses a process boundary.

An exception is shipped by class, arguments and attributes and rebuilt without calling its ``__init__``: pickle's own
way calls it with ``args``, which breaks for every exception whose constructor takes anything but its message.
"""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from app.engine.types import Progress

Spec = TypeVar("Spec")
Result = TypeVar("Result")


class RemoteTaskError(Exception):
    """A task failed in a worker with an exception that cannot be brought over; the text says which."""


@dataclass(frozen=True, slots=True)
class Done(Generic[Result]):
    """The task returned."""

    result: Result


@dataclass(frozen=True, slots=True)
class Failed:
    """The task raised."""

    error: Exception


class TaskFuture(Future[Result]):
    """Future of a task that can be stopped while it runs, by whoever runs it (``abort``).

    :meth:`cancel` then returns False like any future's, and the future fails soon.
    """

    def __init__(self, abort: Callable[[TaskFuture[Any]], None]) -> None:
        super().__init__()
        self._abort = abort

    def cancel(self) -> bool:
        """Cancel the task if it waits, stop it if it runs."""
        cancelled = super().cancel()
        if not cancelled:
            self._abort(self)
        return cancelled


def attempt(task: Callable[[Spec, Progress], Result], spec: Spec, progress: Progress) -> Done[Result] | Failed:
    """Run a task and keep what comes of it, whatever that is, for whoever holds the future."""
    try:
        return Done(task(spec, progress))
    except Exception as error:  # noqa: BLE001 - handed on whole, not handled
        return Failed(error)


def settle(future: Future[Result], outcome: Done[Result] | Failed) -> None:
    """Give the outcome to the future (which runs its callbacks)."""
    if isinstance(outcome, Done):
        future.set_result(outcome.result)
    else:
        future.set_exception(outcome.error)


@dataclass(frozen=True, slots=True)
class _Shipped:
    """An exception on its way."""

    kind: type[Exception]
    args: tuple[Any, ...]
    state: dict[str, Any]

    def rebuild(self) -> Failed:
        error = self.kind.__new__(self.kind, *self.args)
        error.args = self.args
        error.__dict__.update(self.state)
        return Failed(error)


def encode(outcome: Done[Any] | Failed) -> bytes:
    """Serialize an outcome; what cannot be serialized becomes a :class:`RemoteTaskError` that says so."""
    if isinstance(outcome, Done):
        packed = attempt(_dumps, outcome, _no_progress)
    else:
        error = outcome.error
        error.add_note("In the worker:\n" + "".join(traceback.format_exception(error)))
        packed = attempt(_dumps, _Shipped(type(error), error.args, dict(error.__dict__)), _no_progress)
    if isinstance(packed, Done):
        return packed.result
    text = f"{outcome!r} cannot be sent to the service: {packed.error}"
    return pickle.dumps(_Shipped(RemoteTaskError, (text,), {}))


def decode(payload: bytes) -> Done[Any] | Failed:
    """Read an outcome written by :func:`encode`; one that cannot be read is a failure too."""
    loaded = attempt(_loads, payload, _no_progress)
    if isinstance(loaded, Failed):
        return loaded
    outcome = loaded.result
    return outcome.rebuild() if isinstance(outcome, _Shipped) else outcome


def _dumps(value: object, _: Progress) -> bytes:
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def _loads(payload: bytes, _: Progress) -> Done[Any] | _Shipped:
    # From our own worker over an anonymous pipe: not input.
    loaded: Done[Any] | _Shipped = pickle.loads(payload)  # noqa: S301
    return loaded


def _no_progress(_: float, __: str) -> None:
    pass
