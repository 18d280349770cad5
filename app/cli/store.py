"""How the store answers when it is large: what ``isodyn bench store`` fills and times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from app.engine.types import FeatureSet, GridMap, Progress
from app.services.clock import utc_now
from app.services.ids import new_id
from app.services.records import Anchor, Level, MapInfo, PackedMap, Venue, VenueKind
from app.services.search import Near, Search, SearchService
from app.services.stats import StatsService
from app.storage.database import Database
from app.storage.unit_of_work import SqlUnitOfWork

TOWN_LEVELS = 100
"""Levels of a town. A larger store has more towns, not denser ones: otherwise a search would find more, and take longer
for it."""
_PAGE = 20
"""Rows a page, so that also the small store fills it."""
VENUE_LEVELS = 4
_TOWN_DEG = 0.03
_EXTENT = (0.0, 0.0, 80.0, 50.0)
_CELL_M = 0.5
_BATCH = 20
_WARM_UP = 5


@dataclass(frozen=True, slots=True)
class Timing:
    """Processor time of one operation on a store of ``levels`` levels, ms."""

    task: str
    levels: int
    p50_ms: float
    p95_ms: float

    def as_dict(self) -> dict[str, str | int | float]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Store:
    """A filled store and what is in it."""

    database: Database
    towns: tuple[Anchor, ...]
    level_ids: tuple[str, ...]
    venue_ids: tuple[str, ...]
    map_ids: tuple[str, ...]


def time_store(levels: int, rounds: int, progress: Progress, *, seed: int = 0) -> list[Timing]:
    """Fill a temporary store, time what must stay flat, and throw it away."""
    with filled_store(levels, lambda share, text: progress(0.8 * share, text), seed=seed) as store:
        timings = []
        tasks = _tasks(store, np.random.default_rng(seed + 1))
        for k, (name, task) in enumerate(tasks.items()):
            progress(0.8 + 0.2 * k / len(tasks), name)
            spent = 1e3 * np.array([_cpu(task) for _ in range(rounds + _WARM_UP)][_WARM_UP:])
            timings.append(Timing(name, levels, *(float(np.quantile(spent, q)) for q in (0.5, 0.95))))
        return timings


def _cpu(task: Callable[[], object]) -> float:
    began = time.process_time()
    task()
    return time.process_time() - began


def _tasks(store: Store, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    search = SearchService(uow=store.database, clock=utc_now)
    stats = StatsService(uow=store.database, clock=utc_now)

    def one(ids: Sequence[str]) -> str:
        return ids[int(rng.integers(len(ids)))]

    def near() -> Near:
        town = store.towns[int(rng.integers(len(store.towns)))]
        dy, dx = _TOWN_DEG * rng.uniform(-0.5, 0.5, 2)
        return Near(town.latitude_deg + dy, town.longitude_deg + dx, 1_000.0)

    def with_maps(use: Callable[[SqlUnitOfWork], object]) -> Callable[[], object]:
        def task() -> object:
            with store.database() as uow:
                return use(uow)

        return task

    last = store.level_ids[min(50, len(store.level_ids) - 1)]
    return {
        "levels, first page": lambda: search.levels(limit=_PAGE),
        "levels, last page": lambda: search.levels(cursor=last, limit=_PAGE),
        "venues, first page": lambda: search.venues(limit=_PAGE),
        "levels of a venue": lambda: search.levels(venue_id=one(store.venue_ids)),
        "levels within 1 km, nearest first": lambda: search.levels(Search(near=near()), limit=_PAGE),
        "venues within 1 km, nearest first": lambda: search.venues(Search(near=near()), limit=_PAGE),
        "levels in a box of 2 km": lambda: search.levels(Search(box=near().box()), limit=_PAGE),
        "levels by name": lambda: search.levels(Search(words=("house", str(rng.integers(len(store.venue_ids)))))),
        "levels by storey": lambda: search.levels(Search(ordinal=int(rng.integers(VENUE_LEVELS))), limit=_PAGE),
        "read a level": with_maps(lambda uow: uow.levels.get(one(store.level_ids))),
        "map versions of a level": with_maps(
            lambda uow: uow.maps.list(level_id=one(store.level_ids), cursor=None, limit=_PAGE)
        ),
        "load a map": with_maps(lambda uow: uow.maps.load(one(store.map_ids))),
        "next version of a map": with_maps(lambda uow: uow.maps.next_version(one(store.level_ids))),
        "counts (stats)": stats.stats,
    }  # fmt: skip


@contextmanager
def filled_store(levels: int, progress: Progress, *, seed: int = 0) -> Iterator[Store]:
    """A temporary store with so many levels in towns all over the earth, each with a map whose tiles are shared."""
    rng = np.random.default_rng(seed)
    n_towns = -(-levels // TOWN_LEVELS)
    latitude = np.degrees(np.arcsin(rng.uniform(-0.85, 0.85, n_towns)))  # as many to an area everywhere
    longitude = rng.uniform(-180.0, 180.0, n_towns)
    towns = tuple(Anchor(float(a), float(b)) for a, b in zip(latitude, longitude, strict=True))
    with TemporaryDirectory(prefix="isodyn-bench-") as folder:
        database = Database.at(Path(folder) / "isodyn.db")
        try:
            database.migrate()
            yield _fill(database, towns, levels, rng, progress)
        finally:
            database.close()


def _fill(
    database: Database, towns: tuple[Anchor, ...], levels: int, rng: np.random.Generator, progress: Progress
) -> Store:
    grid = _grid_map(rng)
    with database() as uow:
        packed = uow.maps.pack(grid)
    venue_ids: list[str] = []
    level_ids: list[str] = []
    map_ids: list[str] = []
    n_venues = -(-levels // VENUE_LEVELS)
    for start in range(0, n_venues, _BATCH):
        progress(start / n_venues, f"filling {levels} levels")
        with database(write=True) as uow:
            for k in range(start, min(start + _BATCH, n_venues)):
                venue = _venue(k, towns[k * VENUE_LEVELS // TOWN_LEVELS], rng)
                uow.venues.add(venue)
                venue_ids.append(venue.id)
                for ordinal in range(min(VENUE_LEVELS, levels - len(level_ids))):
                    level = _level(venue.id, ordinal)
                    uow.levels.add(level)
                    info = _map_info(level.id, grid, packed)
                    uow.maps.add(info, packed)
                    uow.levels.set_current_map(level.id, info.id, level.created_at)
                    level_ids.append(level.id)
                    map_ids.append(info.id)
    return Store(database, towns, tuple(level_ids), tuple(venue_ids), tuple(map_ids))


def _now() -> datetime:
    return datetime.now(UTC)


def _venue(number: int, town: Anchor, rng: np.random.Generator) -> Venue:
    dy, dx = _TOWN_DEG * rng.uniform(-0.5, 0.5, 2)
    longitude = (town.longitude_deg + dx + 180.0) % 360.0 - 180.0
    anchor = Anchor(town.latitude_deg + dy, longitude, float(rng.uniform(0, 360)))
    now = _now()
    return Venue(new_id("ven", now), f"House {number}", VenueKind.INDOOR, anchor, now, now)


def _level(venue_id: str, ordinal: int) -> Level:
    now = _now()
    return Level(new_id("lvl", now), venue_id, f"F{ordinal + 1}", ordinal, _EXTENT, False, False, None, now, now)


def _grid_map(rng: np.random.Generator) -> GridMap:
    x_min, y_min, x_max, y_max = _EXTENT
    shape = (int((y_max - y_min) / _CELL_M) + 1, int((x_max - x_min) / _CELL_M) + 1)
    mean = rng.normal(0.0, 10.0, (3, *shape)).astype(np.float32)
    sd, support = np.ones_like(mean), np.zeros(shape, np.float32)
    return GridMap("", FeatureSet.VECTOR, x_min, y_min, _CELL_M, mean, sd, support, 1.5, (2.0, 2.0, 2.0))


def _map_info(level_id: str, grid: GridMap, packed: PackedMap) -> MapInfo:
    now = _now()
    rows, columns = grid.shape
    plain: dict[str, Any] = {
        name: getattr(grid, name) for name in ("features", "x0", "y0", "cell_m", "mapped_m", "noise_sd")
    }
    return MapInfo(
        id=new_id("map", now),
        level_id=level_id,
        version=1,
        parent_id=None,
        hash=packed.hash,
        rows=rows,
        columns=columns,
        mapped_share=1.0,
        mapped_area_m2=rows * columns * grid.cell_m**2,
        n_walks=0,
        n_samples=0,
        length_scale_m=5.0,
        field_sd=(10.0, 10.0, 10.0),
        walks=(),
        build_s=0.0,
        created_at=now,
        **plain,
    )


def flatness(timings: Sequence[Timing], few: int, many: int) -> dict[str, float]:
    """How many times as long the median of each task takes with many levels as with few."""
    p50 = {(timing.task, timing.levels): timing.p50_ms for timing in timings}
    return {task: p50[task, many] / max(time_ms, 1e-6) for (task, levels), time_ms in p50.items() if levels == few}
