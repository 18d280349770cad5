"""Two ways of doing the same work, timed by turns."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

Work = Callable[[], object]
_LEAST_S = 0.004
"""Processor time below which calls are timed several together: the clock's steps and the call of it are no part."""


@dataclass(frozen=True, slots=True)
class Units:
    """What is counted, so that a peer may do less of the same.

    Attributes
    ----------
    what : str
        One unit, with its size: what the times of a row are those of.
    peer : str or None
        Name of the peer, with how it was scaled where it was; None without one.
    ours, theirs : float
        Units in one call.
    note : str
        Why there is no peer, or what else a reader must know.
    """

    what: str
    peer: str | None = None
    ours: float = 1.0
    theirs: float = 1.0
    note: str = ""


class Comparison(NamedTuple):
    """A task ready to run; both do what they do when called and return it."""

    ours: Work
    peer: Work | None
    units: Units


@dataclass(frozen=True, slots=True)
class Row:
    """Result of a task.

    Attributes
    ----------
    task : str
    peer : str or None
    ours_us, peer_us : float, us
        Processor time of a unit, median over rounds; None without a peer.
    ratio : float or None
        Of the peer's time to ours, median of the rounds' ratios.
    what, note : str
        As in :class:`Units`.
    """

    task: str
    peer: str | None
    ours_us: float
    peer_us: float | None
    ratio: float | None
    what: str
    note: str

    def as_dict(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)


def compare(task: str, comparison: Comparison, *, rounds: int, most_s: float) -> Row:
    """Time a task and its peer by turns: a busy moment of the machine meets both.

    Parameters
    ----------
    task : str
    comparison : Comparison
    rounds : int
    most_s : float, s
        Wall clock after which no further round begins; three there are at least, or as many as ``rounds``.
    """
    ours, peer, units = comparison
    many, many_peer = _repeats(ours), _repeats(peer) if peer else 0
    began, times = time.monotonic(), []
    for k in range(rounds):
        if k >= 3 and time.monotonic() - began > most_s:
            break
        own = _cpu_us(ours, many) / units.ours
        times.append((own, _cpu_us(peer, many_peer) / units.theirs if peer else np.nan))
    own_us, peer_us = np.array(times).T
    return Row(
        task,
        units.peer if peer else None,
        float(np.median(own_us)),
        float(np.median(peer_us)) if peer else None,
        float(np.median(peer_us / own_us)) if peer else None,
        units.what,
        units.note,
    )


def _repeats(work: Work) -> int:
    """Calls that take long enough together; the first, not counted, compiles."""
    work()
    once = _cpu_us(work, 1) * 1e-6
    return max(1, int(np.ceil(_LEAST_S / max(once, 1e-7))))


def _cpu_us(work: Work, calls: int) -> float:
    """Processor time of the process for one call, us: a peer's threads count as what they cost."""
    began = time.process_time()
    for _ in range(calls):
        work()
    return 1e6 * (time.process_time() - began) / calls
