"""A map brought up to date by new evidence: only the nodes that the change can reach are kriged anew.

What was fitted when the map was built (covariance, level, repeatability) stays; a later build fits it again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from app.engine.errors import InputError, MapError
from app.engine.mapping.builder import MARGIN_M, MAX_NODES, SUPPORT_CAP_M
from app.engine.mapping.kriging import LARGEST_BLOCK, krige_nodes
from app.engine.mapping.model import MapModel, field_samples
from app.engine.mapping.samples import PlacedSamples, place_samples
from app.engine.mapping.settling import SettledWalk, settle_walk
from app.engine.types import (
    BoolArray,
    Evidence,
    EvidenceSource,
    FeatureSet,
    Float32Array,
    Float64Array,
    GridMap,
    Progress,
    RouteLines,
    SourceKind,
    SurveyWalk,
    WalkReport,
)

SQUARE = 64
"""Nodes by which a map grows to the west and south: the side of its stored tiles, whose content then stays."""
_WALKED_DEPTH_M = 1.0

Weigher = Callable[[Evidence], Evidence]
"""Gives every row its weight, from all rows near it."""

Reducer = Callable[[Evidence], Evidence]
"""Merges or drops rows where there are more than a map needs."""


@dataclass(frozen=True, slots=True)
class NewWalk:
    """A survey walk and who brought it."""

    walk: SurveyWalk
    contributor: str = ""
    device: str = ""


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """A map after new evidence.

    Attributes
    ----------
    grid_map : GridMap
    evidence : Evidence
        All of what was given, with the new rows and new weights.
    walks : tuple of WalkReport
        Of the new survey walks, in the order given.
    changed : array, shape (rows, columns), bool
        Nodes that were kriged anew.
    """

    grid_map: GridMap
    evidence: Evidence
    walks: tuple[WalkReport, ...]
    changed: BoolArray


def update_map(
    current: GridMap,
    evidence: Evidence,
    model: MapModel,
    *,
    walks: Sequence[NewWalk] = (),
    contributed: Evidence | None = None,
    removed: Sequence[str] = (),
    align: bool = True,
    weigh: Weigher | None = None,
    reduce: Reducer | None = None,
    progress: Progress | None = None,
) -> MapUpdate:
    """Add walks and contributions to a map, or take sources out of it.

    Parameters
    ----------
    current : GridMap
        Of the ``vector`` features.
    evidence : Evidence
        What ``current`` rests on, at least all of it within three times the covariance's reach of what comes or goes.
    model : MapModel
        Fitted when the map was built.
    walks : sequence of NewWalk
        Survey walks; those that cannot be placed are left out and their report says why.
    contributed : Evidence or None
        Rows of sessions, corrected and placed.
    removed : sequence of str
        Ids of sources to take out.
    align : bool
        As in the build.
    reduce : callable or None
        Bounds the rows of a place before they are weighed.
    weigh : callable or None
        Weighs all rows again; rows whose weight changes count as changed.

    Raises
    ------
    MapError
        The map is not of the ``vector`` features, or would grow beyond 16 million nodes.
    """
    if current.features is not FeatureSet.VECTOR:
        raise MapError(f"a map of {current.features.value!r} cannot be updated; build it anew")
    say = progress or (lambda _fraction, _what: None)
    say(0.0, "placing walks")
    settled, reports = _settle(walks, current, align=align)
    rows = [_rows(new, one) for new, one in settled]
    joined = Evidence.joined([evidence.without(removed), *rows, *([contributed] if contributed is not None else [])])
    joined = joined if reduce is None else reduce(joined)
    weighed = joined if weigh is None else _weighed_near(joined, weigh(joined), _changed_rows(evidence, joined), model)
    say(0.4, "kriging")
    changed_xy = _changed_rows(evidence, weighed)
    grown = _grown(current, weighed.xy[weighed.weight > 0.0])
    result, changed = _krige_near(grown, weighed, model, changed_xy, say)
    lines = [one.walk.xy for _, one in settled]
    return MapUpdate(replace(result, routes=_with_lines(result.routes, lines)), weighed, reports, changed)


def _settle(
    walks: Sequence[NewWalk], current: GridMap, *, align: bool
) -> tuple[list[tuple[NewWalk, SettledWalk]], tuple[WalkReport, ...]]:
    settled, reports = [], []
    for new in walks:
        try:
            placed = place_samples(new.walk)
        except InputError as error:
            reports.append(WalkReport(new.walk.walk_id, 0, 0.0, (), 0.0, rejected=str(error)))
            continue
        if np.prod(_shape_with(current, placed.xy), dtype=np.float64) > MAX_NODES:
            far = f"lies so far off that the map would grow beyond {MAX_NODES} nodes; are its waypoints of this level?"
            reports.append(WalkReport(new.walk.walk_id, 0, 0.0, (), 0.0, rejected=far))
            continue
        one = settle_walk(placed, current, align=align)
        settled.append((new, one))
        reports.append(_report(placed, one, current))
    return settled, tuple(reports)


def _report(placed: PlacedSamples, one: SettledWalk, current: GridMap) -> WalkReport:
    return WalkReport(
        walk_id=placed.walk_id,
        n_steps=len(placed) // 2,
        length_m=float(np.hypot(*np.diff(one.walk.xy, axis=0).T).sum()),
        offset=tuple(float(v) for v in one.hard_iron),
        residual_rms=float(np.sqrt(((one.field - _level_of(current)) ** 2).mean())),
        stride_scale=placed.stride_scale,
    )


def _level_of(grid_map: GridMap) -> Float64Array:
    """Mean field of the level: what stands at the nodes that nobody was near, or else the mean of all."""
    far = grid_map.support >= SUPPORT_CAP_M
    nodes = grid_map.mean[:, far] if far.any() else grid_map.mean.reshape(grid_map.mean.shape[0], -1)
    return np.asarray(nodes.mean(axis=1, dtype=np.float64))


def _rows(new: NewWalk, one: SettledWalk) -> Evidence:
    source = EvidenceSource(
        one.walk.walk_id, SourceKind.SURVEY, contributor=new.contributor, device=new.device, t=float(one.walk.t[0])
    )
    return Evidence.of(FeatureSet.VECTOR, source, one.walk.xy, one.field)


def _weighed_near(joined: Evidence, weighed: Evidence, changed_xy: Float32Array, model: MapModel) -> Evidence:
    """New weights about what came or went; further off evidence may be missing, and weights stay."""
    if not len(changed_xy) or not len(joined):
        return joined
    distance, _ = cKDTree(changed_xy).query(joined.xy, distance_upper_bound=model.covariance.reach_m)
    surveyed = np.array([source.kind is SourceKind.SURVEY for source in joined.sources], dtype=bool)[joined.source]
    # The build gave rows of surveys that contradict other surveys less: so it stays, unless a change overtakes them.
    # No build gives 0: such a row was overtaken before, and counts again once what told of the change is gone.
    held = surveyed & (joined.weight > 0.0)
    fresh = np.where(held, np.minimum(joined.weight, weighed.weight), weighed.weight)
    weight = np.where(np.isfinite(distance), fresh, joined.weight)
    return replace(joined, weight=weight.astype(np.float32))


def _changed_rows(before: Evidence, after: Evidence) -> Float32Array:
    """Places of rows that came, went, or changed their weight, shape (k, 2)."""
    number: dict[str, int] = {}
    old, new = _keyed(before, number), _keyed(after, number)
    _, first = np.unique(np.concatenate([old, new]), axis=0, return_index=True)
    counts = np.unique(np.concatenate([old, new]), axis=0, return_counts=True)[1]
    rows = np.concatenate([before.xy, after.xy])
    return np.asarray(rows[first[counts == 1]])


def _keyed(evidence: Evidence, number: dict[str, int]) -> Float64Array:
    """Rows in a form in which equal rows are equal: source (numbered here), place, field, weight.

    A source never has two rows alike, but a copied walk has those of another.
    """
    source = np.array([number.setdefault(one.id, len(number)) for one in evidence.sources], np.int64)[evidence.source]
    return np.column_stack([source, evidence.xy, evidence.values, evidence.weight]).astype(np.float64)


def _more(current: GridMap, xy: Float32Array | Float64Array) -> tuple[int, int, int, int]:
    """Whole squares to add in the west and south, nodes to add in the east and north, so that rows keep a margin."""
    x_min, y_min, x_max, y_max = current.extent
    lo, hi = xy.min(axis=0) - 0.5 * MARGIN_M, xy.max(axis=0) + 0.5 * MARGIN_M
    side = SQUARE * current.cell_m
    west, south = (max(0, int(np.ceil((edge - v) / side))) for edge, v in ((x_min, lo[0]), (y_min, lo[1])))
    east, north = (max(0, int(np.ceil((v - edge) / current.cell_m))) for edge, v in ((x_max, hi[0]), (y_max, hi[1])))
    return west, south, east, north


def _shape_with(current: GridMap, xy: Float64Array) -> tuple[int, int]:
    """Rows and columns of the map once it holds these rows."""
    west, south, east, north = _more(current, xy)
    rows, columns = current.shape
    return rows + SQUARE * south + north, columns + SQUARE * west + east


def _grown(current: GridMap, xy: Float32Array) -> GridMap:
    """The map with whole squares added where rows lie beyond its margin; inner squares keep their content."""
    west, south, east, north = _more(current, xy) if len(xy) else (0, 0, 0, 0)
    if not any((west, south, east, north)):
        return current
    rows, columns = current.shape
    if (rows + SQUARE * south + north) * (columns + SQUARE * west + east) > MAX_NODES:
        raise MapError(f"the map would grow beyond {MAX_NODES} nodes; build one of the level with a larger cell_m")
    side = SQUARE * current.cell_m
    pad = ((SQUARE * south, north), (SQUARE * west, east))

    def wider(layer: Float32Array, fill: float) -> Float32Array:
        return np.pad(layer, pad, constant_values=fill).astype(np.float32)

    mean, sd = _level_of(current), current.sd.reshape(current.sd.shape[0], -1).max(axis=1)
    return replace(
        current,
        x0=current.x0 - west * side,
        y0=current.y0 - south * side,
        mean=np.stack([wider(layer, float(v)) for layer, v in zip(current.mean, mean, strict=True)]),
        sd=np.stack([wider(layer, float(v)) for layer, v in zip(current.sd, sd, strict=True)]),
        support=wider(current.support, SUPPORT_CAP_M),
        # nobody drew a plan for what lies beyond it: where somebody walked it is free
        obstacle=None if current.obstacle is None else wider(current.obstacle, 0.0),
    )


def _krige_near(
    grid_map: GridMap, evidence: Evidence, model: MapModel, changed_xy: Float32Array, say: Progress
) -> tuple[GridMap, BoolArray]:
    """Krige every node that a changed row reaches, from all rows that reach it."""
    rows, columns = grid_map.shape
    if not len(changed_xy):
        return grid_map, np.zeros((rows, columns), dtype=bool)
    x: Float64Array = grid_map.x0 + grid_map.cell_m * np.arange(columns, dtype=np.float64)
    y: Float64Array = grid_map.y0 + grid_map.cell_m * np.arange(rows, dtype=np.float64)
    nodes = np.stack([part.ravel() for part in np.meshgrid(x, y)], axis=1)
    reach = model.covariance.reach_m + LARGEST_BLOCK * grid_map.cell_m  # nodes of a block share their neighbours
    apart = np.asarray(cKDTree(changed_xy).query(nodes, distance_upper_bound=max(reach, SUPPORT_CAP_M))[0])
    changed: BoolArray = np.reshape(apart <= reach, (rows, columns))
    used = evidence.subset(evidence.weight > 0.0)
    mean, sd = grid_map.mean.copy(), grid_map.sd.copy()
    mean[:, changed], sd[:, changed] = krige_nodes(
        field_samples(_within(used, nodes[changed.ravel()], reach), model), model.level, model.covariance, x, y,
        changed, progress=lambda f, what: say(0.4 + 0.5 * f, what),
    )  # fmt: skip
    obstacle = None if grid_map.obstacle is None else grid_map.obstacle.copy()
    if obstacle is not None:
        _free_where_walked(obstacle, grid_map, used)
    support = _support(grid_map, used, nodes, apart)
    return replace(grid_map, mean=mean, sd=sd, support=support, obstacle=obstacle), changed


def _within(evidence: Evidence, nodes: Float64Array, reach: float) -> Evidence:
    """Rows that can reach any of the nodes."""
    lo, hi = nodes.min(axis=0) - reach, nodes.max(axis=0) + reach
    inside: BoolArray = np.all((evidence.xy >= lo) & (evidence.xy <= hi), axis=1)
    return evidence.subset(inside)


def _support(grid_map: GridMap, used: Evidence, nodes: Float64Array, apart: Float64Array) -> Float32Array:
    """Distance to the nearest row in use, measured again where a change, ``apart`` from the node, can matter to it."""
    support = grid_map.support.copy()
    # a row that came is nearer than what was nearest, one that went was the nearest
    asked = np.flatnonzero(apart <= support.ravel() + grid_map.cell_m)
    if len(used):
        distance, _ = cKDTree(used.xy).query(nodes[asked], distance_upper_bound=SUPPORT_CAP_M)
        support.ravel()[asked] = np.minimum(distance, SUPPORT_CAP_M)
    else:
        support.ravel()[asked] = SUPPORT_CAP_M
    return support


def _free_where_walked(obstacle: Float32Array, grid_map: GridMap, used: Evidence) -> None:
    """What survey walks went through can be walked, whatever the plan calls it."""
    surveyed = np.array([source.kind is SourceKind.SURVEY for source in used.sources], dtype=bool)
    if not len(used) or not surveyed.any():
        return
    xy = used.xy[surveyed[used.source]]
    rows, columns = grid_map.shape
    c = np.clip(np.rint((xy[:, 0] - grid_map.x0) / grid_map.cell_m).astype(int), 0, columns - 1)
    r = np.clip(np.rint((xy[:, 1] - grid_map.y0) / grid_map.cell_m).astype(int), 0, rows - 1)
    deep = obstacle[r, c] > _WALKED_DEPTH_M
    obstacle[r[deep], c[deep]] = 0.0


def _with_lines(routes: RouteLines | None, lines: Sequence[Float64Array]) -> RouteLines | None:
    if routes is None or not lines:
        return routes
    first = len(routes.xy) + np.concatenate([[0], np.cumsum([len(line) for line in lines[:-1]])])
    return RouteLines(
        np.concatenate([routes.xy, *lines]).astype(np.float32), np.concatenate([routes.first, first]).astype(np.int32)
    )
