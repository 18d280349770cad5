"""Messages of our phyphox experiment: columns of readings as JSON, the phone's clock beside them.

::

    {"mx": [...], "my": [...], "mz": [...], "mt": [0.01, 0.02],            magnetometer, uT
     "ax": ..., "at": ...,  "gx": ..., "gt": ...,  "p": ..., "pt": ...,    m/s^2 with gravity, rad/s, hPa
     "la": ..., "lo": ..., "lq": ..., "lt": ...,                           degrees, degrees, m
     "time": {"now": 1698501150.2, "events": [{"event": "START", "experimentTime": 0, "systemTime": 1698501144.401}]},
     "uniqueID": "...", "deviceModel": "...", "deviceManufacturer": "..."}

Times are seconds of the experiment; ``time`` ties them to UTC. phyphox tells acceleration as the platform does: on
Apple's phones its sign is turned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from app.engine.types import Float64Array
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.collecting import Collector, number, plausible, shown
from app.exchange.phones.errors import FormatError
from app.exchange.phones.json_text import parsed
from app.exchange.phones.phyphox_clock import MAX_SECONDS, START, ExperimentClock
from app.exchange.phones.readings import NS, Readings, Sensor, Series

MAX_READINGS = 200_000
_MAX_VALUES = 5 * MAX_READINGS
MAX_ID = 200
_FAR_S = 1e18
_MAX_UNEVEN = 2
"""By so many rows columns may differ: they are sent while the phone measures."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Names of a sensor's columns."""

    values: tuple[str, ...]
    time: str


COLUMNS: Mapping[Sensor, Columns] = {
    Sensor.MAGNETOMETER: Columns(("mx", "my", "mz"), "mt"),
    Sensor.ACCELERATION: Columns(("ax", "ay", "az"), "at"),
    Sensor.GYROSCOPE: Columns(("gx", "gy", "gz"), "gt"),
    Sensor.PRESSURE: Columns(("p",), "pt"),
    Sensor.GNSS: Columns(("la", "lo", "lq"), "lt"),
}
TIME = "time"
UNIQUE_ID, MODEL, MANUFACTURER = "uniqueID", "deviceModel", "deviceManufacturer"
_KNOWN = frozenset(
    {TIME, UNIQUE_ID, MODEL, MANUFACTURER, *(name for one in COLUMNS.values() for name in (*one.values, one.time))}
)


@dataclass(frozen=True, slots=True)
class Body:
    """One message.

    Attributes
    ----------
    unique_id : str
        Of this phone for this address; empty where the message names none.
    started_ns : int, ns
        UTC at which the experiment began: of all messages of one recording the same.
    frame : PhoneFrame or None
        By the device's model; None where the message does not tell it.
    readings : Readings
    ignored : tuple of str
        Names that are not taken.
    dropped : int
        Readings without a value, or with one that no sensor reads.
    """

    unique_id: str
    started_ns: int
    frame: PhoneFrame | None = None
    readings: Readings = field(default_factory=Readings)
    ignored: tuple[str, ...] = ()
    dropped: int = 0


def read_body(body: bytes, *, received_ns: int, started_ns: int | None = None) -> Body:
    """A message of the experiment.

    Parameters
    ----------
    body : bytes
    received_ns : int, ns
        UTC now: a message without ``time`` ended then.
    started_ns : int or None, ns
        Of the messages before; what a message without ``time`` goes by, so that their times fit together.

    Raises
    ------
    FormatError
        Names the field and the remedy.
    """
    found = parsed(body, "body", most=_MAX_VALUES)
    if not isinstance(found, dict):
        raise FormatError("body", f"is {shown(found)}; load the experiment file of this service and send with it")
    collector = Collector(MAX_READINGS, "body")
    raw = {sensor: rows for sensor in COLUMNS if (rows := _rows(found, sensor, collector)) is not None}
    clock = _clock(found.get(TIME)) or _assumed(raw, received_ns, started_ns)
    series = {sensor: Series.ordered(clock.utc_ns(rows[:, -1]), rows[:, :-1]) for sensor, rows in raw.items()}
    return Body(
        unique_id=_text(found, UNIQUE_ID),
        started_ns=clock.started_ns[0],
        frame=_frame(found),
        readings=Readings({sensor: one for sensor, one in series.items() if len(one)}),
        ignored=tuple(sorted(str(name)[:40] for name in found if name not in _KNOWN))[:32],
        dropped=collector.dropped,
    )


