"""Reader of the indoor walks in the ``ilc20`` folder format.

A level is a folder with ``traces.parquet``, ``imu.parquet``, ``waypoints.parquet`` and ``floor.json``; optional
are ``wifi.parquet``, ``beacon.parquet``, ``floor_image.png`` and ``geojson_map.json``. Every file is read at most once;
walks are views into the level's columns.

>>> from pathlib import Path
>>> data = open_ilc20(Path("maps/samples"))
>>> data.levels()
('site1-F2',)
>>> walk = data.level("site1-F2").walks("test")[0]
>>> walk.samples.mag.shape == (len(walk.samples), 3)
True
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from app.engine.types import BoolArray, Float64Array, IntArray, RadioScans
from app.evaluation.datasets.columns import (
    NO_LABELS,
    ImuColumns,
    column,
    dictionary_codes,
    read_json,
    read_labels,
    read_table,
    rows_by_walk,
    seconds,
)
from app.evaluation.datasets.plans import GeoJson, plan_to_level_metres
from app.evaluation.datasets.walks import RadioLog, RecordedWalk, path_length
from app.evaluation.errors import DataSetError

__all__ = ["Ilc20", "Ilc20Level", "RadioLog", "RecordedWalk", "Split", "open_ilc20"]

Split = Literal["train", "test"]

WIFI_MAX_AGE_MS = 3000
"""Older entries of a scan are left out: at walking pace they were heard several metres back."""
_REPEATED_MS = 50.0
_BIAS = ("mag_bias_x", "mag_bias_y", "mag_bias_z")


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
        floor = read_json(self.folder / "floor.json")
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
            return plan_to_level_metres(read_json(path), self.extent[2], self.extent[3])
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
class _RadioRows:
    """Radio readings of a walk, times in milliseconds since its start."""

    reported_ms: Float64Array
    age_ms: Float64Array
    address: tuple[str, ...]
    rssi: Float64Array

    def log(self, start_ms: int) -> RadioLog:
        heard = seconds(start_ms, self.reported_ms - self.age_ms)
        return RadioLog(RadioScans(heard, self.address, self.rssi), seconds(start_ms, self.reported_ms))


def _read_walks(folder: Path) -> tuple[RecordedWalk, ...]:
    traces = read_table(
        folder / "traces.parquet",
        ("trace_id", "row_start", "n_samples", "split", "start_unix_ms"),
        ("device_brand", "device_model", *_BIAS),
    ).to_pylist()
    imu = ImuColumns.read(folder / "imu.parquet")
    labels = read_labels(folder / "waypoints.parquet")
    wifi = _read_wifi(folder / "wifi.parquet")
    ble = _read_beacons(folder / "beacon.parquet")

    walks: list[RecordedWalk] = []
    for trace in traces:
        walk_id, start_ms = str(trace["trace_id"]), int(trace["start_unix_ms"])
        samples = imu.samples(trace)
        points = labels.get(walk_id, NO_LABELS).waypoints(start_ms)
        if len(points) < 2 or samples is None:
            continue  # without two labels there is neither truth nor survey
        walks.append(
            RecordedWalk(
                walk_id=walk_id,
                split=str(trace["split"]),
                samples=samples,
                waypoints=points,
                wifi_log=wifi[walk_id].log(start_ms) if walk_id in wifi else None,
                ble_log=ble[walk_id].log(start_ms) if walk_id in ble else None,
                device=" ".join(str(trace.get(name) or "") for name in ("device_brand", "device_model")).strip(),
                path_length_m=path_length(points),
                calibration_epoch=_epoch(trace),
            )
        )
    return tuple(walks)


def _epoch(trace: Mapping[str, Any]) -> str:
    """The platform's hard-iron bias: no two phones share it, and it changes when the platform calibrates anew."""
    bias = [trace.get(name) for name in _BIAS]
    known = all(isinstance(value, float) and np.isfinite(value) for value in bias)
    return " ".join(f"{value:.1f}" for value in bias) if known else ""


def _read_wifi(path: Path) -> dict[str, _RadioRows]:
    """Scan entries, dated when they were reported; an entry that a later report repeats counts once.

    ``age_ms`` tells fresh entries from old ones and from repetitions, but it is not when the signal had the strength
    given: with entries dated back by their age, scans of left-out survey walks are placed 1.8 m ahead of where the
    walker was, with the time of the report 0.8 m (beacons, dated as they are heard: 1.3 m), and fit the map better.
    """
    if not path.is_file():
        return {}
    table = read_table(path, ("trace_id", "t", "bssid", "rssi", "age_ms"))
    reported, age, rssi = (column(table, name) for name in ("t", "age_ms", "rssi"))
    codes, names = dictionary_codes(table, "bssid")
    walks, _ = dictionary_codes(table, "trace_id")
    fresh = (age >= 0) & (age <= WIFI_MAX_AGE_MS) & ~_repeated(walks, codes, reported, age)
    return {
        walk_id: _RadioRows(reported[rows], np.zeros(len(rows)), tuple(names[code] for code in codes[rows]), rssi[rows])
        for walk_id, rows in rows_by_walk(table, fresh, reported).items()
    }


def _repeated(walks: IntArray, codes: IntArray, reported: Float64Array, age: Float64Array) -> BoolArray:
    """Entries that an earlier report had already: same walk, same access point, last seen at the same time."""
    order = np.lexsort((reported, codes, walks))
    seen = (reported - age)[order]
    same = (np.diff(walks[order]) == 0) & (np.diff(codes[order]) == 0) & (np.abs(np.diff(seen)) < _REPEATED_MS)
    repeated = np.zeros(len(order), dtype=bool)
    repeated[order[1:]] = same
    return repeated


def _read_beacons(path: Path) -> dict[str, _RadioRows]:
    """Advertisements, reported as they are heard; a beacon is known by its MAC address.

    Not by what it announces (``key``): on site1-F2 220 beacons announce their maker's default, and 4 keys but 154
    addresses were met by five walks or more. The addresses do not change: most are met again by other walks.
    """
    if not path.is_file():
        return {}
    table = read_table(path, ("trace_id", "t", "mac", "rssi"))
    heard, rssi = column(table, "t"), column(table, "rssi")
    codes, names = dictionary_codes(table, "mac")
    usable = np.isfinite(heard) & (rssi < 0)
    return {
        walk_id: _RadioRows(heard[rows], np.zeros(len(rows)), tuple(names[code] for code in codes[rows]), rssi[rows])
        for walk_id, rows in rows_by_walk(table, usable, heard).items()
    }
