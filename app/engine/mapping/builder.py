"""From survey walks to a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from app.engine.errors import MapError
from app.engine.mapping.kriging import krige_grid
from app.engine.mapping.model import FieldLevel, FieldSamples, MapModel
from app.engine.mapping.offsets import WalkOffsets, no_offsets
from app.engine.mapping.placing import SHARE, PlacedWalks, place_walks
from app.engine.mapping.plan import FloorPlan, obstacle_depth
from app.engine.mapping.radio import build_radio_map
from app.engine.mapping.robust import estimate_robustly
from app.engine.mapping.samples import PlacedSamples
from app.engine.mapping.variogram import field_level, fit_claims, fit_covariance, repeatability
from app.engine.types import (
    Evidence,
    EvidenceSource,
    FeatureSet,
    Float32Array,
    Float64Array,
    GridMap,
    MapBuild,
    MapBuildSettings,
    Progress,
    RouteLines,
    SourceKind,
    SurveyWalk,
    WalkReport,
)

MARGIN_M = 4.0
MAX_NODES = 16_000_000
SUPPORT_CAP_M = 50.0
"""Distances to the nearest sample beyond this are not told apart, m."""


def build_map(
    level_id: str,
    walks: Sequence[SurveyWalk],
    settings: MapBuildSettings | None = None,
    progress: Progress | None = None,
    *,
    plan: FloorPlan | None = None,
    placing: PlacedWalks | None = None,
) -> MapBuild:
    """Build a map with mean and standard deviation per node.

    Walks are placed between their waypoints by steps; unless ``settings.align`` is off, they are moved to where they
    agree with one another (labels are good to half a metre or a metre), and hard iron and carrying angle of each are
    estimated jointly with the field; what contradicts the other walks gets little weight. The field is kriged in blocks
    with a covariance fitted to this level.

    Parameters
    ----------
    level_id : str
    walks : sequence of SurveyWalk
        A walk that cannot be placed is left out and its report says why.
    settings : MapBuildSettings
    progress : callable or None
    plan : FloorPlan or None
        Walls and rooms; kept with the map as depth in obstacles.
    placing : PlacedWalks or None
        These walks as :func:`place_walks` placed them before, with the same ``align``.

    Raises
    ------
    MapError
        No walk can be placed, or the grid would have more than 16 million nodes.
    """
    settings = settings or MapBuildSettings()
    say = progress or _silent
    if placing is None:
        placing = place_walks(walks, align=settings.align, progress=lambda f, what: say(SHARE * f, what))
    placed, labelled, reports = placing.adjusted, placing.labelled, placing.rejected
    if not placed:
        reasons = "; ".join(f"{r.walk_id}: {r.rejected}" for r in reports[:3])
        raise MapError(f"no walk could be placed ({reasons or 'none given'})")
    say(SHARE, "offsets of walks")
    offsets, weight = estimate_robustly(placed) if settings.align else (no_offsets(len(placed)), None)
    samples = replace(_field_samples(placed, offsets, settings.features), weight=weight)
    by_labels = replace(samples, xy=np.concatenate([walk.xy for walk in labelled]))
    say(0.35, "fitting covariance")
    own = placed if settings.align and settings.features is FeatureSet.VECTOR else None
    covariance = fit_covariance(samples, own, labelled=by_labels)
    say(0.4, "what left-out walks differ by")
    claims = fit_claims(samples, covariance, own, labelled=by_labels)
    noise_sd = np.maximum(claims.noise_sd, repeatability(samples, covariance, labelled=by_labels))
    level = field_level(samples, covariance)
    level = replace(level, sd=level.sd * claims.scale)
    x, y = _axes(samples.xy, settings, plan)
    mean, sd = krige_grid(samples, level, covariance, x, y, progress=lambda f, what: say(0.45 + 0.5 * f, what))
    grid = GridMap(
        level_id=level_id,
        features=settings.features,
        x0=float(x[0]),
        y0=float(y[0]),
        cell_m=settings.cell_m,
        mean=mean.astype(np.float32),
        sd=sd.astype(np.float32),
        support=_support(samples.xy, x, y),
        mapped_m=settings.mapped_m,
        noise_sd=tuple(float(s) for s in noise_sd),
        obstacle=None if plan is None else obstacle_depth(plan, samples.xy, x, y).astype(np.float32),
        radio=build_radio_map(walks, placed),
        routes=_routes(placed),
    )
    say(1.0, "done")
    return MapBuild(
        grid_map=grid,
        walks=_reports(walks, placed, offsets, samples, level, reports),
        n_samples=len(samples),
        length_scale_m=covariance.length_m,
        field_sd=tuple(float(s) for s in level.sd),
        evidence=_evidence(samples, placed, settings.features),
        model={**MapModel(level, covariance).values(), "align": settings.align},
    )


def _routes(placed: Sequence[PlacedSamples]) -> RouteLines:
    """Where the survey was walked, as the walks were placed."""
    first = np.concatenate([[0], np.cumsum([len(walk) for walk in placed[:-1]])])
    return RouteLines(np.concatenate([walk.xy for walk in placed]).astype(np.float32), first.astype(np.int32))


def _evidence(samples: FieldSamples, placed: Sequence[PlacedSamples], features: FeatureSet) -> Evidence:
    """What the walks bring; who answers for them is not known here."""
    n = len(samples)
    return Evidence(
        features=features,
        sources=tuple(EvidenceSource(w.walk_id, SourceKind.SURVEY, t=float(w.t[0])) for w in placed),
        source=samples.walk.astype(np.int32),
        xy=samples.xy.astype(np.float32),
        values=samples.values.astype(np.float32),
        spread=np.zeros(n, np.float32),
        weight=np.ones(n, np.float32) if samples.weight is None else samples.weight.astype(np.float32),
    )


def _silent(_fraction: float, _what: str) -> None:
    return


def _field_samples(placed: Sequence[PlacedSamples], offsets: WalkOffsets, features: FeatureSet) -> FieldSamples:
    fields = [offsets.field(i, walk) for i, walk in enumerate(placed)]
    owner = np.concatenate([np.full(len(walk), i) for i, walk in enumerate(placed)])
    xy = np.concatenate([walk.xy for walk in placed])
    return FieldSamples(xy, owner, to_features(np.concatenate(fields), features))


def to_features(field: Float64Array, features: FeatureSet) -> Float64Array:
    """Vector field (n, 3) as the channels of a feature set, shape (n, channels)."""
    if features is FeatureSet.VECTOR:
        return field
    if features is FeatureSet.HV:
        return np.stack([np.hypot(field[:, 0], field[:, 1]), field[:, 2]], axis=1)
    total: Float64Array = np.linalg.norm(field, axis=1)[:, None]
    return total


def _axes(xy: Float64Array, settings: MapBuildSettings, plan: FloorPlan | None) -> tuple[Float64Array, Float64Array]:
    """Node coordinates: multiples of the cell, so that versions of a level share their lattice."""
    if settings.extent is not None:
        lo, hi = np.array(settings.extent[:2]), np.array(settings.extent[2:])
    else:
        lo, hi = xy.min(axis=0) - MARGIN_M, xy.max(axis=0) + MARGIN_M
        if plan is not None and plan.extent is not None:
            lo, hi = np.minimum(lo, plan.extent[:2]), np.maximum(hi, plan.extent[2:])
    first = np.floor(lo / settings.cell_m).astype(np.int64)
    last = np.ceil(hi / settings.cell_m).astype(np.int64)
    if np.prod((last - first + 1).astype(float)) > MAX_NODES:
        raise MapError(f"the grid would have more than {MAX_NODES} nodes; use a larger cell_m or a smaller extent")
    return (
        np.arange(first[0], last[0] + 1) * settings.cell_m,
        np.arange(first[1], last[1] + 1) * settings.cell_m,
    )


def _support(xy: Float64Array, x: Float64Array, y: Float64Array) -> Float32Array:
    """Distance from each node to the nearest sample, m, capped."""
    xx, yy = np.meshgrid(x, y)
    nodes = np.stack([xx.ravel(), yy.ravel()], axis=1)
    distance, _ = cKDTree(xy).query(nodes, distance_upper_bound=SUPPORT_CAP_M)
    return np.minimum(distance, SUPPORT_CAP_M).reshape(xx.shape).astype(np.float32)


def _reports(
    walks: Sequence[SurveyWalk],
    placed: Sequence[PlacedSamples],
    offsets: WalkOffsets,
    samples: FieldSamples,
    level: FieldLevel,
    rejected: Sequence[WalkReport],
) -> tuple[WalkReport, ...]:
    """One report per walk, in the order given."""
    by_id = {report.walk_id: report for report in rejected}
    for i, walk in enumerate(placed):
        own = samples.values[samples.walk == i] - level.mean
        by_id[walk.walk_id] = WalkReport(
            walk_id=walk.walk_id,
            n_steps=len(walk) // 2,
            length_m=float(np.hypot(*np.diff(walk.xy, axis=0).T).sum()),
            offset=tuple(float(v) for v in offsets.hard_iron[i]),
            residual_rms=float(np.sqrt((own**2).mean())),
            stride_scale=walk.stride_scale,
        )
    return tuple(by_id[walk.walk_id] for walk in walks)
