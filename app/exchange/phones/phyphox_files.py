"""Recordings that phyphox exports as CSV: a zip file of one table a sensor, or one table.

Columns are called by labels that differ between experiments and languages (``Magnetic Field x (µT)``, ``X (m/s^2)``):
a column's sensor is found by its label, else by its table's name, else by its unit; its axis by the letter before the
unit. Cells are parted by commas, semicolons or tabs, with decimal points or commas. ``meta/time.csv`` ties the
experiment's clock to UTC, ``meta/device.csv`` tells the platform.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.collecting import Collector, from_text, plausible
from app.exchange.phones.errors import FormatError
from app.exchange.phones.phyphox_clock import MAX_SECONDS, START, ExperimentClock
from app.exchange.phones.readings import NS, Readings, Sensor, Series
from app.exchange.phones.recorded import MAX_ROWS, Archive, Recorded, Table, is_zip
from app.exchange.surveys.recording import DEFAULT_START_S

MAX_BYTES = 256 * 2**20
_LABEL = re.compile(r"^(?P<words>[^(\[]*)(?:[(\[](?P<unit>[^)\]]*)[)\]])?$")
_WORDS: tuple[tuple[str, Sensor], ...] = (
    ("linear", Sensor.LINEAR_ACCELERATION), ("without g", Sensor.LINEAR_ACCELERATION), ("gravity", Sensor.GRAVITY),
    ("magnet", Sensor.MAGNETOMETER), ("gyro", Sensor.GYROSCOPE), ("rotation", Sensor.GYROSCOPE),
    ("angular", Sensor.GYROSCOPE), ("accel", Sensor.ACCELERATION), ("pressure", Sensor.PRESSURE),
    ("barometer", Sensor.PRESSURE), ("location", Sensor.GNSS), ("gps", Sensor.GNSS),
)  # fmt: skip
"""What in a label or a table's name tells the sensor; the first that is found counts."""
_UNITS: Mapping[str, Sensor] = {
    "µt": Sensor.MAGNETOMETER, "μt": Sensor.MAGNETOMETER, "ut": Sensor.MAGNETOMETER, "rad/s": Sensor.GYROSCOPE,
    "m/s^2": Sensor.ACCELERATION, "m/s²": Sensor.ACCELERATION, "hpa": Sensor.PRESSURE,
}  # fmt: skip
_GNSS = (("latitude", 0), ("longitude", 1), ("horizontal accuracy", 2))
_META = "meta"


@dataclass(frozen=True, slots=True)
class _Rows:
    """Experiment time and values of a sensor."""

    t: list[float]
    values: list[list[float]]


def read_export(content: bytes, *, start_s: float | None = None) -> Recorded:
    """A recording.

    Parameters
    ----------
    content : bytes
    start_s : float or None, s
        UTC at which the experiment began, for a file that does not tell it.

    Raises
    ------
    FormatError
        Names table, line and column, and the remedy.
    """
    if len(content) > MAX_BYTES:
        raise FormatError("file", f"has {len(content)} bytes; at most {MAX_BYTES} are read: split the recording")
    collector = Collector(MAX_ROWS, "file")
    found: dict[Sensor, _Rows] = {}
    ignored: list[str] = []
    clock: ExperimentClock | None = None
    frame: PhoneFrame | None = None
    for name, folder, table in _tables(content, ignored):
        if folder == _META and name == "time":
            clock = _clock(table)
        elif folder == _META:
            frame = _frame(table) if name == "device" else frame
        elif not _take(table, name, found, collector):
            ignored.append(table.name)
    if not found:
        raise FormatError(
            "file", "has no columns of a sensor with three axes and a time; export it from phyphox as CSV"
        )
    assumed = []
    if clock is None:
        clock = ExperimentClock.since(round((DEFAULT_START_S if start_s is None else start_s) * NS))
        if start_s is None:
            assumed.append("a clock without a date, begun on 2020-01-01 (--start tells the true moment)")
    return Recorded(_placed(found, clock), frame, tuple(ignored[:40]), collector.dropped, tuple(assumed))


def _tables(content: bytes, ignored: list[str]) -> list[tuple[str, str, Table]]:
    """Name, folder (both in lower case) and table."""
    if not is_zip(content):
        table = Table.of("file", content)
        return [] if table is None else [("", "", table)]
    archive = Archive(content)
    tables = []
    for path, inner in archive.tables():
        table = Table.of(str(path)[-80:], inner)
        if table is not None:
            tables.append((path.stem.strip().lower(), path.parent.name.lower(), table))
    ignored.extend(archive.others)
    return tables


