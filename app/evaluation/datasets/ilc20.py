"""Reader of the indoor walks in the ``ilc20`` folder format.

A level is a folder with ``traces.parquet``, ``imu.parquet``, ``waypoints.parquet`` and ``floor.json``; optional
are ``wifi.parquet``, ``floor_image.png`` and ``geojson_map.json``. Every file is read at most once; walks are
views into the level's columns.

>>> from pathlib import Path
>>> data = open_ilc20(Path("maps/samples"))
>>> data.levels()
('site1-F2',)
>>> walk = data.level("site1-F2").walks("test")[0]
>>> walk.samples.mag.shape == (len(walk.samples), 3)
True
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from app.engine.types import BoolArray, Float64Array, ImuSamples, RadioScans, SurveyWalk, Waypoints
from app.evaluation.datasets.plans import GeoJson, plan_to_level_metres
from app.evaluation.errors import DataSetError

Split = Literal["train", "test"]

WIFI_MAX_AGE_MS = 3000
"""Older entries of a scan are left out: at walking pace they were heard several metres back."""

_SENSOR_COLUMNS = ("mx", "my", "mz", "ax", "ay", "az", "gx", "gy", "gz")


@dataclass(frozen=True, slots=True)
class WifiLog:
    """Wi-Fi readings of a walk with the time at which the phone reported them.

    Attributes
    ----------
    scans : RadioScans
        ``scans.t`` is when the access point was last heard.
    reported_t : array, shape (m,), s
        When the scan was delivered, non-decreasing. A causal replay may use a row only from here on.
    """

    scans: RadioScans
    reported_t: Float64Array

    def between(self, after: float, until: float) -> RadioScans | None:
        """Readings reported in ``(after, until]``, None if there are none."""
        first, last = np.searchsorted(self.reported_t, [after, until], side="right")
        if first == last:
            return None
        rows = slice(int(first), int(last))
        return RadioScans(self.scans.t[rows], self.scans.address[rows], self.scans.rssi[rows])


@dataclass(frozen=True, slots=True)
class RecordedWalk:
    """One recorded walk with labelled waypoints.

    Attributes
    ----------
    walk_id : str
    split : "train" or "test"
    samples : ImuSamples
    waypoints : Waypoints
    wifi_log : WifiLog or None
    device : str
        Brand and model, empty if unknown.
    path_length_m : float
        Sum of the straight legs between the waypoints.
    """

    walk_id: str
    split: str
    samples: ImuSamples
    waypoints: Waypoints
    wifi_log: WifiLog | None
    device: str
    path_length_m: float

    @property
    def wifi(self) -> RadioScans | None:
        """All Wi-Fi readings of the walk."""
        return self.wifi_log.scans if self.wifi_log else None

    def survey_walk(self) -> SurveyWalk:
        """The walk as input of map building."""
        return SurveyWalk(self.walk_id, self.samples, self.waypoints, self.wifi)


@dataclass(frozen=True)
class Ilc20Level:
    """One level of the data set; its files are read on first use and kept."""

    name: str
    folder: Path = field(repr=False)

    @property
    def site(self) -> str:
        """The building: what stands before the last hyphen of the folder's name."""
        return self.name.rpartition("-")[0] or self.name

    @property
    def floor(self) -> str:
        """The storey's name: what stands after the last hyphen."""
        return self.name.rpartition("-")[2]

    @property
    def ordinal(self) -> int:
        """Height order of the storey: B1 is -1, F1 is 0, F2 is 1."""
        found = re.fullmatch(r"(B|F|L)?(-?\d+)", self.floor)
        if not found:
            return 0
        number = int(found.group(2))
        return -number if found.group(1) == "B" else number - 1

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """``(x_min, y_min, x_max, y_max)`` of the plan rectangle, metres."""
        floor = _read_json(self.folder / "floor.json")
        try:
            return (0.0, 0.0, float(floor["width_m"]), float(floor["height_m"]))
        except (KeyError, TypeError, ValueError) as error:
            raise DataSetError(self.folder / "floor.json", "needs numbers width_m and height_m") from error

    @property
    def plan_png_path(self) -> Path | None:
        """The raster plan; its edges are those of ``extent``."""
        path = self.folder / "floor_image.png"
        return path if path.is_file() else None

    @cached_property
    def vector_plan(self) -> GeoJson | None:
        """The vector plan as GeoJSON in level metres."""
        path = self.folder / "geojson_map.json"
        if not path.is_file():
            return None
        try:
            return plan_to_level_metres(_read_json(path), self.extent[2], self.extent[3])
        except (KeyError, TypeError, IndexError, ValueError) as error:
            raise DataSetError(path, f"is no usable GeoJSON plan ({error})") from error

    def walks(self, split: Split | None = None) -> tuple[RecordedWalk, ...]:
        """Walks of one split, or all, in the order of the file."""
        return self._walks if split is None else tuple(walk for walk in self._walks if walk.split == split)

    @cached_property
    def _walks(self) -> tuple[RecordedWalk, ...]:
        return _read_walks(self.folder)


