"""The clock of a phyphox experiment: seconds since its first start, standing still while it is paused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.types import Float64Array, IntArray
from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import MAX_TIME_NS, MIN_TIME_NS, NS

START = "start"
MAX_EVENTS = 10_000
MAX_SECONDS = 1e8
"""Of experiment time: three years."""


@dataclass(frozen=True, slots=True)
class ExperimentClock:
    """Where experiment time lies in UTC, run by run.

    Attributes
    ----------
    started_ns : tuple of int, ns
        UTC of each start, in order.
    began_s : tuple of float, s
        Experiment time of each start.
    """

    started_ns: tuple[int, ...]
    began_s: tuple[float, ...]

    @classmethod
    def since(cls, started_ns: int) -> ExperimentClock:
        """An experiment that has not been paused."""
        return cls((started_ns,), (0.0,))

    @classmethod
    def of(cls, starts: Sequence[tuple[float, float]], place: str) -> ExperimentClock:
        """Clock of pairs (experiment time, UTC seconds) of all starts.

        Raises
        ------
        FormatError
            No start, too many, or times that do not go on.
        """
        if not starts or len(starts) > MAX_EVENTS:
            raise FormatError(place, f"tells {len(starts)} starts; send from 1 to {MAX_EVENTS}")
        began = tuple(experiment for experiment, _ in starts)
        if any(not 0.0 <= one <= MAX_SECONDS for one in began) or any(np.diff(began) < 0):
            raise FormatError(place, "has starts whose experiment times do not go on; export the recording again")
        if any(not MIN_TIME_NS / NS <= system <= MAX_TIME_NS / NS - MAX_SECONDS for _, system in starts):
            raise FormatError(place, "has a start at no time between 1970 and 2096; send seconds since 1970 (UTC)")
        # system time is told in milliseconds; more digits are noise of the division
        return cls(tuple(round(system * 1000.0) * 1_000_000 for _, system in starts), began)

    def utc_ns(self, seconds: Float64Array) -> IntArray:
        """UTC of experiment times: of those at which a pause ended, after it."""
        began, started = np.array(self.began_s), np.array(self.started_ns, np.int64)
        run = np.maximum(np.searchsorted(began, seconds, "right") - 1, 0)
        since: IntArray = np.round((seconds - began[run]) * NS).astype(np.int64)
        return started[run] + since
