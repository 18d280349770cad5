"""What a phone sent, before it is on one time base: each sensor with times of its own.

Times are UTC nanoseconds as exact integers: beyond 2^53 a float no longer tells neighbouring readings apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Self

import msgpack
import numpy as np

from app.engine.types import BoolArray, Float64Array, IntArray
from app.exchange.phones.errors import FormatError

NS = 1_000_000_000
MIN_TIME_NS = -NS * 86_400
MAX_TIME_NS = 4_102_444_800 * NS
"""Times from a day before 1970 (clocks that begin at zero) to the year 2100."""
MAX_VALUE = 1e9
"""No sensor reads more in any unit."""
MAX_TEXT = 2000
"""Characters of an annotation."""
_VERSION = 1
_DAMAGED = "is damaged or of another version; drop it and begin anew"


class Sensor(StrEnum):
    """What is read, with the values of a row."""

    MAGNETOMETER = "magnetometer"
    MAGNETOMETER_UNCALIBRATED = "magnetometer_uncalibrated"
    LINEAR_ACCELERATION = "linear_acceleration"
    GRAVITY = "gravity"
    ACCELERATION = "acceleration"
    GYROSCOPE = "gyroscope"
    PRESSURE = "pressure"
    STEPS = "steps"
    GNSS = "gnss"

    @property
    def width(self) -> int:
        """Values of one reading: uT, m/s^2 or rad/s on three axes; hPa; steps; latitude, longitude, accuracy in m."""
        return 1 if self in _SINGLE else 3


_SINGLE = frozenset({Sensor.PRESSURE, Sensor.STEPS})


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Readings of one sensor.

    Attributes
    ----------
    t_ns : array, shape (n,), int64, ns
        UTC, strictly increasing.
    values : array, shape (n, k), float64
        In the sensor's unit and the phone's own axes; ``k`` is the sensor's width.
    """

    t_ns: IntArray
    values: Float64Array

    def __post_init__(self) -> None:
        if self.t_ns.ndim != 1 or self.values.ndim != 2 or len(self.values) != len(self.t_ns):
            raise FormatError("values", f"needs shape ({self.t_ns.size}, k), got {self.values.shape}")

    def __len__(self) -> int:
        return len(self.t_ns)

    @classmethod
    def ordered(cls, t_ns: IntArray, values: Float64Array) -> Series:
        """Readings in time order; of those of one moment the first that was sent."""
        t_ns, first = np.unique(np.asarray(t_ns, np.int64), return_index=True)
        return cls(t_ns, np.asarray(values, np.float64)[first])

    def where(self, rows: BoolArray | IntArray | slice) -> Series:
        """Some rows."""
        return Series(self.t_ns[rows], self.values[rows])


@dataclass(frozen=True, slots=True, order=True)
class Annotation:
    """What the user noted at a moment: ``t_ns`` UTC ns, and the text."""

    t_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of all sensors that were sent, and annotations in time order."""

    series: Mapping[Sensor, Series] = field(default_factory=dict)
    annotations: tuple[Annotation, ...] = ()

    def __len__(self) -> int:
        return sum(len(one) for one in self.series.values()) + len(self.annotations)

    @classmethod
    def merged(cls, parts: Iterable[Readings]) -> Readings:
        """All parts in time order, in whichever order they came; repeated times are dropped."""
        found: dict[Sensor, list[Series]] = {}
        notes: set[Annotation] = set()
        for part in parts:
            notes.update(part.annotations)
            for sensor, series in part.series.items():
                if len(series):
                    found.setdefault(sensor, []).append(series)
        joined = {
            sensor: Series.ordered(
                np.concatenate([one.t_ns for one in several]), np.concatenate([one.values for one in several])
            )
            for sensor, several in found.items()
        }
        return cls(joined, tuple(sorted(notes)))

    def after(self, t_ns: int) -> Readings:
        """What came after a moment."""
        later = {sensor: one.where(one.t_ns > t_ns) for sensor, one in self.series.items()}
        kept = {sensor: one for sensor, one in later.items() if len(one)}
        return Readings(kept, tuple(note for note in self.annotations if note.t_ns > t_ns))

    def pack(self) -> bytes:
        """As bytes: numbers are kept exactly."""
        content = {
            "version": _VERSION,
            "series": {
                sensor.value: [one.t_ns.astype("<i8").tobytes(), one.values.astype("<f8").tobytes()]
                for sensor, one in self.series.items()
            },
            "notes": [[note.t_ns, note.text] for note in self.annotations],
        }
        packed: bytes = msgpack.packb(content)
        return packed

    @classmethod
    def unpack(cls, content: bytes) -> Self:
        """Inverse of :meth:`pack`.

        Raises
        ------
        FormatError
            Damaged, or packed by another version.
        """
        try:
            found = msgpack.unpackb(content)
        except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
            raise FormatError("readings", _DAMAGED) from error
        if not isinstance(found, dict) or found.get("version") != _VERSION:
            raise FormatError("readings", _DAMAGED)
        series, notes = found.get("series"), found.get("notes")
        if not isinstance(series, dict) or not isinstance(notes, list):
            raise FormatError("readings", _DAMAGED)
        return cls(dict(_series_of(name, parts) for name, parts in series.items()), tuple(map(_note_of, notes)))


def _series_of(name: Any, parts: Any) -> tuple[Sensor, Series]:
    if name not in Sensor.__members__.values() or not (isinstance(parts, list) and len(parts) == 2):
        raise FormatError("readings", _DAMAGED)
    sensor, (times, values) = Sensor(name), parts
    if not (isinstance(times, bytes) and isinstance(values, bytes)) or len(times) % 8:
        raise FormatError("readings", _DAMAGED)
    if len(values) != len(times) * sensor.width:
        raise FormatError("readings", _DAMAGED)
    t_ns = np.frombuffer(times, "<i8").astype(np.int64)
    rows = np.frombuffer(values, "<f8").astype(np.float64).reshape(-1, sensor.width)
    times_fit = not len(t_ns) or (in_time(int(t_ns[0])) and in_time(int(t_ns[-1])))
    if not (np.isfinite(rows).all() and (np.diff(t_ns) > 0).all() and times_fit):
        raise FormatError("readings", _DAMAGED)
    return sensor, Series(t_ns, rows)


def _note_of(parts: Any) -> Annotation:
    if not (isinstance(parts, list) and len(parts) == 2) or type(parts[0]) is not int or not isinstance(parts[1], str):
        raise FormatError("readings", _DAMAGED)
    if not in_time(parts[0]):
        raise FormatError("readings", _DAMAGED)
    return Annotation(parts[0], parts[1])


def in_time(t_ns: int) -> bool:
    """Whether a time can be one of a phone."""
    return bool(MIN_TIME_NS <= t_ns <= MAX_TIME_NS)
