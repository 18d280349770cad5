"""Aids of an upload: checked, and turned into what the services take. Each finding names field and remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from app.api.plausibility import column_finite, length_error, not_increasing, outside_time, raise_any
from app.api.schemas.aids import AidsIn, BleIn, WifiIn
from app.api.schemas.columns import ColumnsIn
from app.api.validation import FieldError
from app.engine.types import Float64Array, PressureReadings, RadioScans, SpeedReadings, StepCounts
from app.services.aids import Aids, GnssReadings

AID_SLACK_S = 10.0
"""How far outside the samples' time a reading may lie."""
MAX_RADIO_ROWS = 50_000
MAX_ROWS = 10_000

Columns = dict[str, Any]
Aid = TypeVar("Aid")


@dataclass(frozen=True, slots=True)
class ColumnRule:
    """What a column may hold, both ends included."""

    low: float
    high: float
    unit: str
    remedy: str


_DBM = ColumnRule(-150.0, 20.0, "dBm", "send dBm from -150 to 20")


@dataclass(frozen=True, slots=True)
class AidRule:
    """What an aid may hold.

    ``ordered``: its times increase. ``bound``: they lie within the samples' time, give or take; what a platform knows
    of Wi-Fi may be older than that.
    """

    columns: Mapping[str, ColumnRule]
    max_rows: int = MAX_ROWS
    ordered: bool = True
    bound: bool = True


RULES: Mapping[str, AidRule] = {
    "wifi": AidRule({"rssi": _DBM}, MAX_RADIO_ROWS, ordered=False, bound=False),
    "ble": AidRule({"rssi": _DBM}, MAX_RADIO_ROWS, ordered=False),
    "gnss": AidRule(
        {
            "latitude_deg": ColumnRule(-90.0, 90.0, "degrees", "send degrees north, from -90 to 90"),
            "longitude_deg": ColumnRule(-180.0, 180.0, "degrees", "send degrees east, from -180 to 180"),
            "accuracy_m": ColumnRule(
                0.01, 1e5, "m", "send the 68 % radius in metres, from 0.01 to 100000; leave fixes without one out"
            ),
        }
    ),
    "pressure": AidRule({"hpa": ColumnRule(300.0, 1200.0, "hPa", "send hPa from 300 to 1200, as the sensor reads")}),
    "speed": AidRule({"speed_m_s": ColumnRule(-200.0, 200.0, "m/s", "send m/s from -200 to 200")}),
    "steps": AidRule({"count": ColumnRule(0.0, 1e9, "steps", "send counts from 0 to 1000000000")}),
}


def checked_aids(upload: AidsIn, t_ms: Float64Array) -> Aids:
    """Check and convert all that came with samples of these times; an aid without rows is none.

    RejectedError with the findings of the first aid that has any.
    """
    return Aids(
        wifi=checked_wifi(upload.wifi, t_ms),
        ble=checked_ble(upload.ble, t_ms),
        gnss=_checked("gnss", upload.gnss, t_ms, GnssReadings),
        pressure=_checked("pressure", upload.pressure, t_ms, PressureReadings),
        speed=_checked("speed", upload.speed, t_ms, SpeedReadings),
        steps=_checked("steps", upload.steps, t_ms, StepCounts),
    )


def checked_wifi(upload: WifiIn | None, t_ms: Float64Array) -> RadioScans | None:
    """Check and convert Wi-Fi readings."""
    return _checked("wifi", upload, t_ms, RadioScans)


def checked_ble(upload: BleIn | None, t_ms: Float64Array) -> RadioScans | None:
    """Check and convert BLE readings."""
    return _checked("ble", upload, t_ms, RadioScans)


def _checked(name: str, upload: ColumnsIn | None, t_ms: Float64Array, make: Callable[..., Aid]) -> Aid | None:
    """An aid whose columns passed every stage; None without rows.

    ``make`` takes the columns in the order of the upload's fields, times (in seconds) first.
    """
    if upload is None:
        return None
    columns: Columns = {field: getattr(upload, field) for field in type(upload).model_fields}
    if not any(map(len, columns.values())):
        return None
    rule = RULES[name]
    raise_any(_size(name, columns, rule.max_rows))
    raise_any(_lengths(name, columns))
    raise_any(_times(name, columns["t_ms"], rule, t_ms))
    raise_any(_values(name, columns, rule))
    times_ms, *others = columns.values()
    return make(times_ms / 1000.0, *others)


def _size(name: str, columns: Columns, most: int) -> Iterator[FieldError]:
    rows = max(map(len, columns.values()))
    if rows > most:
        yield FieldError(f"{name}.t_ms", f"has {rows} rows", f"send at most {most}")


def _lengths(name: str, columns: Columns) -> Iterator[FieldError]:
    rows = len(columns["t_ms"])
    for field, column in columns.items():
        if len(column) != rows:
            yield length_error(f"{name}.{field}", len(column), f"{name}.t_ms", rows)


def _times(name: str, times: Float64Array, rule: AidRule, t_ms: Float64Array) -> Iterator[FieldError]:
    field = f"{name}.t_ms"
    findings = list(column_finite(field, times))
    if not findings and rule.ordered:
        findings = list(not_increasing(field, times))
    if not findings and rule.bound:
        remedy = "send what was read while these samples were taken, on the same clock"
        findings = list(outside_time(field, "reading", times, t_ms, AID_SLACK_S, remedy))
    yield from findings


def _values(name: str, columns: Columns, rule: AidRule) -> Iterator[FieldError]:
    unit = list(_pressure_unit(columns["hpa"])) if name == "pressure" else []
    if unit:
        yield from unit
        return
    for field, column_rule in rule.columns.items():
        yield from _range(f"{name}.{field}", columns[field], column_rule)
    if name == "steps":
        yield from _counts(columns["count"])


def _range(field: str, column: Float64Array, rule: ColumnRule) -> Iterator[FieldError]:
    inside = (column >= rule.low) & (column <= rule.high)  # NaN is not
    if not inside.all():
        i = int(inside.argmin())
        yield FieldError(field, f"value {i} is {column[i]:g} {rule.unit}", rule.remedy)


def _pressure_unit(hpa: Float64Array) -> Iterator[FieldError]:
    median = float(np.median(hpa))
    for low, high, unit, remedy in ((3e4, 1.2e5, "Pa", "divide by 100"), (30.0, 120.0, "kPa", "multiply by 10")):
        if low <= median <= high:
            yield FieldError("pressure.hpa", f"median {median:g}: looks like {unit} sent as hPa", remedy)


def _counts(count: Float64Array) -> Iterator[FieldError]:
    whole = np.mod(count, 1.0) == 0.0
    if np.isfinite(count).all() and not whole.all():
        i = int(whole.argmin())
        yield FieldError("steps.count", f"value {i} is {count[i]:g}, no whole number", "send the counter as it reads")
    falls = np.diff(count) < 0
    if falls.any():
        i = int(falls.argmax())
        yield FieldError(
            "steps.count",
            f"falls from {count[i]:g} to {count[i + 1]:g} at value {i + 1}",
            "send a counter that never falls; where it was reset, begin another segment",
        )
