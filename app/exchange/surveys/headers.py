"""Headers of CSV files: which column is what, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from app.engine.errors import InputError
from app.exchange.surveys.units import CLOCKS, QUANTITIES, unit_of

AXES = ("x", "y", "z")
_PREFIXES: Mapping[str, Sequence[str]] = {
    "mag": ("m", "mag", "magn", "magnetometer", "magnetic", "magnetic_field", "mag_field", "b", "calibrated_mag"),
    "acc": ("a", "acc", "acce", "accel", "accelerometer", "acceleration", "specific_force"),
    "gyro": ("g", "gyr", "gyro", "gyroscope", "w", "omega", "rotation_rate", "angular_rate", "angular_velocity"),
}  # fmt: skip
_PLAIN: Mapping[str, Sequence[str]] = {
    "t": ("t", "time", "timestamp", "unix_time", "unix_timestamp", "epoch", "elapsed", "seconds_elapsed", "datetime",
          "date_time", "utc", "sensor_timestamp", "time_utc"),
    "x": ("x", "pos_x", "position_x", "x_pos", "px", "plan_x", "easting", "x_position"),
    "y": ("y", "pos_y", "position_y", "y_pos", "py", "plan_y", "northing", "y_position"),
    "lat": ("lat", "latitude", "gps_lat", "gnss_lat", "gps_latitude", "location_latitude"),
    "lon": ("lon", "lng", "long", "longitude", "gps_lon", "gnss_lon", "gps_longitude", "location_longitude"),
    "floor": ("floor", "level", "storey", "floor_number"),
    "walk": ("walk", "walk_id", "trace", "trace_id", "run", "session", "session_id"),
}  # fmt: skip
SENSORS = tuple(f"{sensor}_{axis}" for sensor in QUANTITIES for axis in AXES)
ROLES = (*_PLAIN, *SENSORS)
"""What a column can be."""


def _aliases() -> dict[str, str]:
    table = {alias: role for role, aliases in _PLAIN.items() for alias in aliases}
    for sensor, prefixes in _PREFIXES.items():
        for prefix in prefixes:
            for axis in AXES:
                for name in (f"{prefix}{axis}", f"{prefix}_{axis}"):
                    table.setdefault(name, f"{sensor}_{axis}")
    return table


_ROLE_OF = _aliases()
_BRACKET = re.compile(r"[\(\[\{]([^\)\]\}]*)[\)\]\}]")
_OTHER = re.compile(r"[^a-z0-9]+")
_SUFFIXES = (
    "m_s2",
    "rad_s",
    "deg_s",
    "deg",
    "dps",
    "ms2",
    "ut",
    "nt",
    "mt",
    "gauss",
    "mg",
    "ms",
    "us",
    "ns",
    "m",
    "s",
    "g",
    "t",
)


@dataclass(frozen=True, slots=True)
class Columns:
    """Where each role is in a row, and the units that the header names (``mag``, ``acc``, ``gyro``, ``t``)."""

    index: Mapping[str, int]
    units: Mapping[str, str]

    @property
    def is_geographic(self) -> bool:
        """Whether positions are latitude and longitude."""
        return "lat" in self.index


def columns_of(header: Sequence[str], named: Mapping[str, str], *, positions: bool = True) -> Columns:
    """Find the columns of a header.

    Parameters
    ----------
    header : sequence of str
    named : mapping
        Role to header, for columns that have names of their own.
    positions : bool
        Whether positions are needed, too.

    Raises
    ------
    InputError
        A named column is not there, or one that is needed is not found.
    """
    index: dict[str, int] = {}
    units: dict[str, str] = {}
    plain = [name.strip().strip('"').lower() for name in header]
    for role, name in named.items():
        if role not in ROLES:
            raise InputError("column", f"{role!r} is no column that is read; name one of {', '.join(ROLES)}")
        if name.strip().lower() not in plain:
            raise InputError("column", f"{name!r} is not in the header; it has {_listed(header)}")
        index[role] = plain.index(name.strip().lower())
    for i, text in enumerate(plain):
        meant, unit = _read(text)
        if meant is None or meant in named or i in index.values():
            continue
        # the first of several wins: exports put the calibrated sensor first
        index.setdefault(meant, i)
        if unit is not None and index[meant] == i:
            units.setdefault(meant.partition("_")[0] if meant in SENSORS else meant, unit)
    _check(index, header, positions=positions)
    return Columns(index, units)


def _read(text: str) -> tuple[str | None, str | None]:
    """Role and unit of one header."""
    bracket = _BRACKET.search(text)
    role: str | None
    base = _OTHER.sub("_", _BRACKET.sub("", text)).strip("_")
    if base in _ROLE_OF:
        role = _ROLE_OF[base]
        return role, _unit(role, bracket.group(1)) if bracket else None
    for suffix in _SUFFIXES:
        short = base.removesuffix(f"_{suffix}")
        if short != base and short in _ROLE_OF:
            role = _ROLE_OF[short]
            return role, _unit(role, bracket.group(1) if bracket else suffix)
    return None, None


def _unit(role: str, text: str) -> str | None:
    if role in SENSORS:
        return unit_of(role.partition("_")[0], text)
    return text.strip() if role == "t" and text.strip() in CLOCKS else None


def _check(index: Mapping[str, int], header: Sequence[str], *, positions: bool) -> None:
    missing = [role for role in ("t", *SENSORS) if role not in index]
    if positions and not ({"x", "y"} <= index.keys() or {"lat", "lon"} <= index.keys()):
        missing.append("x and y (or lat and lon)")
    if missing:
        raise InputError(
            "header",
            f"lacks {', '.join(missing)}: it has {_listed(header)}. Steps, turns and the "
            "field tell where it was, so all three sensors are needed; name other columns with --column mag_x=HEADER",
        )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(name.strip()[:30] or "(empty)" for name in names[:12])
    return shown if len(names) <= 12 else f"{shown} and {len(names) - 12} more"
