"""Reader of the laboratory walks: ``uji/`` (UJIIndoorLoc-Mag, 10 Hz).

The folder holds ``samples.parquet`` and ``traces.parquet``. The source recorded no gyroscope and no gravity, but the
phone's own attitude and the linear acceleration; both sensors are made of these:

* the accelerometer is linear acceleration plus gravity along the attitude's vertical, so that whoever levels the field
  finds the attitude's pitch and roll again;
* the gyroscope turns from one attitude to the next, less what the phone's own filter drew its azimuth to the compass
  by (:data:`COMPASS_PULL`): beside steel the recorded azimuth follows the bent field, by tens of degrees in a few
  seconds.

Attitude and field change at 5 Hz, every second row repeats; the turn between two attitudes is spread over the rows
between them (up to a tenth of a second ahead of what the phone knew). The first rows of a walk hold stale values and
are left out. Truth runs linearly in time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from app.engine.types import BoolArray, Float64Array, ImuSamples, Waypoints
from app.evaluation.datasets.columns import column, read_table, rising, rows_by_walk, seconds, vector
from app.evaluation.datasets.walks import RecordedWalk, path_length
from app.evaluation.errors import DataSetError

LEVEL = "laboratory"
TRAIN = ("train-lines", "train-curves")
TEST = "test"
GRAVITY = 9.80665
COMPASS_PULL = 0.0048
"""rad/s per uT: rate at which the phone's filter drew its attitude to north, over the field's eastern part in that
attitude. Fitted on the train walks: with it the heading of straight legs strays by 7.6 degrees rms within a walk,
without by 9.0; 0.003 and 0.007 are a quarter of a degree worse than this."""
MIN_CHANGES = 3
"""A walk whose attitude or field changes less often was recorded with a dead sensor."""


@dataclass(frozen=True)
class Uji:
    """The data set; its files are read on first use and kept."""

    folder: Path = field(repr=False)

    def walks(self, *splits: str) -> tuple[RecordedWalk, ...]:
        """Walks of these splits in the order of the file."""
        return tuple(walk for walk in self._walks if walk.split in splits)

    @cached_property
    def _walks(self) -> tuple[RecordedWalk, ...]:
        return tuple(_read_walks(self.folder))


def open_uji(data_dir: Path) -> Uji:
    """Open the data set below ``data_dir`` (the folder that holds ``uji/``, or that folder itself).

    Raises
    ------
    DataSetError
        It is not there.
    """
    for folder in (data_dir / "uji", data_dir):
        if (folder / "samples.parquet").is_file():
            return Uji(folder)
    raise DataSetError(data_dir, "holds no uji/samples.parquet")


@dataclass(frozen=True, slots=True)
class _Columns:
    """Rows of one walk: times in milliseconds since its start, degrees, metres."""

    t_ms: Float64Array
    mag: Float64Array
    linear: Float64Array
    angles: Float64Array
    xy: Float64Array
    segment: Float64Array

    def take(self, rows: NDArray[np.intp]) -> _Columns:
        return _Columns(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def __len__(self) -> int:
        return int(self.t_ms.shape[0])


def _read_walks(folder: Path) -> Iterator[RecordedWalk]:
    traces = read_table(folder / "traces.parquet", ("trace_id", "split", "start_unix_ms")).to_pylist()
    table = read_table(
        folder / "samples.parquet",
        ("trace_id", "t", "mx", "my", "mz", "lax", "lay", "laz", "azimuth", "pitch", "roll", "x", "y", "segment"),
    )
    everything = _Columns(
        t_ms=column(table, "t"),
        mag=vector(table, "m"),
        linear=vector(table, "la"),
        angles=np.stack([column(table, name) for name in ("azimuth", "pitch", "roll")], axis=1),
        xy=np.stack([column(table, "x"), column(table, "y")], axis=1),
        segment=column(table, "segment"),
    )
    measured = np.hstack([everything.mag, everything.linear, everything.angles, everything.xy])
    usable: BoolArray = np.all(np.isfinite(measured), axis=1)
    rows = rows_by_walk(table, usable, everything.t_ms)
    for trace in traces:
        walk_id = str(trace["trace_id"])
        if walk_id not in rows:
            continue
        own = everything.take(rows[walk_id])
        own = own.take(np.flatnonzero(rising(own.t_ms)))
        samples = reconstruct(own.t_ms, own.mag, own.linear, own.angles, int(trace["start_unix_ms"]))
        waypoints = _waypoints(own, int(trace["start_unix_ms"]))
        if samples is not None and len(waypoints) >= 2:
            yield RecordedWalk(
                walk_id=walk_id,
                split=str(trace["split"]),
                samples=samples,
                waypoints=waypoints,
                wifi_log=None,
                device="",
                path_length_m=path_length(waypoints),
                even_pace=True,
            )


def _waypoints(own: _Columns, start_ms: int) -> Waypoints:
    """The first row of each segment and the last row of the walk."""
    rows = np.flatnonzero(np.diff(own.segment, prepend=np.nan) != 0)
    rows = np.unique(np.append(rows, len(own) - 1))
    return Waypoints(seconds(start_ms, own.t_ms[rows]), own.xy[rows, 0], own.xy[rows, 1])


def reconstruct(
    t_ms: Float64Array,
    mag: Float64Array,
    linear: Float64Array,
    angles: Float64Array,
    start_ms: int,
    *,
    compass_pull: float = COMPASS_PULL,
) -> ImuSamples | None:
    """Samples as a phone with accelerometer and gyroscope would have sent them.

    Parameters
    ----------
    t_ms : array, shape (n,), ms
        Since ``start_ms``, rising.
    mag : array, shape (n, 3), uT, body frame
    linear : array, shape (n, 3), m/s^2, body frame
        Acceleration without gravity.
    angles : array, shape (n, 3), degrees
        Azimuth, pitch and roll as Android's ``getOrientation`` has them.
    compass_pull : float, rad/s per uT
        See :data:`COMPASS_PULL`; 0 where the attitude came of a gyroscope alone.

    Returns
    -------
    ImuSamples from the first fresh row on; None if attitude or field hardly ever change (a dead sensor).
    """
    attitude_rows, field_rows = _changes(angles), _changes(mag)
    if min(len(attitude_rows), len(field_rows)) < MIN_CHANGES:
        return None
    # before their first change both may be left over from another walk, or zero
    first = int(max(attitude_rows[0], field_rows[0]))
    known = np.unique(np.append(attitude_rows[attitude_rows >= first], first))
    t = seconds(start_ms, t_ms)
    c_nb = Slerp(t[known], attitude(angles[known]))(np.clip(t[first:], t[known[0]], t[known[-1]]))
    up = c_nb.inv().apply([0.0, 0.0, 1.0])
    turns = (c_nb[:-1].inv() * c_nb[1:]).as_rotvec() / np.diff(t[first:])[:, None]
    # a field that lies east of the attitude's north draws the heading counter-clockwise: not a turn of the phone
    drawn = compass_pull * c_nb.apply(mag[first:])[1:, :1] * up[1:]
    gyro = np.vstack([np.zeros((1, 3)), turns - drawn])
    return ImuSamples(t[first:], mag[first:], linear[first:] + GRAVITY * up, gyro)


def attitude(angles: Float64Array) -> Rotation:
    """Rotations of the body into east, north, up from azimuth, pitch and roll, shape (n, 3), degrees.

    Android's ``SensorManager.getOrientation``: azimuth clockwise from north, pitch positive when the top edge sinks,
    roll positive when the left edge rises.
    """
    return Rotation.from_euler("ZXY", angles * np.array([-1.0, -1.0, 1.0]), degrees=True)


def _changes(values: Float64Array) -> NDArray[np.intp]:
    """Rows that differ from the row before."""
    return np.flatnonzero(np.any(np.diff(values, axis=0) != 0.0, axis=1)) + 1
