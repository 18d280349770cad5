"""Survey planning: how good a map is, where to walk next, what to expect along a route."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from threading import Lock

import numpy as np

from app.engine.mapping import MapModel
from app.engine.mapping.age import newest_evidence
from app.engine.mapping.forecast import HEADINGS_DEG, AccuracyForecast, WalkerErrors, forecast_accuracy
from app.engine.mapping.outlook import RouteOutlook, route_outlook
from app.engine.mapping.quality import (
    ConflictView,
    CoverageSummary,
    find_conflicts,
    summarize_coverage,
    walkable_space,
)
from app.engine.mapping.suggestions import DEFAULT, Plan, suggest_lines
from app.engine.types import Float32Array, GridMap
from app.services.clock import Clock
from app.services.errors import InvalidError, NoEvidenceError
from app.services.maps import MapService
from app.services.ports import UnitOfWorkFactory
from app.services.records import Anchor, MapInfo

MAX_ROUTE_M = 2000.0
_KEPT = 2
"""Accuracy forecasts kept: tens of megabytes each."""


class QualityLayer(StrEnum):
    """Rasters of a map's quality."""

    MEAN_ERROR = "mean_error"
    WORST_ERROR = "worst_error"
    ERROR = "error"
    ALONG = "along"
    ACROSS = "across"
    COVERAGE = "coverage"
    CONFLICT = "conflict"
    SOURCES = "sources"
    AGE = "age"


HEADING_LAYERS = frozenset({QualityLayer.ERROR, QualityLayer.ALONG, QualityLayer.ACROSS})
EVIDENCE_LAYERS = frozenset({QualityLayer.CONFLICT, QualityLayer.SOURCES})
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Percentiles of the expected error over mapped, walkable ground, m; None where nothing is mapped."""

    p50_m: float | None
    p90_m: float | None

    @classmethod
    def of(cls, error: Float32Array) -> ErrorSummary:
        """Of a raster."""
        known = error[np.isfinite(error)]
        if not known.size:
            return cls(None, None)
        p50, p90 = np.percentile(known, (50, 90)).tolist()
        return cls(p50, p90)


@dataclass(frozen=True, slots=True)
class ConflictSummary:
    """How many 1 m cells several sources passed, and in how many they disagree beyond their noise."""

    shared_cells: int
    conflict_cells: int

    @classmethod
    def of(cls, view: ConflictView) -> ConflictSummary:
        """Of a view."""
        return cls(int(np.isfinite(view.ratio).sum()), int(view.conflict.sum()))


@dataclass(frozen=True, slots=True)
class MapQuality:
    """Summary of a map's quality; ``conflict`` is None for a map without stored evidence."""

    info: MapInfo
    coverage: CoverageSummary
    mean_error: ErrorSummary
    worst_error: ErrorSummary
    by_heading: tuple[tuple[int, ErrorSummary], ...]
    conflict: ConflictSummary | None


@dataclass(frozen=True, slots=True, eq=False)
class QualityRaster:
    """Values, shape (rows, columns), NaN where there is nothing to say; node ``[r, c]`` lies at ``x0 + c * cell_m``."""

    values: Float32Array
    x0: float
    y0: float
    cell_m: float


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """Suggested lines of a map, and the venue's anchor if it has one."""

    info: MapInfo
    plan: Plan
    venue_id: str
    anchor: Anchor | None


