"""What a level needs before walks are replayed: its map and its surveyed area, both from train walks only."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import app.engine
from app.engine.errors import EngineError
from app.engine.inertial import detect_steps
from app.engine.mapping import FloorPlan, build_map
from app.engine.types import FeatureSet, GridMap, MapBuildSettings, RadioMap, RouteLines, SurveyWalk
from app.evaluation.datasets.plans import GeoJson
from app.evaluation.truth import SurveyedArea, survey_track


@dataclass(frozen=True, slots=True)
class PreparedLevel:
    """Map and surveyed area of a level.

    Attributes
    ----------
    name : str
    grid_map : GridMap or None
        None if it could not be built (``problem`` says why), or is not wanted (the service has it).
    area : SurveyedArea
    n_walks : int
        Survey walks that went in.
    build_s : float or None
        None if the map came from the cache.
    problem : str
    """

    name: str
    grid_map: GridMap | None
    area: SurveyedArea
    n_walks: int
    build_s: float | None = None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class PrepareTask:
    """Work order for :func:`prepare_level`; pickles."""

    name: str
    walks: tuple[SurveyWalk, ...]
    settings: MapBuildSettings
    cache: Path | None = None
    with_map: bool = True
    vector_plan: GeoJson | None = None


def prepare_level(task: PrepareTask) -> PreparedLevel:
    """Build the map of a level (or take it from the cache) and find the surveyed area."""
    area = surveyed_area(task.walks)
    if not task.with_map:
        return PreparedLevel(task.name, None, area, len(task.walks))
    cached = task.cache / f"{map_key(task)}.npz" if task.cache else None
    if cached and cached.is_file():
        return PreparedLevel(task.name, load_map(cached), area, len(task.walks))
    began = time.perf_counter()
    try:
        plan = None if task.vector_plan is None else FloorPlan.from_geojson(task.vector_plan)
        grid_map = build_map(task.name, task.walks, task.settings, plan=plan).grid_map
    except EngineError as error:
        return PreparedLevel(task.name, None, area, len(task.walks), problem=str(error))
    build_s = time.perf_counter() - began
    if cached:
        save_map(grid_map, cached)
    return PreparedLevel(task.name, grid_map, area, len(task.walks), build_s=build_s)


def surveyed_area(walks: Sequence[SurveyWalk]) -> SurveyedArea:
    """Where the survey walks have samples."""
    return SurveyedArea.from_tracks(
        survey_track(walk.samples.t, detect_steps(walk.samples), walk.waypoints) for walk in walks
    )


def map_key(task: PrepareTask) -> str:
    """SHA-256 of all that a map depends on: level, settings, walks and the engine's source."""
    digest = hashlib.sha256(engine_hash().encode())
    settings = asdict(task.settings) | {
        "level": task.name, "walks": [(walk.walk_id, walk.device_heading) for walk in task.walks],
        "plan": task.vector_plan,
    }  # fmt: skip
    digest.update(json.dumps(settings, sort_keys=True).encode())
    for walk in task.walks:
        samples, waypoints = walk.samples, walk.waypoints
        for column in (samples.t, samples.mag, samples.acc, samples.gyro, waypoints.t, waypoints.x, waypoints.y):
            digest.update(np.ascontiguousarray(column).tobytes())
        for kind, scans in (("wifi", walk.wifi), ("ble", walk.ble)):
            if scans is not None:
                digest.update(f"{kind} {len(scans.address)} {' '.join(scans.address)}".encode())
                digest.update(scans.t.tobytes() + scans.rssi.tobytes())
    return digest.hexdigest()


def engine_hash() -> str:
    """SHA-256 of the engine's source: a changed engine must not meet maps of the old one."""
    digest = hashlib.sha256()
    root = Path(app.engine.__path__[0])
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def save_map(grid_map: GridMap, path: Path) -> None:
    """Write a map; the file appears whole or not at all."""
    header = {
        name: getattr(grid_map, name) for name in ("level_id", "features", "x0", "y0", "cell_m", "mapped_m", "noise_sd")
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.stem}.{os.getpid()}.tmp")
    arrays: dict[str, Any] = {"mean": grid_map.mean, "sd": grid_map.sd, "support": grid_map.support}
    if grid_map.obstacle is not None:
        arrays["obstacle"] = grid_map.obstacle
    if grid_map.radio is not None:
        arrays |= _radio_arrays(grid_map.radio)
    if grid_map.routes is not None:
        arrays |= {"routes_xy": grid_map.routes.xy, "routes_first": grid_map.routes.first}
    with temporary.open("wb") as file:
        np.savez(file, header=np.array(json.dumps(header)), **arrays)
    temporary.replace(path)


def load_map(path: Path) -> GridMap:
    """Read a map written by :func:`save_map`."""
    with np.load(path, allow_pickle=False) as content:
        header = json.loads(str(content["header"]))
        return GridMap(
            level_id=header["level_id"],
            features=FeatureSet(header["features"]),
            x0=header["x0"],
            y0=header["y0"],
            cell_m=header["cell_m"],
            mean=content["mean"],
            sd=content["sd"],
            support=content["support"],
            mapped_m=header["mapped_m"],
            noise_sd=tuple(header["noise_sd"]),
            obstacle=content.get("obstacle"),
            radio=_radio_from(content) if "radio" in content else None,
            routes=RouteLines(content["routes_xy"], content["routes_first"]) if "routes_xy" in content else None,
        )


def _radio_arrays(radio: RadioMap) -> dict[str, Any]:
    header = {"x0": radio.x0, "y0": radio.y0, "cell_m": radio.cell_m, "addresses": radio.addresses}
    arrays = {"radio_mean": radio.mean, "radio_sd": radio.sd, "radio_seen": radio.seen}
    return {"radio": np.array(json.dumps(header)), **arrays}


def _radio_from(content: Mapping[str, Any]) -> RadioMap:
    header = json.loads(str(content["radio"]))
    return RadioMap(
        x0=header["x0"],
        y0=header["y0"],
        cell_m=header["cell_m"],
        addresses=tuple(header["addresses"]),
        mean=content["radio_mean"],
        sd=content["radio_sd"],
        seen=content["radio_seen"],
    )
