"""Logs of the Android application GetSensorData, the format of the IPIN competitions, with ``POSI`` as truth.

Fields are parted by semicolons, the first names the line: ``MAGN;app;sensor;x;y;z;accuracy`` (uT), ``ACCE`` (m/s^2,
with gravity), ``GYRO`` (rad/s), ``WIFI;app;sensor;ssid;bssid;...;rss``, ``BLE4;app;...;mac;rssi;...``,
``POSI;app;counter;latitude;longitude;floor;building``, ``PRES;app;sensor;mbar``, ``GNSS;app;sensor;latitude;longitude;
altitude;bearing;accuracy``; other lines are passed over. Sensors tell two times: the sensor's own is even, but its
origin is anybody's; the application's is common to all lines, but late by whatever the phone was busy with.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import BoolArray, Float64Array, ImuSamples, RadioScans, SurveyWalk, Waypoints
from app.exchange.surveys.getsensordata_lines import SENSORS, Log, LogChoices, read_lines
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

__all__ = ["LogChoices", "SensorLog", "aligned", "read_getsensordata", "read_sensor_log"]

_EARLY_PERCENTILE = 5.0
_MAX_SPREAD_S = 0.5
"""Delays between sensor and application that vary by more are no delays: one of the clocks jumped."""


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
    log = read_lines(source, choices)
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
    log = read_lines(source, choices)
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


def _account(log: Log, findings: Findings) -> None:
    enough(log.bad, log.kept + log.bad, log.first_bad, findings)
    missing = [name for name, events in log.sensors.items() if len(events.app) < 2]
    if missing:
        raise InputError("file", f"has no {', '.join(missing)} lines; send a log of GetSensorData with these sensors")
    if log.others:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(log.others.items()))
        findings.skipped.append(f"lines that are not needed: {kinds}")


def _account_positions(log: Log, findings: Findings) -> None:
    if log.unplaced:
        findings.skipped.append(f"{log.unplaced} POSI lines without a place (0, 0)")
    if not log.positions:
        raise InputError("file", "has no POSI line with a place; a survey needs positions, two a walk at least")


def _each_sensor(log: Log, findings: Findings) -> dict[str, tuple[Float64Array, Float64Array]]:
    """Times, in application time and rising, and values of each sensor."""
    readings = {}
    for kind, name in SENSORS.items():
        events = log.sensors[kind]
        t = aligned(np.array(events.app), np.array(events.sensor), kind, findings)
        values = np.array(events.values).reshape(-1, 3)
        order = np.argsort(t, kind="stable")
        keep = order[rising(t[order])]
        readings[name] = (t[keep], values[keep])
    return readings


def _one_time_base(log: Log, findings: Findings) -> ImuSamples:
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


def _start(log: Log, choices: LogChoices, findings: Findings) -> float:
    if choices.start_s is not None:
        return choices.start_s
    if log.created is None:
        findings.assume("a log without a date, begun on 2020-01-01 (--start tells the true moment)")
        return DEFAULT_START_S
    if log.zone:
        findings.assume(f"its date as UTC: the time zone {log.zone!r} is not known")
    return log.created


def _waypoints(log: Log, plane: TangentPlane | None) -> tuple[Waypoints, tuple[str, ...]]:
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