class PlanningService:
    """Reads maps; stores nothing."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, maps: MapService) -> None:
        self._uow = uow
        self._clock = clock
        self._maps = maps
        # map versions never change; computed by one caller at a time, so that a second one finds it done
        self._lock = Lock()
        self._kept = lru_cache(maxsize=_KEPT)(lambda map_id: forecast_accuracy(maps.grid(map_id)))

    def quality(self, map_id: str) -> MapQuality:
        """Coverage, expected accuracy and conflicts of a map."""
        info, grid, accuracy = self._maps.get(map_id), self._maps.grid(map_id), self._accuracy(map_id)
        view = self._conflicts(map_id, grid)
        return MapQuality(
            info=info,
            coverage=summarize_coverage(grid),
            mean_error=ErrorSummary.of(accuracy.mean_error()),
            worst_error=ErrorSummary.of(accuracy.worst_error()),
            by_heading=tuple((deg, ErrorSummary.of(accuracy.error(k))) for k, deg in enumerate(HEADINGS_DEG)),
            conflict=None if view is None else ConflictSummary.of(view),
        )

    def raster(self, map_id: str, layer: QualityLayer, heading_deg: int | None = None) -> QualityRaster:
        """One layer of a map's quality.

        InvalidError for a heading that is missing or not asked for; NoEvidenceError for layers that need it.
        """
        _check_heading(layer, heading_deg)
        grid = self._maps.grid(map_id)
        if layer is QualityLayer.AGE:
            return self._age(map_id, grid)
        if layer in EVIDENCE_LAYERS:
            return _conflict_raster(self._conflicts(map_id, grid), map_id, layer)
        if layer is QualityLayer.COVERAGE:
            values = np.where(walkable_space(grid), grid.mapped, np.nan).astype(np.float32)
            return QualityRaster(values, grid.x0, grid.y0, grid.cell_m)
        accuracy = self._accuracy(map_id)
        values = _accuracy_values(accuracy, layer, heading_deg)
        return QualityRaster(values, accuracy.x0, accuracy.y0, accuracy.cell_m)

    def suggestions(self, map_id: str, count: int) -> SurveyPlan:
        """Lines to survey next, best first."""
        info, grid = self._maps.get(map_id), self._maps.grid(map_id)
        with self._uow() as uow:
            venue = uow.venues.get(uow.levels.get(info.level_id).venue_id)
        evidence = self._maps.evidence(map_id)
        plan = suggest_lines(
            grid,
            count=count,
            field_sd=info.field_sd,
            covariance=DEFAULT if info.model is None else MapModel.from_values(info.model).covariance,
            evidence=evidence,
            conflict=None if evidence is None else find_conflicts(grid, evidence),
            now=self._clock().timestamp(),
        )
        return SurveyPlan(info, plan, venue.id, venue.anchor)

    def forecast(self, map_id: str, route: Sequence[tuple[float, float]], known_m: float) -> RouteOutlook:
        """What to expect along a route in level metres; ``known_m``: standard deviation of the position at its start.

        InvalidError for a route of fewer than two different points, or longer than 2 km.
        """
        grid, points = self._maps.grid(map_id), np.array(route, dtype=np.float64)
        length = float(np.hypot(*np.diff(points, axis=0).T).sum())
        if not 1e-3 < length <= MAX_ROUTE_M:
            raise InvalidError("route", f"is {length:.0f} m long", f"send 1 mm to {MAX_ROUTE_M:.0f} m at a time")
        return route_outlook(grid, points, WalkerErrors(position_m=known_m))

    def _accuracy(self, map_id: str) -> AccuracyForecast:
        with self._lock:
            return self._kept(map_id)

    def _age(self, map_id: str, grid: GridMap) -> QualityRaster:
        """Days from the newest evidence of each metre to the making of the map: a version never changes."""
        evidence = self._maps.evidence(map_id)
        if evidence is None:
            raise NoEvidenceError(map_id)
        newest = newest_evidence(grid, evidence)
        days = (self._maps.get(map_id).created_at.timestamp() - newest.t) / _DAY_S
        half = 0.5 * newest.cell_m
        return QualityRaster(days.astype(np.float32), newest.x0 + half, newest.y0 + half, newest.cell_m)

    def _conflicts(self, map_id: str, grid: GridMap) -> ConflictView | None:
        evidence = self._maps.evidence(map_id)
        return None if evidence is None else find_conflicts(grid, evidence)


def _check_heading(layer: QualityLayer, heading_deg: int | None) -> None:
    known = ", ".join(map(str, HEADINGS_DEG))
    if layer in HEADING_LAYERS and heading_deg not in HEADINGS_DEG:
        what = "is missing" if heading_deg is None else f"{heading_deg} is not one of those computed"
        raise InvalidError("heading_deg", what, f"send one of: {known}")
    if layer not in HEADING_LAYERS and heading_deg is not None:
        raise InvalidError("heading_deg", f"means nothing to {layer!s}", "leave it out")


def _accuracy_values(accuracy: AccuracyForecast, layer: QualityLayer, heading_deg: int | None) -> Float32Array:
    if layer is QualityLayer.MEAN_ERROR:
        return accuracy.mean_error()
    if layer is QualityLayer.WORST_ERROR or heading_deg is None:
        return accuracy.worst_error()
    read = {
        QualityLayer.ERROR: accuracy.error,
        QualityLayer.ALONG: accuracy.along,
        QualityLayer.ACROSS: accuracy.across,
    }[layer]
    return read(HEADINGS_DEG.index(heading_deg))


def _conflict_raster(view: ConflictView | None, map_id: str, layer: QualityLayer) -> QualityRaster:
    if view is None:
        raise NoEvidenceError(map_id)
    if layer is QualityLayer.CONFLICT:
        values = view.ratio
    else:
        values = np.where(view.sources > 0, view.sources, np.nan).astype(np.float32)
    half = 0.5 * view.cell_m
    return QualityRaster(values, view.x0 + half, view.y0 + half, view.cell_m)
