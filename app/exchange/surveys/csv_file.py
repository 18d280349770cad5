"""Survey recordings as CSV: a header, one row a sample, positions in some or all rows."""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import Float64Array, ImuSamples, IntArray, SurveyWalk, Waypoints
from app.exchange.maps.text import lines_of
from app.exchange.surveys.headers import SENSORS, Columns, columns_of
from app.exchange.surveys.recording import MAX_VALUE, Findings, Recording, enough, placed, rising, walks_of
from app.exchange.surveys.units import CLOCKS, QUANTITIES, factor_of, to_seconds, unit_of

MAX_ROWS = 1_000_000
"""Rows of one file: five hours at 50 Hz, 350 MB in memory."""
MAX_LINE = 64 * 1024
_DELIMITERS = (",", ";", "\t", "|")
MAX_TIME = 1e20
"""Nanoseconds since 1970 are 2e18."""
_RESTART_S = 1.0
"""A clock that runs back by more begins another recording."""
_MAX_WALKS = 10_000


@dataclass(frozen=True, slots=True)
class CsvChoices:
    """What the sender says of a file.

    Attributes
    ----------
    columns : mapping
        Role (``t``, ``x``, ``lat``, ``mag_x``, ...) to header, where a header is none of the known names.
    units : mapping
        ``mag``, ``acc``, ``gyro`` or ``t`` to a unit; wins over the header's.
    floor : str or None
        Only rows there, where the file has a column ``floor``.
    start_s : float or None
        Unix seconds at which a clock without a date began.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    floor: str | None = None
    start_s: float | None = None


@dataclass
class _Table:
    """Rows as they are read; NaN where a cell is empty."""

    n_sensors: int = len(SENSORS)
    t: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))
    walk: array[int] = field(default_factory=lambda: array("i"))
    floor: array[int] = field(default_factory=lambda: array("i"))
    walks: dict[str, int] = field(default_factory=dict)
    floors: dict[str, int] = field(default_factory=dict)
    bad: int = 0
    first_bad: str = ""
    rows: int = 0
    naive: bool = False
    dated: bool = False

    @property
    def width(self) -> int:
        """Sensors, and two columns of the position."""
        return self.n_sensors + 2


def read_csv(
    source: BinaryIO, name: str, choices: CsvChoices, plane: TangentPlane | None, findings: Findings
) -> Iterator[SurveyWalk]:
    """Walks of a CSV file.

    Parameters
    ----------
    source : binary file
    name : str
        Of the walks.
    choices : CsvChoices
    plane : TangentPlane or None
        Takes latitude and longitude to level metres.
    findings : Findings
        Is told what was read, assumed and left out.

    Raises
    ------
    InputError
        Names the line, column or unit, and the remedy.
    """
    columns, table = _read(source, choices)
    enough(table.bad, table.rows, table.first_bad, findings)
    if not len(table.t):
        raise InputError("file", "has no row below its header; send one row a sample")
    t = _times(table, columns, choices, findings)
    sheet = _Sheet(columns, table, np.frombuffer(table.values).reshape(-1, table.width), t)
    factors = sheet.factors(_units(columns, choices), findings)
    walk = np.frombuffer(table.walk, np.int32)
    labels = list(table.walks)
    for number, rows in enumerate(_recordings(t, walk), start=1):
        if number > _MAX_WALKS:
            raise InputError("t", f"runs back more than {_MAX_WALKS} times; is this the time column?")
        title = " ".join(part for part in (name, labels[walk[rows[0]]]) if part)
        samples = sheet.samples(rows, factors, title, findings)
        if samples is not None:
            waypoints, floors = sheet.positions(rows, plane)
            yield from walks_of(Recording(title, samples, waypoints, floors), choices.floor, findings)


def _read(source: BinaryIO, choices: CsvChoices) -> tuple[Columns, _Table]:
    lines = lines_of(source, longest=MAX_LINE)
    number, header = _first(lines)
    delimiter = delimiter_of(header)
    columns = columns_of(cells_of(header, delimiter, number), choices.columns)
    table = _Table()
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if table.rows >= MAX_ROWS:
            raise InputError(f"line {number}", f"is beyond {MAX_ROWS} rows; split the file")
        table.rows += 1
        try:
            _add(table, columns, cells_of(line, delimiter, number), number, delimiter)
        except InputError as error:
            table.bad += 1
            table.first_bad = table.first_bad or str(error)
    return columns, table


def _first(lines: Iterator[tuple[int, str]]) -> tuple[int, str]:
    for number, line in lines:
        if line.strip() and not line.lstrip().startswith("#"):
            return number, line
    raise InputError("file", "is empty; send a header line and one row a sample")


def delimiter_of(header: str) -> str | None:
    """The separator that comes most often; None: white space."""
    best = max(_DELIMITERS, key=header.count)
    return best if best in header else None


def cells_of(line: str, delimiter: str | None, number: int) -> list[str]:
    """Cells of a line; quotes are read where there are any."""
    if delimiter is None:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration) as error:
        raise InputError(f"line {number}", f"is no CSV ({error}); correct the quotes") from error


def _add(table: _Table, columns: Columns, cells: list[str], number: int, delimiter: str | None) -> None:
    """Put a row into the table, or nothing of it if it cannot be read."""
    index = columns.index
    place = ("lat", "lon") if columns.is_geographic else ("x", "y")
    needed = max(index.values())
    if len(cells) <= needed:
        raise InputError(f"line {number}", f"has {len(cells)} columns, {needed + 1} are needed; complete the line")
    comma = delimiter != ","
    t = _time(table, cells[index["t"]].strip(), number, comma=comma)
    values = [number_in(cells[index[role]], number, comma=comma) for role in (*SENSORS, *place)]
    table.t.append(t)
    table.values.extend(values)
    table.walk.append(_code(table.walks, cells, index.get("walk")))
    table.floor.append(_code(table.floors, cells, index.get("floor")))


def _code(table: dict[str, int], cells: list[str], column: int | None) -> int:
    text = "" if column is None else cells[column].strip()
    return table.setdefault(text.removesuffix(".0"), len(table))


def number_in(text: str, number: int, *, comma: bool) -> float:
    """A number; NaN for an empty cell. Decimal commas are read where the comma does not part columns."""
    plain = text.strip()
    if plain.lower() in {"", "nan", "null", "none", "na", "n/a", "-"}:
        return math.nan
    try:
        value = float(plain.replace(",", ".") if comma else plain)
    except ValueError as error:
        raise InputError(
            f"line {number}", f"has {plain[:30]!r} where a number should be; correct or remove it"
        ) from error
    return value if abs(value) <= MAX_VALUE else math.nan


def _time(table: _Table, text: str, number: int, *, comma: bool) -> float:
    value = math.nan
    try:
        value = float(text.replace(",", ".") if comma else text)
    except ValueError:
        value = _date(table, text.strip('"'))
    if not abs(value) <= MAX_TIME:
        raise InputError(f"line {number}", f"has the time {text[:30]!r}; send a number, or ISO 8601")
    return value


def _date(table: _Table, text: str) -> float:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    if when.tzinfo is None:
        table.naive = True
        when = when.replace(tzinfo=UTC)
    table.dated = True
    try:
        return when.timestamp()
    except (OverflowError, ValueError):
        return math.nan


def _units(columns: Columns, choices: CsvChoices) -> dict[str, str]:
    units = dict(columns.units)
    for name, text in choices.units.items():
        if name == "t":
            found = text if text in CLOCKS else None
        elif name in QUANTITIES:
            found = unit_of(name, text)
        else:
            raise InputError("unit", f"{name!r} has no unit; name one of t, {', '.join(QUANTITIES)}")
        if found is None:
            known = CLOCKS if name == "t" else QUANTITIES[name].factors
            raise InputError("unit", f"{text!r} is no unit of {name}; name one of {', '.join(known)}")
        units[name] = found
    return units


def _times(table: _Table, columns: Columns, choices: CsvChoices, findings: Findings) -> Float64Array:
    raw = np.frombuffer(table.t)
    if table.naive:
        findings.assume("dates without a time zone, as UTC")
    return raw if table.dated else to_seconds(raw, _units(columns, choices).get("t"), choices.start_s, findings)


def _recordings(t: Float64Array, walk: IntArray | np.ndarray[tuple[int], np.dtype[np.int32]]) -> Iterator[IntArray]:
    """Rows of each recording: one a walk, a new one where the clock starts again."""
    order = np.argsort(walk, kind="stable")
    breaks = (np.diff(walk[order]) != 0) | (np.diff(t[order]) < -_RESTART_S)
    yield from np.split(order, np.flatnonzero(breaks) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """All rows of a file: ``values`` (rows, sensors and position), NaN where a cell is empty; ``t`` (rows,) Unix s."""

    columns: Columns
    table: _Table
    values: Float64Array
    t: Float64Array

    def factors(self, units: Mapping[str, str], findings: Findings) -> dict[str, float]:
        """What takes each sensor to the engine's unit, the same for all walks of the file."""
        full = np.isfinite(self.values[:, : self.table.n_sensors]).all(axis=1)
        if not full.any():
            raise InputError("file", "has no row with a reading of every sensor; send all sensors on one time base")
        return {
            sensor: factor_of(sensor, self.values[full, 3 * i : 3 * i + 3], units.get(sensor), findings)
            for i, sensor in enumerate(QUANTITIES)
        }

    def samples(self, rows: IntArray, factors: Mapping[str, float], name: str, findings: Findings) -> ImuSamples | None:
        """Rows with a reading of every sensor, in time order; None if there is none."""
        sensors, t = self.values[rows, : self.table.n_sensors], self.t[rows]
        full = np.isfinite(sensors).all(axis=1)
        partly = int((np.isfinite(sensors).any(axis=1) & ~full).sum())
        if partly:
            findings.skipped.append(f"{name}: {partly} rows without a reading of every sensor")
        ordered = np.zeros(len(rows), dtype=bool)
        ordered[np.flatnonzero(full)[rising(t[full])]] = True
        if (late := int((full & ~ordered).sum())) > 0:
            findings.skipped.append(f"{name}: {late} rows whose time does not go on")
        if not ordered.any():
            findings.skipped.append(f"{name}: no row with a reading of every sensor")
            return None
        blocks = {one: sensors[ordered, 3 * i : 3 * i + 3] * factor for i, (one, factor) in enumerate(factors.items())}
        return ImuSamples(t[ordered], **blocks)

    def positions(self, rows: IntArray, plane: TangentPlane | None) -> tuple[Waypoints, tuple[str, ...]]:
        """Positions at the first row that has each, with their floors: later rows that repeat one were filled in."""
        xy, t = self.values[rows, self.table.n_sensors :], self.t[rows]
        known = np.flatnonzero(np.isfinite(xy).all(axis=1))
        fresh = np.ones(len(known), dtype=bool)
        fresh[1:] = (np.diff(xy[known], axis=0) != 0).any(axis=1)
        known = known[fresh]
        known = known[rising(t[known])] if len(known) else known
        a, b = xy[known, 0], xy[known, 1]
        x, y = placed(a, b, plane, "lat") if self.columns.is_geographic else (a, b)
        names = list(self.table.floors)
        codes = np.frombuffer(self.table.floor, np.int32)[rows[known]]
        floors = tuple(names[code] for code in codes) if "floor" in self.columns.index else ()
        return Waypoints(t[known], x, y), floors