def _rows(found: Mapping[str, object], sensor: Sensor, collector: Collector) -> Float64Array | None:
    """Values and experiment time, shape (n, k + 1); None where the message has none."""
    names = (*COLUMNS[sensor].values, COLUMNS[sensor].time)
    columns = [_column(found, name) for name in names if found.get(name) is not None]
    if not columns:
        return None
    if len(columns) != len(names):
        missing = ", ".join(name for name in names if found.get(name) is None)
        raise FormatError(missing, f"is missing beside {names[0]}; load the experiment file of this service again")
    n = min(map(len, columns))
    if max(map(len, columns)) - n > _MAX_UNEVEN:
        raise FormatError(
            names[0], f"has columns of {', '.join(str(len(one)) for one in columns)} values; send as many"
        )
    rows: list[list[float]] = []
    for values in zip(*(column[:n] for column in columns), strict=True):
        collector.row()
        if 0.0 <= values[-1] <= MAX_SECONDS and plausible(sensor, values[:-1]):
            rows.append(list(values))
        else:
            collector.dropped += 1
    return np.array(rows, np.float64).reshape(-1, len(names))


def _column(found: Mapping[str, object], name: str) -> list[float]:
    values = found[name]
    if not isinstance(values, list):
        raise FormatError(name, f"is {shown(values)}; send an array of numbers")
    return [number(value, f"{name}[{place}]") for place, value in enumerate(values)]


def _clock(told: object) -> ExperimentClock | None:
    if told is None:
        return None
    events = told.get("events") if isinstance(told, dict) else None
    if not isinstance(events, list):
        raise FormatError(TIME, "has no events; load the experiment file of this service again")
    starts: list[tuple[float, float]] = []
    for place, event in enumerate(events):
        if not isinstance(event, dict) or not isinstance(kind := event.get("event"), str):
            raise FormatError(f"{TIME}.events[{place}]", "is no event; send event, experimentTime and systemTime")
        if kind.lower() == START:
            began, system = (_seconds(event.get(name)) for name in ("experimentTime", "systemTime"))
            if began is None or system is None:
                raise FormatError(f"{TIME}.events[{place}]", "has no numbers experimentTime and systemTime")
            starts.append((began, system))
    return ExperimentClock.of(starts, f"{TIME}.events") if starts else None


def _seconds(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < _FAR_S else None


def _assumed(raw: Mapping[Sensor, Float64Array], received_ns: int, started_ns: int | None) -> ExperimentClock:
    """The clock of a phone that does not tell it: what it sent last it read just now."""
    if started_ns is not None:
        return ExperimentClock.since(started_ns)
    latest = max((float(rows[:, -1].max()) for rows in raw.values() if len(rows)), default=0.0)
    return ExperimentClock.since(received_ns - round(latest * NS))


def _frame(found: Mapping[str, object]) -> PhoneFrame | None:
    maker, model = _text(found, MANUFACTURER).lower(), _text(found, MODEL).lower()
    if not (maker or model):
        return None
    apple = maker.startswith("apple") or model.startswith(("iphone", "ipad", "ipod"))
    return PhoneFrame.IOS if apple else PhoneFrame.ANDROID


def _text(found: Mapping[str, object], name: str) -> str:
    value = found.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > MAX_ID:
        raise FormatError(name, f"is {shown(value)}; send a text of at most {MAX_ID} characters")
    return value
