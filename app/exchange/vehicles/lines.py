"""Lines of a logger, one after the other: a header, then a row a sample.

Columns, separators and units are those of survey files (:mod:`app.exchange.surveys.csv_file`), without positions and
with a speed of wheels. What a header does not say (units, clock) is judged by the first rows, once, and told.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from app.engine.errors import InputError
from app.engine.types import Float64Array
from app.exchange.surveys.csv_file import cells_of, delimiter_of, number_in
from app.exchange.surveys.headers import SENSORS, Columns, columns_of
from app.exchange.surveys.recording import Findings
from app.exchange.surveys.units import CLOCKS, QUANTITIES, clock_of, factor_of, to_seconds, unit_of

N_JUDGED = 50
"""Rows that are looked at before units and clock are judged: half a second at 100 Hz."""
RESTART_S = 5.0
"""A clock without a date that runs back by more was started anew."""
_SPEED = re.compile(r"^(wheel[_ ]?)?(speed|velocity|v)(?![a-z])[ _]*[\[({]?\s*(.*?)\s*[\])}]?$", re.IGNORECASE)
_SPEED_UNITS: Mapping[str, float] = {
    "": 1.0, "m/s": 1.0, "m_s": 1.0, "mps": 1.0, "ms": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "km_h": 1 / 3.6,
    "kph": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600, "kt": 1852 / 3600,
}  # fmt: skip
_UNITS = ("mag", "acc", "gyro", "t", "speed")


@dataclass(frozen=True, slots=True)
class LineChoices:
    """What the sender says of the lines.

    Attributes
    ----------
    header : tuple of str
        Names of the columns, where the lines have no header of their own; empty: the first line is one.
    columns : mapping
        Role (``t``, ``mag_x``, ..., ``speed``) to header, where a header is none of the known names.
    units : mapping
        ``mag``, ``acc``, ``gyro``, ``t`` or ``speed`` to a unit; wins over the header's.
    start_s : float or None
        Unix seconds at which a clock without a date began.
    live : bool
        The lines come as they are measured: a clock without a date begins now.
    """

    header: tuple[str, ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    start_s: float | None = None
    live: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One sample: ``t`` Unix s; ``sensors`` uT, m/s^2, rad/s (nine values; NaN: not read); ``speed`` m/s or None."""

    t: float
    sensors: tuple[float, ...]
    speed: float | None

    @property
    def full(self) -> bool:
        """Whether every sensor was read."""
        return all(map(math.isfinite, self.sensors))


@dataclass
class LineReader:
    """Reads lines; the first rows are held back until units and clock are known.

    Attributes
    ----------
    choices : LineChoices
    findings : Findings
        Is told what was assumed.
    n_bad : int
        Lines that could not be read.
    first_bad : str
        The first of them, in words.
    """

    choices: LineChoices = field(default_factory=LineChoices)
    findings: Findings = field(default_factory=Findings)
    now: Callable[[], float] = time.time
    n_bad: int = 0
    first_bad: str = ""
    _n_lines: int = 0
    _layout: _Layout | None = None
    _scale: _Scale | None = None
    _held: list[_Raw] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name, unit in self.choices.units.items():
            _check_unit(name, unit)
        if self.choices.header:
            self._layout = _Layout.of(self.choices.header, self.choices, delimiter=",", fixed=False)

    def feed(self, line: str) -> Iterator[Row]:
        """Rows that are ready with this line.

        Raises
        ------
        InputError
            The header lacks columns, or the first rows fit no unit: no later line would be better.
        """
        self._n_lines += 1
        text = line.strip("\r\n \0\ufeff")
        if not text or text.startswith("#"):
            return
        if self._layout is None:
            separator = delimiter_of(text)
            self._layout = _Layout.of(
                cells_of(text, separator, self._n_lines), self.choices, delimiter=separator, fixed=True
            )
            return
        try:
            raw = self._layout.read(text, self._n_lines)
        except InputError as error:
            self.n_bad += 1
            self.first_bad = self.first_bad or str(error)
            return
        if raw is None:
            return
        if self._scale is not None:
            yield self._scale.row(raw, self.now)
            return
        self._held.append(raw)
        if sum(one.full for one in self._held) >= N_JUDGED:
            yield from self.judge()

    def judge(self) -> Iterator[Row]:
        """Judge by what there is, and give out what was held back; for the end, or when nothing more comes."""
        held, layout = [raw for raw in self._held if raw.full], self._layout
        if layout is None or not held:
            return
        self._scale = _Scale.of(held, layout, self.choices, self.findings, self.now)
        rows, self._held = self._held, []
        yield from (self._scale.row(raw, self.now) for raw in rows)


@dataclass(frozen=True, slots=True)
class _Raw:
    """A row in the units of the lines."""

    t: float
    dated: bool
    sensors: tuple[float, ...]
    speed: float

    @property
    def full(self) -> bool:
        return all(map(math.isfinite, self.sensors))


