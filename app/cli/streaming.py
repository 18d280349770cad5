"""What ``isodyn stream`` does: lines to rows, rows to segments, segments to a spool, and the spool to the service."""

from __future__ import annotations

import fcntl
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import isodyn_client as isodyn
import typer

from app.cli.bridging import say, until_stopped
from app.cli.convert import samples_of, to_ms
from app.cli.errors import CommandError
from app.exchange.vehicles import Cutter, LineReader, Piece, Row

if TYPE_CHECKING:
    from app.cli.sources import Lines

SILENCE_S = 2.0
"""After so long without a line, what there is is sent: nobody knows whether more will come."""
MAX_AHEAD = 32
"""Segments of a file that wait in the spool; reading it faster would only fill the disk."""
GRACE_S = 5.0


class SpoolInUseError(CommandError):
    """Another process sends from this folder; two would send each other's segments."""


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Hold a spool for this process; the claim ends with the process, however that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise SpoolInUseError(
                f"{folder} is used by another isodyn stream; name another one with --spool"
            ) from error
        yield


@dataclass
class Pump:
    """Reads lines and fills the spool.

    Attributes
    ----------
    reader : LineReader
    cutter : Cutter
    spool : Spool
    frame : str
    live : bool
        Lines come as they are measured; else the spool is kept short and reading waits for it.
    pace : callable or None
        Told the end of each segment (Unix s) before it is kept; may wait (``--rate-real``).
    stopped : Event
    """

    reader: LineReader
    cutter: Cutter
    spool: isodyn.Spool
    stopped: threading.Event
    frame: str = "android"
    live: bool = False
    pace: Callable[[float], None] | None = None
    clock: Callable[[], float] = time.monotonic
    n_segments: int = 0
    n_rows: int = 0
    _said: int = 0

    def run(self, source: Lines) -> None:
        """Until the source ends or someone stops it; what is left is kept as a last segment."""
        silent_since = self.clock()
        try:
            for lines in source:
                if self.stopped.is_set():
                    break
                if lines:
                    silent_since = self.clock()
                    for line in lines:
                        self._rows(self.reader.feed(line))
                elif self.clock() - silent_since >= SILENCE_S:
                    self._finish()
                self._tell()
        finally:
            self._finish()
            self._tell()

    def _rows(self, rows: Iterable[Row]) -> None:
        for row in rows:
            self.n_rows += 1
            self._keep(self.cutter.put(row))

    def _finish(self) -> None:
        self._rows(self.reader.judge())
        self._keep(self.cutter.flush())

    def _keep(self, pieces: Iterable[Piece]) -> None:
        for piece in pieces:
            if self.pace is not None:
                self.pace(float(piece.samples.t[-1]))
            while not self.live and len(self.spool) >= MAX_AHEAD and not self.stopped.wait(0.05):
                pass
            self.spool.put(replace(samples_of(piece.samples), frame=self.frame), _aids(piece))
            self.n_segments += 1

    def _tell(self) -> None:
        notes = self.reader.findings.assumed
        for note in notes[self._said :]:
            say(f"taken: {note}")
        self._said = len(notes)

    def words(self) -> Iterator[str]:
        """What was read, and what not."""
        yield f"{self.n_rows} rows, {self.n_segments} segments"
        losses = (
            (self.reader.n_bad, f"lines that cannot be read; the first: {self.reader.first_bad}"),
            (self.cutter.n_late, "rows that came too late or twice"),
            (self.cutter.n_partial, "rows without a reading of every sensor"),
            (self.cutter.n_short, "rows in stretches too short to be sent"),
            (self.spool.n_lost, "segments given up: the spool was full"),
        )
        for n, what in losses:
            if n:
                yield f"left out: {n} {what}"


def _aids(piece: Piece) -> isodyn.Aids | None:
    if piece.speed is None:
        return None
    return isodyn.Aids(speed=isodyn.SpeedReadings(to_ms(piece.speed.t), speed_m_s=piece.speed.speed))


@dataclass
class RealPace:
    """Waits until a segment's time has gone by since the first one began, as if it were measured now."""

    stopped: threading.Event
    clock: Callable[[], float] = time.monotonic
    _begun: tuple[float, float] | None = None

    def __call__(self, t_end: float) -> None:
        """Wait for a segment that ends at ``t_end``."""
        if self._begun is None:
            self._begun = (self.clock(), t_end)
        begun, first = self._begun
        self.stopped.wait(max(0.0, (t_end - first) - (self.clock() - begun)))


@dataclass
class Teller:
    """Prints fixes, and trouble once until it passes."""

    _trouble: str = field(default="")
    n_fixes: int = 0
    failed: Exception | None = None

    def result(self, result: isodyn.SegmentResult) -> None:
        """One line a segment: its newest position."""
        if self._trouble:
            say("connected again")
            self._trouble = ""
        if result.error:
            say(f"segment {result.seq}: {result.error}")
        self.n_fixes += 0 if result.fixes is None else len(result.fixes)
        if result.position is not None:
            typer.echo(line_of(result.position))

    def trouble(self, error: isodyn.IsodynError) -> None:
        """What does not work now."""
        if str(error) != self._trouble:
            say(f"{error}; nothing is lost, trying again" if _passes(error) else f"{error}")
            self._trouble = str(error)


def _passes(error: isodyn.IsodynError) -> bool:
    return not isinstance(error, isodyn.InvalidRequestError | isodyn.TooLargeError)


def line_of(position: isodyn.Position) -> str:
    """A position as a line of text: time, place, 95 % ellipse, what it claims."""
    when = datetime.fromtimestamp(position.t_ms / 1000.0, UTC)
    ellipse = position.ellipse95
    sure = "sure" if position.sure else "not sure"
    size = math.hypot(ellipse.semi_major_m, ellipse.semi_minor_m) / math.sqrt(2)
    return (
        f"{when:%H:%M:%S}.{when.microsecond // 100_000}  x {position.x:8.2f}  y {position.y:8.2f}  95 % {size:5.1f} m  "
        f"{position.status}, {sure}  {position.level_id}"
    )


def stream_lines(pump: Pump, uploader: isodyn.Uploader, source: Lines, teller: Teller) -> None:
    """Fill the spool here and empty it in another thread, until the source ends and all is sent, or someone stops it.

    Raises
    ------
    IsodynError
        The service refuses what cannot be put right by waiting (key, level); what waits stays in the spool.
    """
    finished, over = threading.Event(), threading.Event()

    def send() -> None:
        try:
            uploader.run(pump.stopped, finished)
        except isodyn.IsodynError as error:
            teller.failed = error
            pump.stopped.set()
        finally:
            over.set()

    sender = threading.Thread(target=send, name="uploader")
    sender.start()
    try:
        with until_stopped() as stop:
            pump.run(source)
            finished.set()
            # not by join(): an interrupted one takes the thread for ended (bpo-45274)
            while not over.wait(0.2):
                stop.check()
    finally:
        # who stops it wants the last segment sent, too, if the network is there
        finished.set()
        over.wait(GRACE_S)
        pump.stopped.set()
        over.wait()
        sender.join()
        for words in pump.words():
            say(words)
        waiting = f", {len(pump.spool)} wait in {pump.spool.folder}" if len(pump.spool) else ""
        refused = f", {uploader.n_refused} refused" if uploader.n_refused else ""
        say(f"{uploader.n_sent} segments sent, {teller.n_fixes} fixes{refused}{waiting}")
    if teller.failed is not None:
        raise teller.failed
