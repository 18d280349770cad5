"""Raw samples as files, written a segment at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum

import msgpack
import numpy as np

from app.api.body import MSGPACK
from app.engine.types import ImuSamples
from app.services.session_samples import NumberedSamples

CSV = "text/csv"
_SENSORS = ("mag", "acc", "gyro")
COLUMNS = ("seq", "t_ms", *(f"{name}_{axis}" for name in _SENSORS for axis in "xyz"))


class SamplesFormat(StrEnum):
    """How samples are written."""

    CSV = "csv"
    MSGPACK = "msgpack"

    @property
    def media_type(self) -> str:
        """What the answer calls itself."""
        return CSV if self is SamplesFormat.CSV else MSGPACK


def write(kind: SamplesFormat, segments: Iterable[NumberedSamples]) -> Iterator[bytes]:
    """The file, a piece a segment."""
    return _csv(segments) if kind is SamplesFormat.CSV else _msgpack(segments)


def _csv(segments: Iterable[NumberedSamples]) -> Iterator[bytes]:
    yield (",".join(COLUMNS) + "\r\n").encode()
    for one in segments:
        t_ms = np.round(one.samples.t * 1000.0, 3).tolist()
        values = np.concatenate([getattr(one.samples, name) for name in _SENSORS], axis=1).tolist()
        rows = (
            f"{one.seq},{time:.3f},{','.join(f'{value:.7g}' for value in row)}\r\n"
            for time, row in zip(t_ms, values, strict=True)
        )
        yield "".join(rows).encode()


def _msgpack(segments: Iterable[NumberedSamples]) -> Iterator[bytes]:
    # one object after the other, each as POST .../segments takes it
    for one in segments:
        yield msgpack.packb({"seq": one.seq, "frame": "android", "samples": _columns(one.samples)})


def _columns(samples: ImuSamples) -> dict[str, object]:
    vectors = {
        name: {axis: getattr(samples, name)[:, i].astype("<f4").tobytes() for i, axis in enumerate("xyz")}
        for name in _SENSORS
    }
    return {"t_ms": (samples.t * 1000.0).astype("<f8").tobytes(), **vectors}