@dataclass(frozen=True)
class Ilc20:
    """The data set: a folder of levels."""

    folder: Path
    _levels: dict[str, Ilc20Level] = field(repr=False)

    def levels(self) -> tuple[str, ...]:
        """Names of the levels found, sorted."""
        return tuple(self._levels)

    def level(self, name: str) -> Ilc20Level:
        """One level by name; raises :class:`DataSetError` if it is not there."""
        if name not in self._levels:
            raise DataSetError(self.folder, f"has no level {name!r}; found: {', '.join(self._levels)}")
        return self._levels[name]


def open_ilc20(data_dir: Path) -> Ilc20:
    """Open the data set below ``data_dir`` (the folder that holds ``ilc20/``, or that folder itself).

    Raises
    ------
    DataSetError
        No level is found.
    """
    for folder in (data_dir / "ilc20", data_dir):
        found = sorted(path.parent for path in folder.glob("*/traces.parquet"))
        if found:
            return Ilc20(folder, {path.name: Ilc20Level(path.name, path) for path in found})
    raise DataSetError(data_dir, "holds no ilc20/<site>-<floor>/traces.parquet")


@dataclass(frozen=True, slots=True)
class _WaypointRows:
    """Labels of a walk, times in milliseconds since its start."""

    t_ms: Float64Array
    x: Float64Array
    y: Float64Array

    def waypoints(self, start_ms: int) -> Waypoints:
        keep = _rising(self.t_ms)
        return Waypoints(_seconds(start_ms, self.t_ms[keep]), self.x[keep], self.y[keep])


@dataclass(frozen=True, slots=True)
class _WifiRows:
    """Wi-Fi readings of a walk, times in milliseconds since its start."""

    reported_ms: Float64Array
    age_ms: Float64Array
    address: tuple[str, ...]
    rssi: Float64Array

    def wifi_log(self, start_ms: int) -> WifiLog:
        heard = _seconds(start_ms, self.reported_ms - self.age_ms)
        return WifiLog(RadioScans(heard, self.address, self.rssi), _seconds(start_ms, self.reported_ms))


_NO_WAYPOINTS = _WaypointRows(np.empty(0), np.empty(0), np.empty(0))


def _read_walks(folder: Path) -> tuple[RecordedWalk, ...]:
    traces = _read_table(
        folder / "traces.parquet",
        ("trace_id", "row_start", "n_samples", "split", "start_unix_ms"),
        ("device_brand", "device_model"),
    ).to_pylist()
    imu = _read_table(folder / "imu.parquet", ("t", *_SENSOR_COLUMNS))
    t_ms = _column(imu, "t")
    mag, acc, gyro = (_vector(imu, axis) for axis in "mag")
    usable: BoolArray = np.all(np.isfinite(np.hstack((mag, acc, gyro))), axis=1)
    waypoints = _read_waypoints(folder / "waypoints.parquet")
    wifi = _read_wifi(folder / "wifi.parquet")

    walks: list[RecordedWalk] = []
    for trace in traces:
        walk_id = str(trace["trace_id"])
        rows = slice(int(trace["row_start"]), int(trace["row_start"]) + int(trace["n_samples"]))
        if rows.stop > len(t_ms):
            raise DataSetError(folder / "traces.parquet", f"trace {walk_id} ends behind the last row of imu.parquet")
        start_ms = int(trace["start_unix_ms"])
        points = waypoints.get(walk_id, _NO_WAYPOINTS).waypoints(start_ms)
        keep = usable[rows] & _rising(t_ms[rows])
        if len(points) < 2 or not keep.any():
            continue  # without two labels there is neither truth nor survey
        whole = bool(keep.all())
        samples = ImuSamples(
            t=_seconds(start_ms, t_ms[rows] if whole else t_ms[rows][keep]),
            mag=mag[rows] if whole else mag[rows][keep],
            acc=acc[rows] if whole else acc[rows][keep],
            gyro=gyro[rows] if whole else gyro[rows][keep],
        )
        walks.append(
            RecordedWalk(
                walk_id=walk_id,
                split=str(trace["split"]),
                samples=samples,
                waypoints=points,
                wifi_log=wifi[walk_id].wifi_log(start_ms) if walk_id in wifi else None,
                device=" ".join(str(trace.get(name) or "") for name in ("device_brand", "device_model")).strip(),
                path_length_m=float(np.hypot(np.diff(points.x), np.diff(points.y)).sum()),
            )
        )
    return tuple(walks)


