"""Rows of a message or file, one after the other, into readings: within bounds, and only values that can be true."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import MAX_TEXT, MAX_VALUE, Annotation, Readings, Sensor, Series, in_time

MAX_NOTES = 10_000
_PLAUSIBLE: Mapping[Sensor, tuple[tuple[float, float], ...]] = {
    Sensor.PRESSURE: ((300.0, 1200.0),),
    Sensor.STEPS: ((0.0, 1e9),),
    Sensor.GNSS: ((-90.0, 90.0), (-180.0, 180.0), (0.01, 1e5)),
}
"""What values can be, of sensors whose platforms tell "invalid" by a value (mostly a negative one)."""


@dataclass(slots=True)
class _Rows:
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


@dataclass
class Collector:
    """Takes rows and gives readings.

    Parameters
    ----------
    limit : int
        Rows at most.
    what : str
        What they are rows of, for the error: ``message`` or ``file``.
    """

    limit: int
    what: str
    dropped: int = 0
    """Rows without a value, or with one that no sensor reads."""
    count: int = 0
    _rows: dict[Sensor, _Rows] = field(default_factory=dict)
    _notes: list[Annotation] = field(default_factory=list)

    def row(self) -> None:
        """Count a row, whatever it holds.

        Raises
        ------
        FormatError
            There are more than ``limit``.
        """
        self.count += 1
        if self.count > self.limit:
            raise FormatError(self.what, f"holds more than {self.limit} readings; send it in parts")

    def add(self, sensor: Sensor, t_ns: int, values: Sequence[float]) -> None:
        """Take a reading, NaN where a value is missing."""
        if not plausible(sensor, values):
            self.dropped += 1
            return
        rows = self._rows.get(sensor)
        if rows is None:
            rows = self._rows[sensor] = _Rows()
        rows.t_ns.append(t_ns)
        rows.values.extend(values)

    def note(self, t_ns: int, text: str) -> None:
        """Take an annotation; one without a text is a press of the button, and where it is made is known otherwise."""
        if len(self._notes) >= MAX_NOTES:
            raise FormatError(self.what, f"holds more than {MAX_NOTES} annotations; send it in parts")
        self._notes.append(Annotation(t_ns, text.strip()[:MAX_TEXT]))

    def readings(self) -> Readings:
        """All that was taken, in time order."""
        series = {
            sensor: Series.ordered(
                np.array(rows.t_ns, np.int64), np.array(rows.values, np.float64).reshape(-1, sensor.width)
            )
            for sensor, rows in self._rows.items()
        }
        return Readings(series, tuple(sorted(set(self._notes))))


def plausible(sensor: Sensor, values: Sequence[float]) -> bool:
    """Whether a reading can be true."""
    ranges = _PLAUSIBLE.get(sensor)
    if ranges is None:
        return all(-MAX_VALUE <= value <= MAX_VALUE for value in values)
    if sensor is Sensor.STEPS and not values[0].is_integer():
        return False
    return all(low <= value <= high for (low, high), value in zip(ranges, values, strict=True))


def number(value: object, place: str) -> float:
    """A number as JSON has it, or as text; NaN where there is none.

    Raises
    ------
    FormatError
        Neither a number nor nothing.
    """
    if value is None:
        return math.nan
    if type(value) is float or type(value) is int:
        return float(value) if abs(value) <= MAX_VALUE else math.nan
    if isinstance(value, str):
        return from_text(value, place)
    raise FormatError(place, f"is {shown(value)}; send a number")


def from_text(text: str, place: str) -> float:
    """A number written as text; NaN for an empty one."""
    plain = text.strip()
    if plain.lower() in {"", "nan", "null", "none", "undefined"}:
        return math.nan
    try:
        return float(plain)
    except ValueError as error:
        raise FormatError(place, f"is {shown(text)}; send a number") from error


def time_ns(value: object, place: str) -> int:
    """UTC nanoseconds as an exact integer.

    Raises
    ------
    FormatError
        No integer, or one that is no time of a phone.
    """
    if isinstance(value, str) and len(value) <= 20 and value.strip().lstrip("-").isascii():
        plain = value.strip()
        value = int(plain) if plain.lstrip("-").isdigit() and plain.count("-") <= 1 else value
    if type(value) is not int:
        raise FormatError(place, f"is {shown(value)}; send nanoseconds since 1970 as an integer")
    if not in_time(value):
        raise FormatError(place, f"is {value}, no time between 1970 and 2100; send nanoseconds since 1970 (UTC)")
    return value


def shown(value: object) -> str:
    """A value for an error message, short whatever it is."""
    if isinstance(value, str):
        return repr(value[:40])
    if isinstance(value, bool | int | float) or value is None:
        return repr(value)[:40]
    return "an object" if isinstance(value, dict) else "an array" if isinstance(value, list) else "something else"
