"""Segments on disk until the service has them: a dead network loses nothing, and what was first goes first.

A spool is a folder with a file a segment. Files appear whole (written aside, synced, renamed) and go when the service
has the segment, so that a killed process or a power cut costs at most the segment that was being written.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from isodyn_client.aids import Aids
from isodyn_client.samples import Samples

MAX_BYTES = 256 * 2**20
"""About ten hours of a hundred samples a second."""
TRIP_GAP_S = 3600.0
"""After a longer silence, or where time runs back, another trip begins: a session's time only goes on."""
_SUFFIX = ".segment"
_LAST, _REFUSED = "last.json", "refused"


@dataclass(frozen=True, slots=True)
class Entry:
    """One segment in a spool; ``trip`` counts the sessions that a spool's segments go to."""

    name: str
    trip: int
    samples: Samples
    aids: Aids


class Spool:
    """A bounded queue of segments on disk; one thread puts, one takes.

    Parameters
    ----------
    folder : Path
        Made if it is not there. What an earlier process left in it goes first.
    max_bytes : int
        Beyond this the oldest segments are given up (``n_lost``), so that the newest are there when the network is.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self.folder = folder
        self.max_bytes = max_bytes
        self.n_lost = 0
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)
        for unfinished in folder.glob("*.part"):
            unfinished.unlink()
        self._sizes = {file.name: file.stat().st_size for file in sorted(folder.glob(f"*{_SUFFIX}"))}
        self._trip, self._number, self._end_ms = self._read_last()

    def __len__(self) -> int:
        with self._lock:
            return len(self._sizes)

    @property
    def n_bytes(self) -> int:
        """Size of all segments that wait."""
        with self._lock:
            return sum(self._sizes.values())

    def put(self, samples: Samples, aids: Aids | None = None) -> None:
        """Keep a segment. It is on disk when this returns."""
        start_ms, end_ms = float(samples.t_ms[0]), float(samples.t_ms[-1])
        if self._end_ms is None or not 0.0 < start_ms - self._end_ms <= TRIP_GAP_S * 1000.0:
            self._trip += 1
        self._number += 1
        self._end_ms = end_ms
        name = f"{self._trip:06d}-{self._number:010d}{_SUFFIX}"
        content = _packed(samples, aids or Aids())
        self._write(_LAST, json.dumps({"trip": self._trip, "number": self._number, "end_ms": end_ms}).encode())
        self._write(name, content)
        with self._lock:
            self._sizes[name] = len(content)
            surplus = list(self._surplus())
        for old in surplus:
            self.n_lost += 1
            self.drop(old)

    def oldest(self) -> Entry | None:
        """The segment to send next; what cannot be read is put aside."""
        while True:
            with self._lock:
                name = next(iter(self._sizes), None)
            if name is None:
                return None
            try:
                samples, aids = _unpacked((self.folder / name).read_bytes())
            except FileNotFoundError:  # given up meanwhile
                self.drop(name)
            except (ValueError, KeyError, TypeError, msgpack.UnpackException):
                self.refuse(name)
            else:
                return Entry(name, int(name.partition("-")[0]), samples, aids)

    def drop(self, name: str) -> None:
        """Forget a segment: the service has it."""
        with self._lock:
            self._sizes.pop(name, None)
        (self.folder / name).unlink(missing_ok=True)

    def refuse(self, name: str) -> None:
        """Put a segment aside that the service will never take; it stays in the folder ``refused``."""
        aside = self.folder / _REFUSED
        aside.mkdir(exist_ok=True)
        with self._lock:
            self._sizes.pop(name, None)
        with contextlib.suppress(FileNotFoundError):
            (self.folder / name).replace(aside / name)

    def read_state(self) -> dict[str, Any]:
        """What the sender noted; empty if there is nothing, or nothing that can be read."""
        return _json_of(self.folder / "sender.json")

    def write_state(self, state: dict[str, Any]) -> None:
        """Note something for the next process."""
        self._write("sender.json", json.dumps(state).encode())

    def _surplus(self) -> Iterator[str]:
        total = sum(self._sizes.values())
        for name, size in tuple(self._sizes.items())[:-1]:
            if total <= self.max_bytes:
                return
            total -= size
            yield name

    def _read_last(self) -> tuple[int, int, float | None]:
        last = _json_of(self.folder / _LAST)
        newest = next(reversed(self._sizes), "000000-0000000000")
        trip, number = (int(part) for part in newest.removesuffix(_SUFFIX).split("-"))
        return max(trip, last.get("trip", 0)), max(number, last.get("number", 0)), last.get("end_ms")

    def _write(self, name: str, content: bytes) -> None:
        part = self.folder / f"{name}.part"
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(self.folder / name)
        if os.name == "posix":  # elsewhere folders cannot be synced
            handle = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


def _json_of(file: Path) -> dict[str, Any]:
    try:
        value = json.loads(file.read_text())
    except (FileNotFoundError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def _packed(samples: Samples, aids: Aids) -> bytes:
    # sensors travel as float32, so they are kept as that: a segment that is sent again is the same bytes
    columns = {name: getattr(samples, name).astype("<f4").tobytes() for name in ("mag", "acc", "gyro")}
    value = {"frame": samples.frame, "t_ms": samples.t_ms.astype("<f8").tobytes(), **columns, "aids": aids.columns()}
    packed: bytes = msgpack.packb(value)
    return packed


def _unpacked(content: bytes) -> tuple[Samples, Aids]:
    value = msgpack.unpackb(content)
    mag, acc, gyro = (np.frombuffer(value[name], "<f4").reshape(-1, 3) for name in ("mag", "acc", "gyro"))
    return Samples(np.frombuffer(value["t_ms"], "<f8"), mag, acc, gyro, value["frame"]), Aids.from_columns(
        value["aids"]
    )