@dataclass(slots=True)
class _Layout:
    """Where the columns are; ``fixed`` if the separator is known, else it is that of the first row."""

    columns: Columns
    speed: int | None
    speed_factor: float
    delimiter: str | None
    fixed: bool

    @classmethod
    def of(cls, header: Sequence[str], choices: LineChoices, *, delimiter: str | None, fixed: bool) -> _Layout:
        named = {role: name for role, name in choices.columns.items() if role != "speed"}
        speed, unit = _speed_of(header, choices.columns.get("speed"))
        rest = ["" if i == speed else name for i, name in enumerate(header)]
        columns = columns_of(rest, named, positions=False)
        return cls(columns, speed, _SPEED_UNITS[choices.units.get("speed", unit).lower()], delimiter, fixed)

    def read(self, line: str, number: int) -> _Raw | None:
        """A row; None for a header that is repeated, as loggers do when they start anew."""
        index = self.columns.index
        needed = max(index[role] for role in ("t", *SENSORS))
        if not self.fixed:
            # the comma last: it may stand within numbers; a first line that is cut off tells nothing
            self.delimiter = next((one for one in (";", "\t", "|", ",") if line.count(one) >= needed), None)
            self.fixed = self.delimiter is not None or len(line.split()) > needed
        cells = cells_of(line, self.delimiter, number)
        comma = self.delimiter != ","
        if len(cells) <= needed:
            raise InputError(f"line {number}", f"has {len(cells)} columns, {needed + 1} are needed; complete the line")
        text = cells[index["t"]].strip().strip('"')
        if text.lower().startswith("t"):
            return None
        t, dated = _time(text, number, comma=comma)
        sensors = tuple(number_in(cells[index[role]], number, comma=comma) for role in SENSORS)
        has_speed = self.speed is not None and self.speed < len(cells)
        speed = number_in(cells[self.speed or 0], number, comma=comma) if has_speed else math.nan
        return _Raw(t, dated, sensors, speed * self.speed_factor)


@dataclass(slots=True)
class _Scale:
    """What takes raw rows to the engine's units and to Unix time."""

    factors: Float64Array
    clock: float
    offset: float
    dated: bool
    live: bool
    newest: float = -math.inf

    @classmethod
    def of(
        cls, held: Sequence[_Raw], layout: _Layout, choices: LineChoices, findings: Findings, now: Callable[[], float]
    ) -> _Scale:
        units = {**layout.columns.units, **choices.units}
        values = np.array([raw.sensors for raw in held])
        factors = []
        for i, sensor in enumerate(QUANTITIES):
            unit = units.get(sensor)
            known = None if unit is None else unit_of(sensor, unit)
            factors += [factor_of(sensor, values[:, 3 * i : 3 * i + 3], known, findings)] * 3
        clock, offset, dated = _clock_of(held, units.get("t"), choices, findings, now)
        return cls(np.array(factors), clock, offset, dated, choices.live)

    def row(self, raw: _Raw, now: Callable[[], float]) -> Row:
        seconds = raw.t if raw.dated else raw.t * self.clock
        if self.live and not self.dated and seconds < self.newest - RESTART_S:
            self.offset = now() - seconds
            self.newest = -math.inf
        self.newest = max(self.newest, seconds)
        sensors = tuple((np.array(raw.sensors) * self.factors).tolist())
        return Row(seconds + self.offset, sensors, raw.speed if math.isfinite(raw.speed) else None)


def _clock_of(
    held: Sequence[_Raw], unit: str | None, choices: LineChoices, findings: Findings, now: Callable[[], float]
) -> tuple[float, float, bool]:
    """Seconds of a tick, what is added to them, and whether the clock knows the date."""
    if held[0].dated:
        return 1.0, 0.0, True
    t = np.array([raw.t for raw in held])
    if unit is None:
        unit = clock_of(t)
        findings.assume(f"time in {unit} by its steps")
    clock = CLOCKS[unit]
    begins_now = choices.live and choices.start_s is None
    seconds = to_seconds(t, unit, 0.0 if begins_now else choices.start_s, findings)
    offset = float(seconds[0]) - float(t[0]) * clock
    if offset == 0.0:  # Unix time is taken as it is
        return clock, 0.0, True
    if begins_now:
        findings.assume("a clock without a date, as begun now")
        offset = now() - float(t[-1]) * clock
    return clock, offset, False


def _time(text: str, number: int, *, comma: bool) -> tuple[float, bool]:
    """A time in the clock's own unit, or Unix seconds of a date (then True)."""
    try:
        value = float(text.replace(",", ".") if comma else text)
    except ValueError:
        pass
    else:
        if math.isfinite(value):
            return value, False
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"line {number}", f"has the time {text[:30]!r}; send a number, or ISO 8601") from error
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp(), True


def _speed_of(header: Sequence[str], named: str | None) -> tuple[int | None, str]:
    """Column and unit of the wheel speed."""
    plain = [name.strip().strip('"').lower() for name in header]
    if named is not None:
        if named.strip().lower() not in plain:
            raise InputError("column", f"{named!r} is not in the header; name one that is")
        return plain.index(named.strip().lower()), ""
    for i, name in enumerate(plain):
        match = _SPEED.match(name)
        if match and match[3] in _SPEED_UNITS:
            return i, match[3]
    return None, ""


def _check_unit(name: str, unit: str) -> None:
    if name not in _UNITS:
        raise InputError("unit", f"{name!r} has no unit; name one of {', '.join(_UNITS)}")
    known: Mapping[str, float]
    if name == "t":
        known, found = CLOCKS, unit in CLOCKS
    elif name == "speed":
        known, found = _SPEED_UNITS, unit.lower() in _SPEED_UNITS
    else:
        known, found = QUANTITIES[name].factors, unit_of(name, unit) is not None
    if not found:
        raise InputError("unit", f"{unit!r} is no unit of {name}; name one of {', '.join(filter(None, known))}")
