"""Recordings that Sensor Logger exports: a zip file of CSV tables, JSON, or one combined CSV table.

A table is called after its sensor (``Magnetometer.csv``); columns ``time`` (UTC ns) and values are found by the
header, for their order differs. ``Metadata.csv`` tells platform and whether units and frames were standardised. The
JSON export is one array of flat objects of texts, ``{"sensor": "Magnetometer", "time": "1698501144401773000", "x":
"1.5", ...}``. In the combined table columns are called after sensor and value (``Magnetometer_x``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.collecting import Collector, from_text, number, time_ns
from app.exchange.phones.errors import FormatError
from app.exchange.phones.json_text import parsed
from app.exchange.phones.readings import Sensor
from app.exchange.phones.recorded import MAX_ROWS, Archive, Recorded, Table, is_zip
from app.exchange.phones.sensor_logger import ANNOTATION, NAMES, values_of

MAX_JSON = 64 * 2**20
"""Bytes of a JSON export: a quarter of an hour of four sensors at 100 Hz."""
MAX_BYTES = 256 * 2**20
_MAX_VALUES = 8_000_000
METADATA = "metadata"
_SIDE_TABLES = frozenset({METADATA, "annotation", "studymetadata"})
_MAX_IGNORED = 40
_SEPARATED = re.compile(r"^(.+?)[_. ]([A-Za-z]+)$")


def read_export(content: bytes) -> Recorded:
    """A recording, of whichever of these formats it is.

    Raises
    ------
    FormatError
        Names file, line and column, and the remedy.
    """
    if len(content) > MAX_BYTES:
        raise FormatError("file", f"has {len(content)} bytes; at most {MAX_BYTES} are read: split the recording")
    if is_zip(content):
        return _from_zip(content)
    if content[:64].lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"[", b"{")):
        return _from_json(content)
    return _from_combined(content)


def frame_of(metadata: Mapping[str, str]) -> PhoneFrame | None:
    """Signs by what is told of the recording: None if its platform is not."""
    platform = metadata.get("platform", "").strip().lower()
    if platform == "android":
        return PhoneFrame.ANDROID
    if platform != "ios":
        return None
    standardised = metadata.get("standardisation", "").strip().lower() == "true"
    return PhoneFrame.STANDARDISED if standardised else PhoneFrame.IOS


def _from_zip(content: bytes) -> Recorded:
    archive = Archive(content)
    collector = Collector(MAX_ROWS, "file")
    read: dict[str, str] = {}
    ignored: list[str] = []
    frame: PhoneFrame | None = None
    for path, table_bytes in archive.tables():
        name = path.stem.strip().lower()
        if name not in NAMES and name not in _SIDE_TABLES:
            ignored.append(path.name[:80])
            continue
        if name in read:
            raise FormatError(str(path)[:120], f"is there twice ({read[name]}); send one recording a file")
        read[name] = str(path)[:120]
        table = Table.of(str(path)[-80:], table_bytes)
        if table is None:
            continue
        if name == METADATA:
            frame = frame_of(_first_row(table))
        elif name == ANNOTATION:
            _annotations(table, collector)
        elif name in NAMES:
            _sensor(table, NAMES[name], collector)
    if not read:
        raise FormatError("file", "holds no table of Sensor Logger (Magnetometer.csv, ...); export it as zip, with CSV")
    return _recorded(collector, frame, ignored + archive.others)


def _first_row(table: Table) -> dict[str, str]:
    for _, row in table.rows():
        if row:
            return dict(zip((name.lower() for name in table.header), row, strict=False))
    return {}


def _sensor(table: Table, sensor: Sensor, collector: Collector) -> None:
    _columns(table, {sensor: _places(table, values_of(sensor))}, collector)


def _places(table: Table, names: Sequence[str]) -> list[int]:
    header = [name.lower() for name in table.header]
    missing = [name for name in names if name.lower() not in header]
    if missing:
        raise FormatError(f"{table.name} header", f"lacks {', '.join(missing)}; export the recording again")
    return [header.index(name.lower()) for name in names]


def _columns(table: Table, sensors: Mapping[Sensor, Sequence[int]], collector: Collector) -> None:
    """Take rows: of each sensor the values in its columns, where they stand."""
    (time,) = _places(table, ("time",))
    several = len(sensors) > 1
    last = max(time, *(place for places in sensors.values() for place in places))
    for line, row in table.rows():
        collector.row()
        if not row:
            continue
        if len(row) <= last:
            collector.dropped += 1  # a recording that was broken off ends in the middle of a line
            continue
        where = f"{table.name} line {line}"
        t_ns = time_ns(row[time], f"{where}: time")
        for sensor, places in sensors.items():
            values = [from_text(row[place], f"{where}: {table.label(place)}") for place in places]
            # tables of several sensors have empty cells wherever another sensor reads
            if not (several and all(map(math.isnan, values))):
                collector.add(sensor, t_ns, values)


def _annotations(table: Table, collector: Collector) -> None:
    time, text = _places(table, ("time", "text"))
    for line, row in table.rows():
        collector.row()
        if len(row) > max(time, text):
            # a comma in the text is not quoted: the cells it parted belong together
            words = ",".join(row[text : text + 1 + max(0, len(row) - len(table.header))])
            collector.note(time_ns(row[time], f"{table.name} line {line}: time"), words)


def _from_json(content: bytes) -> Recorded:
    if len(content) > MAX_JSON:
        raise FormatError("file", f"has {len(content)} bytes of JSON; at most {MAX_JSON} are read: export it as zip")
    found = parsed(content, "file", most=_MAX_VALUES)
    if not isinstance(found, list):
        raise FormatError("file", "is no array of readings; export the recording as JSON, or as zip with CSV")
    collector = Collector(MAX_ROWS, "file")
    ignored: dict[str, None] = {}
    frame: PhoneFrame | None = None
    for place, row in enumerate(found):
        collector.row()
        if not isinstance(row, dict) or not isinstance(name := row.get("sensor"), str):
            raise FormatError(f"[{place}]", "is no reading; each has sensor, time and values")
        plain = name.strip().lower()
        if plain == METADATA:
            frame = frame_of({str(key).lower(): value for key, value in row.items() if isinstance(value, str)})
        elif plain == ANNOTATION:
            text = row.get("text")
            collector.note(time_ns(row.get("time"), f"[{place}].time"), text if isinstance(text, str) else "")
        elif (sensor := NAMES.get(plain)) is not None:
            t_ns = time_ns(row.get("time"), f"[{place}].time")
            collector.add(sensor, t_ns, [number(row.get(one), f"[{place}].{one}") for one in values_of(sensor)])
        elif len(ignored) < _MAX_IGNORED:
            ignored[name[:80]] = None
    return _recorded(collector, frame, list(ignored))


def _from_combined(content: bytes) -> Recorded:
    table = Table.of("file", content)
    sensors = {} if table is None else _combined(table.header)
    if table is None or not sensors:
        raise FormatError(
            "file",
            "is no export of Sensor Logger: neither a zip file nor JSON, nor a table with columns Magnetometer_x",
        )
    collector = Collector(MAX_ROWS, "file")
    _columns(table, sensors, collector)
    return _recorded(collector, None, [])


def _combined(header: Sequence[str]) -> dict[Sensor, list[int]]:
    """Columns of each sensor that has all of its values."""
    found: dict[Sensor, dict[str, int]] = {}
    for place, name in enumerate(header):
        parted = _SEPARATED.match(name[:100])
        if parted and (sensor := NAMES.get(parted.group(1).lower())) is not None:
            found.setdefault(sensor, {}).setdefault(parted.group(2).lower(), place)
    wanted = {sensor: [name.lower() for name in values_of(sensor)] for sensor in found}
    return {
        sensor: [found[sensor][name] for name in names]
        for sensor, names in wanted.items()
        if all(name in found[sensor] for name in names)
    }


def _recorded(collector: Collector, frame: PhoneFrame | None, ignored: Sequence[str]) -> Recorded:
    return Recorded(collector.readings(), frame, tuple(ignored[:_MAX_IGNORED]), collector.dropped)
