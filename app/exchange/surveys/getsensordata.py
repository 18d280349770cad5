"""Logs of the Android application GetSensorData, the format of the IPIN competitions, with ``POSI`` as truth.

Fields are parted by semicolons, the first names the line: ``MAGN;app;sensor;x;y;z;accuracy`` (uT), ``ACCE`` (m/s^2,
with gravity), ``GYRO`` (rad/s), ``WIFI;app;sensor;ssid;bssid;...;rss``, ``BLE4;app;...;mac;rssi;...``,
``POSI;app;counter;latitude;longitude;floor;building``, ``PRES;app;sensor;mbar``, ``GNSS;app;sensor;latitude;longitude;
altitude;bearing;accuracy``; other lines are passed over. Sensors tell two times: the
sensor's own is even, but its origin is anybody's; the application's is common to all lines, but late by whatever the
phone was busy with.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import BoolArray, Float64Array, ImuSamples, RadioScans, SurveyWalk, Waypoints
from app.exchange.maps.text import lines_of
from app.exchange.surveys.recording import (
    DEFAULT_START_S,
    MAX_GAP_S,
    Findings,
    Recording,
    enough,
    placed,
    rising,
    walks_of,
)

MAX_EVENTS = 3_000_000
"""Lines of one log that are kept: two hours of all sensors at 100 Hz."""
MAX_LINE = 64 * 1024
_SENSORS = {"MAGN": "mag", "ACCE": "acc", "GYRO": "gyro"}
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
_EARLY_PERCENTILE = 5.0
_MAX_SPREAD_S = 0.5
"""Delays between sensor and application that vary by more are no delays: one of the clocks jumped."""


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


@dataclass(frozen=True, slots=True, eq=False)
class SensorLog:
    """What a log tells of a trip, positions aside.

    Attributes
    ----------
    readings : mapping
        ``mag``, ``acc``, ``gyro``, ``pressure`` (hPa), ``gnss`` (latitude, longitude, accuracy in m) to times
        (n,) UTC s, rising, and values (n, k).
    wifi, ble : RadioScans or None
    """

    readings: Mapping[str, tuple[Float64Array, Float64Array]]
    wifi: RadioScans | None = None
    ble: RadioScans | None = None


@dataclass
class _Events:
    """Lines of one sensor: application time, sensor time and three values a row."""

    app: array[float] = field(default_factory=lambda: array("d"))
    sensor: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))


@dataclass
class _Log:
    """What was read of a log so far."""

    sensors: dict[str, _Events] = field(default_factory=lambda: {name: _Events() for name in _SENSORS})
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


def read_getsensordata(
    source: BinaryIO, name: str, choices: LogChoices, plane: TangentPlane | None, findings: Findings
) -> Iterator[SurveyWalk]:
    """Walks of a log.

    Parameters
    ----------
    source : binary file
    name : str
        Of the walks.
    choices : LogChoices
    plane : TangentPlane or None
        Takes the latitudes and longitudes of ``POSI`` to level metres.
    findings : Findings
        Is told what was read, assumed and left out.

    Raises
    ------
    InputError
        No such log, no positions, no anchor; names the line and the remedy.
    """
    log = _read(source, choices)
    _account(log, findings)
    _account_positions(log, findings)
    samples = _one_time_base(log, findings)
    start = _start(log, choices, findings)
    waypoints, floors = _waypoints(log, plane)
    recording = Recording(
        name=name,
        samples=ImuSamples(samples.t + start, samples.mag, samples.acc, samples.gyro),
        waypoints=Waypoints(waypoints.t + start, waypoints.x, waypoints.y),
        floors=floors,
        wifi=_scans(log.radio["WIFI"], start) if choices.radio else None,
        ble=_scans(log.radio["BLE4"], start) if choices.radio else None,
    )
    yield from walks_of(recording, choices.floor, findings)


def read_sensor_log(source: BinaryIO, choices: LogChoices, findings: Findings) -> SensorLog:
    """A log as a trip to be located: no positions are needed.

    Raises
    ------
    InputError
        No such log; names the line and the remedy.
    """
    log = _read(source, choices)
    _account(log, findings)
    start = _start(log, choices, findings)
    readings = {name: (t + start, values) for name, (t, values) in _each_sensor(log, findings).items()}
    for kind, name in (("PRES", "pressure"), ("GNSS", "gnss")):
        if rows := sorted(set(log.aids[kind])):
            table = np.array(rows, np.float64)
            fresh = rising(table[:, 0])
            readings[name] = (table[fresh, 0] + start, table[fresh, 1:])
    wifi, ble = (_scans(log.radio[kind], start) if choices.radio else None for kind in ("WIFI", "BLE4"))
    return SensorLog(readings, wifi, ble)


def _read(source: BinaryIO, choices: LogChoices) -> _Log:
    log = _Log()
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


def _header(log: _Log, text: str) -> None:
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


def _line(log: _Log, parts: list[str], choices: LogChoices) -> None:
    """Keep what a line holds; ValueError or IndexError if it cannot be read."""
    kind = parts[0].strip().upper()
    if kind in _SENSORS:
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


def _position(log: _Log, parts: list[str]) -> None:
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


def _account(log: _Log, findings: Findings) -> None:
    enough(log.bad, log.kept + log.bad, log.first_bad, findings)
    missing = [name for name, events in log.sensors.items() if len(events.app) < 2]
    if missing:
        raise InputError("file", f"has no {', '.join(missing)} lines; send a log of GetSensorData with these sensors")
    if log.others:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(log.others.items()))
        findings.skipped.append(f"lines that are not needed: {kinds}")


def _account_positions(log: _Log, findings: Findings) -> None:
    if log.unplaced:
        findings.skipped.append(f"{log.unplaced} POSI lines without a place (0, 0)")
    if not log.positions:
        raise InputError("file", "has no POSI line with a place; a survey needs positions, two a walk at least")


def _each_sensor(log: _Log, findings: Findings) -> dict[str, tuple[Float64Array, Float64Array]]:
    """Times, in application time and rising, and values of each sensor."""
    readings = {}
    for kind, name in _SENSORS.items():
        events = log.sensors[kind]
        t = aligned(np.array(events.app), np.array(events.sensor), kind, findings)
        values = np.array(events.values).reshape(-1, 3)
        order = np.argsort(t, kind="stable")
        keep = order[rising(t[order])]
        readings[name] = (t[keep], values[keep])
    return readings


def _one_time_base(log: _Log, findings: Findings) -> ImuSamples:
    """All sensors at the times of the magnetometer, in application time."""
    readings = _each_sensor(log, findings)
    t, mag = readings["mag"]
    inside = _covered(t, readings["acc"][0]) & _covered(t, readings["gyro"][0])
    if not inside.all():
        findings.skipped.append(f"{int((~inside).sum())} magnetometer readings while another sensor was silent")
    if not inside.any():
        raise InputError("file", "has no time at which all three sensors read; are their clocks the same?")
    t, mag = t[inside], mag[inside]
    acc, gyro = (_interpolated(t, *readings[name]) for name in ("acc", "gyro"))
    return ImuSamples(t, mag, acc, gyro)


def aligned(app: Float64Array, sensor: Float64Array, kind: str, findings: Findings) -> Float64Array:
    """Times of readings on the application's clock.

    A reading reaches the application late, never early, so the shortest delays tell the offset of the sensor's
    clock: the fifth percentile, which a few odd stamps do not move. Where delays vary beyond reason (a clock that jumps
    or runs at another pace), the application's times are taken as they are.
    """
    delay = app - sensor
    early, late = np.percentile(delay, [_EARLY_PERCENTILE, 100.0 - _EARLY_PERCENTILE])
    if late - early > _MAX_SPREAD_S:
        findings.assume(f"{kind} at the application's times: its own clock jumps")
        return app
    times: Float64Array = sensor + early
    return times


def _covered(t: Float64Array, other: Float64Array) -> BoolArray:
    """Where readings of another sensor stand close before and after."""
    after = np.searchsorted(other, t)
    inside = (after > 0) & (after < len(other))
    at = np.clip(after, 1, len(other) - 1)
    covered: BoolArray = inside & (other[at] - other[at - 1] <= MAX_GAP_S)
    return covered


def _interpolated(t: Float64Array, times: Float64Array, values: Float64Array) -> Float64Array:
    return np.stack([np.interp(t, times, values[:, i]) for i in range(3)], axis=1)


def _start(log: _Log, choices: LogChoices, findings: Findings) -> float:
    if choices.start_s is not None:
        return choices.start_s
    if log.created is None:
        findings.assume("a log without a date, begun on 2020-01-01 (--start tells the true moment)")
        return DEFAULT_START_S
    if log.zone:
        findings.assume(f"its date as UTC: the time zone {log.zone!r} is not known")
    return log.created


def _waypoints(log: _Log, plane: TangentPlane | None) -> tuple[Waypoints, tuple[str, ...]]:
    rows = sorted(log.positions)
    t, latitude, longitude, building = (np.array([row[i] for row in rows]) for i in range(4))
    fresh = rising(t)
    x, y = placed(latitude[fresh], longitude[fresh], plane, "POSI")
    several = len(np.unique(building[np.isfinite(building)])) > 1
    labels = _labels([row[4] for row in rows], building, several=several)
    floors = tuple(label for label, keep in zip(labels, fresh, strict=True) if keep)
    return Waypoints(t[fresh], x, y), floors


def _labels(floors: Sequence[str], building: Float64Array, *, several: bool) -> list[str]:
    return [f"{b:g}:{floor}" if several else floor for floor, b in zip(floors, building, strict=True)]


def _scans(rows: Sequence[tuple[float, str, float]], start: float) -> RadioScans | None:
    usable = sorted(row for row in rows if -150.0 <= row[2] < 0.0)
    if not usable:
        return None
    t, address, rssi = zip(*usable, strict=True)
    return RadioScans(np.array(t) + start, tuple(address), np.array(rssi))
