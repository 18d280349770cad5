"""Answers worth keeping: of pure functions, about things that may go."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

Owner = TypeVar("Owner")
Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Memo(Generic[Owner, Key, Value]):
    """The newest answers about each owner, as long as the owner lives.

    Only for functions of owner and key alone: whether an answer was remembered must not show. Threads may share it; two
    that ask for the same thing at once both work it out.

    Parameters
    ----------
    most : int
        Answers kept of each owner; of more, those that were not asked for the longest go.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = Lock()
        self._known: WeakKeyDictionary[Owner, OrderedDict[Key, Value]] = WeakKeyDictionary()

    def get(self, owner: Owner, key: Key, make: Callable[[], Value]) -> Value:
        """The answer about ``owner`` to ``key``; ``make`` works it out where it is not remembered."""
        with self._lock:
            known = self._known.setdefault(owner, OrderedDict())
            if key in known:
                known.move_to_end(key)
                return known[key]
        value = make()  # not under the lock: others need not wait for it
        with self._lock:
            known[key] = value
            while len(known) > self._most:
                known.popitem(last=False)
        return value
