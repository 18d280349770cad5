"""Reading of Parquet columns and JSON files; what is not as expected is a :class:`DataSetError` that names the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from app.engine.types import BoolArray, Float64Array, ImuSamples, Waypoints
from app.evaluation.errors import DataSetError

_SENSOR_COLUMNS = ("mx", "my", "mz", "ax", "ay", "az", "gx", "gy", "gz")


@dataclass(frozen=True, slots=True)
class ImuColumns:
    """``imu.parquet`` of all walks: times in milliseconds since each walk's start, field, force and rate."""

    path: Path
    t_ms: Float64Array
    mag: Float64Array
    acc: Float64Array
    gyro: Float64Array
    usable: BoolArray

    @classmethod
    def read(cls, path: Path) -> ImuColumns:
        """Read the file."""
        table = read_table(path, ("t", *_SENSOR_COLUMNS))
        mag, acc, gyro = (vector(table, axis) for axis in "mag")
        usable: BoolArray = np.all(np.isfinite(np.hstack((mag, acc, gyro))), axis=1)
        return cls(path, column(table, "t"), mag, acc, gyro, usable)

    def samples(self, trace: Mapping[str, Any]) -> ImuSamples | None:
        """Samples of a row of ``traces.parquet`` that are finite and rise in time; None if there are none."""
        rows = slice(int(trace["row_start"]), int(trace["row_start"]) + int(trace["n_samples"]))
        if rows.stop > len(self.t_ms):
            traces = self.path.with_name("traces.parquet")
            raise DataSetError(traces, f"trace {trace['trace_id']} ends behind the last row of {self.path.name}")
        keep = self.usable[rows] & rising(self.t_ms[rows])
        if not keep.any():
            return None
        whole = bool(keep.all())
        t = seconds(int(trace["start_unix_ms"]), self.t_ms[rows] if whole else self.t_ms[rows][keep])
        parts = (v[rows] if whole else v[rows][keep] for v in (self.mag, self.acc, self.gyro))
        return ImuSamples(t, *parts)


@dataclass(frozen=True, slots=True)
class LabelRows:
    """Labels of a walk, times in milliseconds since its start."""

    t_ms: Float64Array
    x: Float64Array
    y: Float64Array

    def waypoints(self, start_ms: int) -> Waypoints:
        """Those that rise in time."""
        keep = rising(self.t_ms)
        return Waypoints(seconds(start_ms, self.t_ms[keep]), self.x[keep], self.y[keep])


NO_LABELS = LabelRows(np.empty(0), np.empty(0), np.empty(0))


def read_labels(path: Path) -> dict[str, LabelRows]:
    """``waypoints.parquet``: the labels of each walk in time order."""
    table = read_table(path, ("trace_id", "t", "x", "y"))
    t_ms, x, y = (column(table, name) for name in ("t", "x", "y"))
    usable = np.isfinite(x) & np.isfinite(y)
    return {
        walk_id: LabelRows(t_ms[rows], x[rows], y[rows]) for walk_id, rows in rows_by_walk(table, usable, t_ms).items()
    }


def rows_by_walk(table: pa.Table, usable: BoolArray, t_ms: Float64Array) -> dict[str, NDArray[np.intp]]:
    """Usable rows of each walk, in time order."""
    codes, names = dictionary_codes(table, "trace_id")
    rows = np.flatnonzero(usable)
    rows = rows[np.lexsort((t_ms[rows], codes[rows]))]
    present, starts = np.unique(codes[rows], return_index=True)
    return (
        {names[code]: part for code, part in zip(present, np.split(rows, starts[1:]), strict=True)} if len(rows) else {}
    )


def dictionary_codes(table: pa.Table, name: str) -> tuple[NDArray[np.int64], list[str]]:
    """A string column as codes and the strings they stand for (no Python string per row)."""
    strings = table[name].combine_chunks()
    if isinstance(strings, pa.ChunkedArray):  # no rows at all
        return np.empty(0, dtype=np.int64), []
    if not pa.types.is_dictionary(strings.type):
        strings = strings.dictionary_encode()
    codes: NDArray[np.int64] = strings.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    return codes, [str(value) for value in strings.dictionary.to_pylist()]


def read_table(path: Path, columns: tuple[str, ...], optional: tuple[str, ...] = ()) -> pa.Table:
    """Some columns of a Parquet file; ``optional`` ones if they are there."""
    try:
        names = pq.read_schema(path).names
        missing = [name for name in columns if name not in names]
        if missing:
            raise DataSetError(path, f"lacks the columns {', '.join(missing)}")
        return pq.read_table(path, columns=[*columns, *(name for name in optional if name in names)])
    except (OSError, pa.ArrowInvalid) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error
    if not isinstance(content, dict):
        raise DataSetError(path, "is not a JSON object")
    return content


def column(table: pa.Table, name: str) -> Float64Array:
    """A numeric column."""
    values: Float64Array = table[name].to_numpy(zero_copy_only=False).astype(np.float64)
    return values


def vector(table: pa.Table, sensor: str) -> Float64Array:
    """Columns ``<sensor>x``, ``y`` and ``z``, shape (n, 3)."""
    out = np.empty((table.num_rows, 3))
    for i, axis in enumerate("xyz"):
        out[:, i] = table[sensor + axis].to_numpy()
    return out


def seconds(start_ms: int, t_ms: Float64Array) -> Float64Array:
    """UTC seconds. Whole milliseconds are added first: they are exact in float64."""
    utc: Float64Array = (start_ms + t_ms) / 1000.0
    return utc


def rising(t: Float64Array) -> BoolArray:
    """Rows later than every row before them."""
    if not len(t):
        return np.zeros(0, dtype=np.bool_)
    newest = np.maximum.accumulate(t)
    later: BoolArray = np.r_[True, t[1:] > newest[:-1]]
    return later
