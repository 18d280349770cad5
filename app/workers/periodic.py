"""What is done again and again while the service runs."""

from __future__ import annotations

import threading
from collections.abc import Callable

import structlog

from app.services.errors import OverloadedError

_log = structlog.stdlib.get_logger(__name__)


class Periodic:
    """A thread that does something every so many seconds until it is stopped.

    An unexpected error is logged, and the next time comes: nothing here may end because it failed once.
    """

    def __init__(self, name: str, every_s: float, action: Callable[[], object]) -> None:
        self._name = name
        self._every_s = every_s
        self._action = action
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"periodic-{name}", daemon=True)

    def start(self) -> None:
        """Begin; the first time comes after the interval."""
        self._thread.start()

    def stop(self) -> None:
        """End, after what is being done now."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(self._every_s):
            try:
                self._action()
            except OverloadedError as error:
                _log.warning("put off", what=self._name, reason=str(error))
            except Exception:  # noqa: BLE001 - a boundary: logged, and done again next time
                _log.exception("unexpected error", what=self._name)