def _read_waypoints(path: Path) -> dict[str, _WaypointRows]:
    table = _read_table(path, ("trace_id", "t", "x", "y"))
    t_ms, x, y = (_column(table, name) for name in ("t", "x", "y"))
    usable = np.isfinite(x) & np.isfinite(y)
    return {
        walk_id: _WaypointRows(t_ms[rows], x[rows], y[rows])
        for walk_id, rows in _rows_by_walk(table, usable, t_ms).items()
    }


def _read_wifi(path: Path) -> dict[str, _WifiRows]:
    if not path.is_file():
        return {}
    table = _read_table(path, ("trace_id", "t", "bssid", "rssi", "age_ms"))
    reported, age, rssi = (_column(table, name) for name in ("t", "age_ms", "rssi"))
    codes, names = _codes(table, "bssid")
    fresh = (age >= 0) & (age <= WIFI_MAX_AGE_MS)
    return {
        walk_id: _WifiRows(reported[rows], age[rows], tuple(names[code] for code in codes[rows]), rssi[rows])
        for walk_id, rows in _rows_by_walk(table, fresh, reported).items()
    }


def _rows_by_walk(table: pa.Table, usable: BoolArray, t_ms: Float64Array) -> dict[str, NDArray[np.intp]]:
    """Usable rows of each walk, in time order."""
    codes, names = _codes(table, "trace_id")
    rows = np.flatnonzero(usable)
    rows = rows[np.lexsort((t_ms[rows], codes[rows]))]
    present, starts = np.unique(codes[rows], return_index=True)
    return (
        {names[code]: part for code, part in zip(present, np.split(rows, starts[1:]), strict=True)} if len(rows) else {}
    )


def _codes(table: pa.Table, name: str) -> tuple[NDArray[np.int64], list[str]]:
    """A string column as codes and the strings they stand for (no Python string per row)."""
    column = table[name].combine_chunks()
    if isinstance(column, pa.ChunkedArray):  # no rows at all
        return np.empty(0, dtype=np.int64), []
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    codes: NDArray[np.int64] = column.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    return codes, [str(value) for value in column.dictionary.to_pylist()]


def _read_table(path: Path, columns: tuple[str, ...], optional: tuple[str, ...] = ()) -> pa.Table:
    try:
        names = pq.read_schema(path).names
        missing = [name for name in columns if name not in names]
        if missing:
            raise DataSetError(path, f"lacks the columns {', '.join(missing)}")
        return pq.read_table(path, columns=[*columns, *(name for name in optional if name in names)])
    except (OSError, pa.ArrowInvalid) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error
    if not isinstance(content, dict):
        raise DataSetError(path, "is not a JSON object")
    return content


def _column(table: pa.Table, name: str) -> Float64Array:
    values: Float64Array = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
    return values


def _vector(table: pa.Table, sensor: str) -> Float64Array:
    out = np.empty((table.num_rows, 3))
    for i, axis in enumerate("xyz"):
        out[:, i] = table[sensor + axis].to_numpy()
    return out


def _seconds(start_ms: int, t_ms: Float64Array) -> Float64Array:
    """UTC seconds. Whole milliseconds are added first: they are exact in float64."""
    seconds: Float64Array = (start_ms + t_ms) / 1000.0
    return seconds


def _rising(t: Float64Array) -> BoolArray:
    """Rows later than every row before them."""
    if not len(t):
        return np.zeros(0, dtype=np.bool_)
    newest = np.maximum.accumulate(t)
    rising: BoolArray = np.r_[True, t[1:] > newest[:-1]]
    return rising
