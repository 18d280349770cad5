"""Reader of the hall with repeat tracks: ``kaist/<floor>/``.

A floor is a folder with ``traces.parquet``, ``imu.parquet``, ``waypoints.parquet`` and ``floor.json``; optional are
``floor_image.png`` and ``published_runs.parquet``. Survey lines carry the split ``survey``, test tracks ``test``.
Truth between corners runs in steps, as in ``ilc20``.

During the survey the phone pointed along plan +x on every line, also on those along y.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from app.engine.types import Float64Array
from app.evaluation.datasets.columns import NO_LABELS, ImuColumns, column, read_json, read_labels, read_table
from app.evaluation.datasets.plans import GeoJson
from app.evaluation.datasets.walks import RecordedWalk, path_length
from app.evaluation.errors import DataSetError

DEFAULT_FLOOR = "KI-1F"
SURVEY, TEST = "survey", "test"
SURVEY_DEVICE_HEADING = 0.0
"""rad: the phone pointed along +x."""


@dataclass(frozen=True, slots=True)
class PublishedRuns:
    """Runs of one method with one setting that the source published.

    Attributes
    ----------
    method : str
    particles : int
    map_step_m : float
    track : array, shape (n,)
        Number of the track of each run.
    error_m : array, shape (n,), m
        Mean error over the scored corners but the first two.
    """

    method: str
    particles: int
    map_step_m: float
    track: NDArray[np.int64]
    error_m: Float64Array


@dataclass(frozen=True)
class KaistFloor:
    """One floor of the data set; its files are read on first use and kept."""

    name: str
    folder: Path = field(repr=False)

    def walks(self, kind: str) -> tuple[RecordedWalk, ...]:
        """Walks of a kind (``survey`` or ``test``) in the order of the file."""
        return tuple(walk for walk in self._walks if walk.split == kind)

    @cached_property
    def plan(self) -> GeoJson:
        """The walkable ground as a GeoJSON outline with holes, level metres."""
        path = self.folder / "floor.json"
        try:
            walkable = read_json(path)["walkable"]
            rings = [[[float(x), float(y)] for x, y in ring] for ring in (walkable["outer"], *walkable["holes"])]
        except (KeyError, TypeError, ValueError) as error:
            raise DataSetError(path, f"needs walkable.outer and walkable.holes as rings of x, y ({error})") from error
        feature = {
            "type": "Feature",
            "properties": {"role": "floor"},
            "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]] for ring in rings]},
        }
        return {"type": "FeatureCollection", "features": [feature]}

    @property
    def plan_png_path(self) -> Path | None:
        """The raster plan."""
        path = self.folder / "floor_image.png"
        return path if path.is_file() else None

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """``(x_min, y_min, x_max, y_max)`` of the raster plan, else of the walkable ground, metres."""
        if self.plan_png_path is None:
            x, y = zip(*self.plan["features"][0]["geometry"]["coordinates"][0], strict=True)
            return (min(x), min(y), max(x), max(y))
        path = self.folder / "floor.json"
        try:
            image = read_json(path)["image"]
            scale, (left, bottom) = float(image["m_per_px"]), image["bottom_left_m"]
            with Image.open(self.plan_png_path) as picture:
                width, height = picture.size
        except (KeyError, TypeError, ValueError) as error:
            raise DataSetError(path, f"needs image.m_per_px and image.bottom_left_m ({error})") from error
        except (OSError, UnidentifiedImageError) as error:
            raise DataSetError(self.plan_png_path, f"cannot be read ({error})") from error
        return (float(left), float(bottom), left + scale * width, bottom + scale * height)

    @cached_property
    def published(self) -> tuple[PublishedRuns, ...]:
        """What the source published, one entry per method and setting; empty if the file is not there."""
        path = self.folder / "published_runs.parquet"
        return tuple(_read_published(path)) if path.is_file() else ()

    @cached_property
    def _walks(self) -> tuple[RecordedWalk, ...]:
        return tuple(_read_walks(self.folder))


@dataclass(frozen=True)
class Kaist:
    """The data set: a folder of floors."""

    folder: Path
    _floors: dict[str, KaistFloor] = field(repr=False)

    def floors(self) -> tuple[str, ...]:
        """Names of the floors found, sorted."""
        return tuple(self._floors)

    def floor(self, name: str) -> KaistFloor:
        """One floor by name; raises :class:`DataSetError` if it is not there."""
        if name not in self._floors:
            raise DataSetError(self.folder, f"has no floor {name!r}; found: {', '.join(self._floors)}")
        return self._floors[name]


def open_kaist(data_dir: Path) -> Kaist:
    """Open the data set below ``data_dir`` (the folder that holds ``kaist/``, or that folder itself).

    Raises
    ------
    DataSetError
        No floor is found.
    """
    for folder in (data_dir / "kaist", data_dir):
        found = sorted(path.parent for path in folder.glob("*/traces.parquet"))
        if found:
            return Kaist(folder, {path.name: KaistFloor(path.name, path) for path in found})
    raise DataSetError(data_dir, "holds no kaist/<floor>/traces.parquet")


def track_number(walk_id: str) -> int | None:
    """Number of a test track: what its id ends with (``test-s9-2`` is track 2)."""
    found = re.search(r"(\d+)$", walk_id)
    return int(found.group(1)) if found else None


def _read_walks(folder: Path) -> Iterator[RecordedWalk]:
    traces = read_table(
        folder / "traces.parquet", ("trace_id", "kind", "device", "row_start", "n_samples", "start_unix_ms")
    ).to_pylist()
    imu = ImuColumns.read(folder / "imu.parquet")
    labels = read_labels(folder / "waypoints.parquet")
    for trace in traces:
        walk = _walk(trace, imu, labels.get(str(trace["trace_id"]), NO_LABELS).waypoints(int(trace["start_unix_ms"])))
        if walk is not None:
            yield walk


def _walk(trace: dict[str, Any], imu: ImuColumns, points: Any) -> RecordedWalk | None:
    samples = imu.samples(trace)
    if len(points) < 2 or samples is None:
        return None  # without two labels there is neither truth nor survey
    return RecordedWalk(
        walk_id=str(trace["trace_id"]),
        split=str(trace["kind"]),
        samples=samples,
        waypoints=points,
        wifi_log=None,
        device=str(trace["device"]),
        path_length_m=path_length(points),
        device_heading=SURVEY_DEVICE_HEADING if trace["kind"] == SURVEY else None,
    )


def _read_published(path: Path) -> Iterator[PublishedRuns]:
    table = read_table(path, ("method", "particles", "step_m", "track", "mean_err_from_3rd_m"))
    method = np.array([str(name) for name in table["method"].to_pylist()])
    particles, step_m, track, error = (
        column(table, name) for name in ("particles", "step_m", "track", "mean_err_from_3rd_m")
    )
    for key in sorted(set(zip(method.tolist(), particles.tolist(), step_m.tolist(), strict=True))):
        rows = (method == key[0]) & (particles == key[1]) & (step_m == key[2])
        yield PublishedRuns(key[0], int(key[1]), key[2], track[rows].astype(np.int64), error[rows])
