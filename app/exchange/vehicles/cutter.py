"""Rows that come late, twice or not at all, put in order and cut into segments that the service takes."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from app.engine.types import Float64Array, ImuSamples, SpeedReadings
from app.exchange.vehicles.lines import RESTART_S, Row

MAX_GAP_S = 1.0
"""The service takes no longer hole inside a segment; between segments any time may pass."""
MAX_ROWS = 20_000
MIN_ROWS, MIN_S = 3, 0.3
"""Less than this says nothing of a rate: such a rest is left out."""
REORDER_S = 0.5
"""How long a row is held back for those before it, in the time of the rows."""
RESTART_ROWS = 10
"""Rows in a row that are older than ``RESTART_S``: the clock began anew, or was put back. Fewer are late ones."""
_MIN_STEP_S = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A segment: samples, and the speeds that were read in their time."""

    samples: ImuSamples
    speed: SpeedReadings | None


@dataclass
class Cutter:
    """Takes rows in any order and gives segments in order.

    Attributes
    ----------
    segment_s : float, s
    reorder_s : float, s
        0 for files: their order is that of their rows.
    n_late, n_partial, n_short : int
        Rows that came too late or twice, rows without a reading of every sensor, rows of rests that were too short.
    """

    segment_s: float = 5.0
    reorder_s: float = REORDER_S
    n_late: int = 0
    n_partial: int = 0
    n_short: int = 0
    _waiting: list[tuple[float, int, Row]] = field(default_factory=list)
    _count: int = 0
    _back: int = 0
    _newest: float = -np.inf
    _released: float = -np.inf
    _rows: list[Row] = field(default_factory=list)
    _speeds: list[tuple[float, float]] = field(default_factory=list)

    def put(self, row: Row) -> Iterator[Piece]:
        """Segments that are complete with this row."""
        self._back = self._back + 1 if row.t < self._released - RESTART_S else 0
        if self._back >= RESTART_ROWS:
            yield from self._restart()
        if row.t - self._released < _MIN_STEP_S:
            self.n_late += 1
            return
        # the count keeps rows of one time in the order of their arrival, and rows themselves from being compared
        heapq.heappush(self._waiting, (row.t, self._count, row))
        self._count += 1
        self._newest = max(self._newest, row.t)
        while self._waiting and self._waiting[0][0] <= self._newest - self.reorder_s:
            yield from self._release(heapq.heappop(self._waiting)[2])

    def flush(self) -> Iterator[Piece]:
        """What is left: at the end, or when nothing came for a while."""
        while self._waiting:
            yield from self._release(heapq.heappop(self._waiting)[2])
        yield from self._cut()

    def _restart(self) -> Iterator[Piece]:
        """What is left; the next row may be of any time."""
        yield from self.flush()
        self._newest = self._released = -np.inf
        self._back = 0

    def _release(self, row: Row) -> Iterator[Piece]:
        if row.t - self._released < _MIN_STEP_S:
            self.n_late += 1
            return
        if self._rows and self._ends_before(row):
            yield from self._cut()
        self._released = row.t
        if row.speed is not None:
            self._speeds.append((row.t, row.speed))
        if row.full:
            self._rows.append(row)
        elif row.speed is None:
            self.n_partial += 1

    def _ends_before(self, row: Row) -> bool:
        last, first = self._rows[-1].t, self._rows[0].t
        return row.t - last > MAX_GAP_S or row.t - first >= self.segment_s or len(self._rows) >= MAX_ROWS

    def _cut(self) -> Iterator[Piece]:
        rows, self._rows = self._rows, []
        speeds, self._speeds = self._speeds, []
        if len(rows) < MIN_ROWS or rows[-1].t - rows[0].t < MIN_S:
            self.n_short += len(rows)
            return
        t = np.array([row.t for row in rows])
        sensors = np.array([row.sensors for row in rows])
        samples = ImuSamples(t, sensors[:, 0:3], sensors[:, 3:6], sensors[:, 6:9])
        yield Piece(samples, _readings(speeds))


def _readings(speeds: list[tuple[float, float]]) -> SpeedReadings | None:
    if not speeds:
        return None
    columns: Float64Array = np.array(speeds)
    return SpeedReadings(columns[:, 0], columns[:, 1])