def _take(table: Table, name: str, found: dict[Sensor, _Rows], collector: Collector) -> bool:
    """Read a table's sensors; whether it has any."""
    sensors, time = _columns(table, name)
    if not sensors or time is None:
        return False
    for sensor in sensors:
        if sensor in found:
            raise FormatError(table.name, f"has {sensor} once more; send one recording a file")
        found[sensor] = _Rows([], [])
    comma = table.delimiter != ","
    for line, row in table.rows():
        collector.row()
        if not row:
            continue
        t = _cell(row, time, table, line, comma=comma)
        for sensor, places in sensors.items():
            values = [_cell(row, place, table, line, comma=comma) for place in places]
            if 0.0 <= t <= MAX_SECONDS and plausible(sensor, values):
                found[sensor].t.append(t)
                found[sensor].values.append(values)
            elif not all(map(math.isnan, values)):  # shorter columns are filled up with NaN
                collector.dropped += 1
    return True


def _cell(row: Sequence[str], place: int, table: Table, line: int, *, comma: bool) -> float:
    """A number; NaN where the line ends before."""
    if place >= len(row):
        return math.nan
    text = row[place].replace(",", ".") if comma else row[place]
    where = f"{table.name} line {line}: {table.label(place)}"
    return from_text(text, where)


def _columns(table: Table, name: str) -> tuple[dict[Sensor, list[int]], int | None]:
    """Columns of each sensor that has all of its axes, and of the time."""
    time: int | None = None
    found: dict[Sensor, dict[int, int]] = {}
    for place, label in enumerate(table.header):
        parted = _LABEL.match(label[:100])
        if parted is None:
            continue
        words, unit = parted.group("words").strip().lower(), (parted.group("unit") or "").strip().lower()
        if unit == "s" or words == "t":
            time = place if time is None else time
        elif (meant := _meaning(words, unit, name)) is not None:
            found.setdefault(meant[0], {}).setdefault(meant[1], place)
    whole = {sensor: [places[i] for i in sorted(places)] for sensor, places in found.items()}
    return {sensor: places for sensor, places in whole.items() if len(places) == sensor.width}, time


def _meaning(words: str, unit: str, name: str) -> tuple[Sensor, int] | None:
    """Sensor of a column, and which of its values the column is."""
    for word, place in _GNSS:
        if words.startswith(word):
            return Sensor.GNSS, place
    if words.startswith("abs"):
        return None
    sensor = next((one for word, one in _WORDS if word in words), None)
    sensor = sensor or next((one for word, one in _WORDS if word in name), None)
    sensor = sensor or _UNITS.get(unit)
    if sensor is None or sensor is Sensor.GNSS:
        return None
    if sensor.width == 1:
        return sensor, 0
    axis = words[-1:] if len(words) == 1 or words[-2:-1] in {" ", "_"} else ""
    return (sensor, "xyz".index(axis)) if axis and axis in "xyz" else None


def _clock(table: Table) -> ExperimentClock | None:
    """The starts in ``meta/time.csv``: event, experiment time (s), system time (s)."""
    comma = table.delimiter != ","
    starts = []
    for line, row in table.rows():
        if line > MAX_ROWS:
            raise FormatError(table.name, "has too many events; export the recording again")
        if len(row) >= 3 and row[0].strip().lower() == START:
            t, system = (_cell(row, place, table, line, comma=comma) for place in (1, 2))
            starts.append((t, system))
    return ExperimentClock.of(starts, table.name) if starts else None


def _frame(table: Table) -> PhoneFrame | None:
    """Signs by what ``meta/device.csv`` tells of the device: property, value."""
    told = {row[0].strip().lower(): row[1].strip().lower() for _, row in table.rows() if len(row) >= 2}
    maker, brand, model = (told.get(name, "") for name in ("devicemanufacturer", "devicebrand", "devicemodel"))
    if not (maker or brand or model):
        return None
    apple = maker.startswith("apple") or brand.startswith("apple") or model.startswith(("iphone", "ipad", "ipod"))
    return PhoneFrame.IOS if apple else PhoneFrame.ANDROID


def _placed(found: Mapping[Sensor, _Rows], clock: ExperimentClock) -> Readings:
    series = {}
    for sensor, rows in found.items():
        t_ns = clock.utc_ns(np.array(rows.t, np.float64))
        series[sensor] = Series.ordered(t_ns, np.array(rows.values, np.float64).reshape(-1, sensor.width))
    return Readings({sensor: one for sensor, one in series.items() if len(one)})
