"""Lines of a GetSensorData log as they are read; :mod:`app.exchange.surveys.getsensordata` says what they hold."""

from __future__ import annotations

import re
from array import array
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import BinaryIO

from app.engine.errors import InputError
from app.exchange.maps.text import lines_of

MAX_EVENTS = 3_000_000
"""Lines of one log that are kept: two hours of all sensors at 100 Hz."""
MAX_LINE = 64 * 1024
SENSORS = {"MAGN": "mag", "ACCE": "acc", "GYRO": "gyro"}
_MAC = re.compile(r"^[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}$")
_CREATED = re.compile(
    r"%\s*Date of creation:\s*\w{3}\s+(\w{3})\s+(\d{1,2})\s+(\d{2}):(\d{2}):(\d{2})\s+(\S+)\s+(\d{4})", re.IGNORECASE
)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_ZONES_H = {
    "utc": 0, "gmt": 0, "z": 0, "wet": 0, "west": 1, "bst": 1, "cet": 1, "cest": 2, "eet": 2, "eest": 3, "jst": 9,
    "kst": 9, "hkt": 8,
}  # fmt: skip
_MAX_NUMBER = 1e12
"""Whatever a log tells is smaller: readings, seconds, degrees."""


@dataclass(frozen=True, slots=True)
class LogChoices:
    """What the sender says of a log.

    Attributes
    ----------
    floor : str or None
        Only what ``POSI`` places there; ``building:floor`` where a log goes through several buildings.
    radio : bool
        Whether Wi-Fi and BLE readings are taken along.
    start_s : float or None
        Unix seconds at which the log began; None: what its header says.
    aids : bool
        Whether pressure and satellite fixes are taken along.
    """

    floor: str | None = None
    radio: bool = False
    start_s: float | None = None
    aids: bool = False


@dataclass
class Events:
    """Lines of one sensor: application time, sensor time and three values a row."""

    app: array[float] = field(default_factory=lambda: array("d"))
    sensor: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))


@dataclass
class Log:
    """What was read of a log so far."""

    sensors: dict[str, Events] = field(default_factory=lambda: {name: Events() for name in SENSORS})
    positions: list[tuple[float, float, float, float, str]] = field(default_factory=list)
    radio: dict[str, list[tuple[float, str, float]]] = field(default_factory=lambda: {"WIFI": [], "BLE4": []})
    aids: dict[str, list[tuple[float, ...]]] = field(default_factory=lambda: {"PRES": [], "GNSS": []})
    created: float | None = None
    zone: str = ""
    others: Counter[str] = field(default_factory=Counter)
    kept: int = 0
    bad: int = 0
    first_bad: str = ""
    unplaced: int = 0


def read_lines(source: BinaryIO, choices: LogChoices) -> Log:
    """Read a log.

    Raises
    ------
    InputError
        A line that never ends, or too many.
    """
    log = Log()
    for number, line in lines_of(source, longest=MAX_LINE):
        text = line.strip()
        if text.startswith("%"):
            _header(log, text)
        elif text:
            if log.kept >= MAX_EVENTS:
                raise InputError(f"line {number}", f"is beyond {MAX_EVENTS} readings; split the log")
            try:
                _line(log, text.split(";"), choices)
            except (ValueError, IndexError):
                log.bad += 1
                log.first_bad = log.first_bad or f"line {number} ({text[:40]!r})"
    return log


def _header(log: Log, text: str) -> None:
    found = _CREATED.match(text)
    if found is None:
        return
    month, day, hour, minute, second, zone, year = found.groups()
    if month.lower() not in _MONTHS:
        return
    try:
        local = datetime(
            int(year), _MONTHS.index(month.lower()) + 1, int(day), int(hour), int(minute), int(second), tzinfo=UTC
        )
    except ValueError:
        return
    log.zone = "" if zone.lower() in _ZONES_H else zone
    log.created = (local - timedelta(hours=_ZONES_H.get(zone.lower(), 0))).timestamp()


def _line(log: Log, parts: list[str], choices: LogChoices) -> None:
    """Keep what a line holds; ValueError or IndexError if it cannot be read."""
    kind = parts[0].strip().upper()
    if kind in SENSORS:
        app, sensor, x, y, z = (_finite(part) for part in parts[1:6])
        events = log.sensors[kind]
        events.app.append(app)
        events.sensor.append(sensor)
        events.values.extend((x, y, z))
    elif kind == "POSI":
        _position(log, parts)
    elif kind in log.aids and choices.aids:
        places = (1, 3) if kind == "PRES" else (1, 3, 4, 7)
        log.aids[kind].append(tuple(_finite(parts[place]) for place in places))
    elif kind in log.radio and choices.radio and (reading := _reading(kind, parts)) is not None:
        log.radio[kind].append(reading)
    elif re.fullmatch(r"[A-Z][A-Z0-9]{2,5}", kind):
        log.others[kind] += 1
        return
    else:
        raise ValueError(kind)
    log.kept += 1


def _finite(text: str) -> float:
    value = float(text)
    if not abs(value) <= _MAX_NUMBER:
        raise ValueError(text)
    return value


def _position(log: Log, parts: list[str]) -> None:
    t, latitude, longitude = _finite(parts[1]), _finite(parts[3]), _finite(parts[4])
    if latitude == 0.0 and longitude == 0.0:
        log.unplaced += 1  # some versions of the application write a press of the button without a place
        return
    if not (-90 <= latitude <= 90 and -180 <= longitude <= 180):
        raise ValueError(parts[3])
    floor = f"{_finite(parts[5]):g}"
    building = f"{_finite(parts[6]):g}" if len(parts) > 6 and parts[6].strip() else ""
    log.positions.append((t, latitude, longitude, float(building or "nan"), floor))


def _reading(kind: str, parts: list[str]) -> tuple[float, str, float] | None:
    """Time, address and strength; names may hold semicolons, so the address is found by its shape. None without one."""
    fields = [part.strip() for part in parts]
    at = next((i for i, part in enumerate(fields) if _MAC.match(part)), None)
    if at is None:
        return None
    # Wi-Fi lines end in the strength (older ones have no frequency before it), BLE lines have it behind the address
    behind = [part for part in fields[at + 1 :] if part]
    return _finite(fields[1]), fields[at].lower(), _finite(behind[-1 if kind == "WIFI" else 0])
