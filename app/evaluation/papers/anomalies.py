"""Maps of the total-field anomaly, kriged from flight lines of which whole ones are left out."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from app.engine.geodesy import TangentPlane
from app.engine.mapping.kriging import krige, krige_grid
from app.engine.mapping.model import Covariance, FieldLevel, FieldSamples
from app.engine.types import FeatureSet, Float64Array, GridMap, IntArray, Progress
from app.evaluation.datasets.aero import AeroSurvey, FlightSegment
from app.evaluation.errors import DataSetError
from app.evaluation.prepare import engine_hash, load_map, save_map

UT_PER_NT = 1e-3
Extent = tuple[float, float, float, float]
_FOLDS = 5
_FIT_POINTS = 1500
_NEIGHBOURS = 64
_OVERVIEW = Covariance(8000.0, 1e-3, 2000.0, 1e-2, 0.3, 1200.0)
"""For the map of a whole survey, on which windows are chosen; each window's own map has its own."""
_COARSE_M = (2000.0, 4000.0, 8000.0, 16000.0)
_FINE = ((0.0, 600.0), (0.3, 600.0), (0.3, 1200.0), (0.6, 1200.0), (0.6, 2400.0))
"""Variance of the field's fine part, and its length, m."""
_WHITE = (1e-4, 1e-3, 1e-2)
_LINE_ERROR, _LINE_ERROR_M = 1e-3, 2000.0
"""Levelling and height of a line: part of the field's variance, and along how much of the line."""
_GAP_M = 1000.0
"""A line with no reading for longer than this ends."""
_MARGIN_M = 5000.0
"""Lines this far outside a window help to fit and to krige it."""


@dataclass(frozen=True, slots=True)
class AnomalySettings:
    """How a survey becomes a map.

    Attributes
    ----------
    cell_m : float, m
        Of the map; readings of a segment are averaged over as much.
    every : int
        One of so many flight lines (ties apart), by their place across the survey, is left out of the map.
    mapped_m : float, m
        A node nearer than this to a reading is mapped.
    side_m : float, m
        Of the square windows.
    inset_m : float, m
        Tracks keep this far from a window's edge.
    covered : float
        Share of a window that must be mapped.
    lines : int
        Left-out lines that a window must hold: tracks along a single one would all be the same.
    """

    cell_m: float = 200.0
    every: int = 5
    mapped_m: float = 2000.0
    side_m: float = 28_000.0
    inset_m: float = 4000.0
    covered: float = 0.95
    lines: int = 2


@dataclass(frozen=True, slots=True)
class PlacedSegment:
    """A segment in the plane: ``xy`` (n, 2) m in order along it, ``values`` (n,) uT."""

    name: str
    line: str
    tie: bool
    xy: Float64Array
    values: Float64Array

    def __len__(self) -> int:
        return int(self.xy.shape[0])

    @property
    def way(self) -> Float64Array:
        """Way from the first reading on, shape (n,), m."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.xy, axis=0).T))])


@dataclass(frozen=True, slots=True)
class LineSurvey:
    """A survey in the plane, with some of its lines left out of all maps.

    Attributes
    ----------
    name : str
    known : tuple of PlacedSegment
        What maps are made of.
    left_out : tuple of PlacedSegment
        Segments of the lines that no map has seen.
    """

    name: str
    known: tuple[PlacedSegment, ...]
    left_out: tuple[PlacedSegment, ...]


@dataclass(frozen=True, slots=True)
class Window:
    """A square of a survey.

    Attributes
    ----------
    survey : LineSurvey
    extent : tuple of four floats, m
        ``x_min, y_min, x_max, y_max``.
    gradient_nt_km : float, nT/km
        Root mean square of the field's horizontal gradient.
    """

    survey: LineSurvey
    extent: Extent
    gradient_nt_km: float


def place_survey(survey: AeroSurvey, settings: AnomalySettings) -> LineSurvey:
    """A survey in the plane.

    Raises
    ------
    DataSetError
        Too few lines to leave any out.
    """
    segments = place_segments(survey.segments)
    chosen = left_out_lines(segments, settings.every)
    if not chosen:
        raise DataSetError(survey.path, f"has too few flight lines to leave out one of {settings.every}")
    known = tuple(segment for segment in segments if segment.line not in chosen)
    return LineSurvey(survey.name, known, tuple(segment for segment in segments if segment.line in chosen))


def place_segments(segments: Sequence[FlightSegment]) -> tuple[PlacedSegment, ...]:
    """Segments in the tangent plane at the survey's middle, sorted along their own direction, nT to uT.

    Digitized lines come in several passes over the same ground: sorted, they are one.
    """
    latitude = np.concatenate([segment.latitude for segment in segments])
    longitude = np.concatenate([segment.longitude for segment in segments])
    plane = TangentPlane(float(latitude.min() + np.ptp(latitude) / 2), float(longitude.min() + np.ptp(longitude) / 2))
    placed = []
    for segment in segments:
        xy = np.stack(plane.from_wgs84(segment.latitude, segment.longitude), axis=1)
        along = (xy - xy.mean(axis=0)) @ direction_of(xy)
        _, order = np.unique(np.round(along, 0), return_index=True)
        order = order[::-1] if along[-1] < along[0] else order
        placed.append(
            PlacedSegment(segment.name, segment.line, segment.tie, xy[order], UT_PER_NT * segment.anomaly_nt[order])
        )
    return tuple(placed)


def left_out_lines(segments: Sequence[PlacedSegment], every: int) -> frozenset[str]:
    """Every so-manieth flight line by its place across the survey, ties apart."""
    lines = [segment for segment in segments if not segment.tie]
    if not lines:
        return frozenset()
    longest = max(lines, key=lambda segment: segment.way[-1])
    along = direction_of(longest.xy)
    across = np.array([-along[1], along[0]])
    places: dict[str, list[float]] = {}
    for segment in lines:
        places.setdefault(segment.line, []).extend((segment.xy @ across).tolist())
    ordered = sorted(places, key=lambda name: (float(np.median(places[name])), name))
    return frozenset(ordered[every // 2 :: every])


def thin(segment: PlacedSegment, spacing_m: float) -> tuple[Float64Array, Float64Array]:
    """Means over equal parts of the way: positions (k, 2) m and values (k,) uT."""
    part = np.floor(segment.way / spacing_m).astype(np.int64)
    _, index, count = np.unique(part, return_inverse=True, return_counts=True)
    sums = [np.bincount(index, weights=column) / count for column in (*segment.xy.T, segment.values)]
    return np.stack(sums[:2], axis=1), sums[2]


def direction_of(xy: Float64Array) -> Float64Array:
    """Unit vector along points that lie about a line."""
    if len(xy) < 2:
        return np.array([1.0, 0.0])
    vector: Float64Array = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)[2][0]
    return vector


def window_map(
    survey: LineSurvey, extent: Extent, settings: AnomalySettings, progress: Progress | None = None
) -> GridMap:
    """Krige a window with a covariance fitted to the lines in and about it.

    ``noise_sd`` is what a reading differs from the field by: levelling, height, and what is finer than the map.
    """
    samples = _samples(survey.known, settings.cell_m)
    low, high = np.array(extent[:2]) - _MARGIN_M, np.array(extent[2:]) + _MARGIN_M
    samples = samples.subset(np.all((samples.xy >= low) & (samples.xy <= high), axis=1))
    fit = fit_lines(samples)
    cell = settings.cell_m
    x, y = (np.arange(np.ceil(extent[k] / cell), np.floor(extent[k + 2] / cell) + 1) * cell for k in range(2))
    noise = float(np.sqrt(fit.covariance.noise) * fit.level.sd[0])
    return _krige_map(survey.name, samples, fit, (x, y), settings, noise_ut=noise, progress=progress)


def overview_map(survey: LineSurvey, settings: AnomalySettings, progress: Progress | None = None) -> GridMap:
    """Krige a whole survey, with one covariance for all of it."""
    samples = _samples(survey.known, settings.cell_m)
    cell = settings.cell_m
    low, high = np.ceil(samples.xy.min(axis=0) / cell), np.floor(samples.xy.max(axis=0) / cell)
    x, y = (np.arange(low[k], high[k] + 1) * cell for k in range(2))
    fit = LineFit(_OVERVIEW, _level(samples, _OVERVIEW))
    return _krige_map(survey.name, samples, fit, (x, y), settings, noise_ut=0.0, progress=progress)


def cached_map(path: Path | None, build: Callable[[], GridMap]) -> GridMap:
    """The map of a file, or a new one that is kept there."""
    if path is not None and path.is_file():
        return load_map(path)
    grid_map = build()
    if path is not None:
        save_map(grid_map, path)
    return grid_map


def map_path(cache: Path | None, survey: AeroSurvey, settings: AnomalySettings, extent: Extent | None) -> Path | None:
    """Where the cache keeps a map: named by all that it depends on."""
    if cache is None:
        return None
    what = json.dumps([asdict(settings), extent], sort_keys=True)
    digest = hashlib.sha256((engine_hash() + what).encode())
    digest.update(survey.path.read_bytes())
    digest.update(Path(__file__).read_bytes())
    return cache / f"{digest.hexdigest()}.npz"


def _krige_map(
    name: str,
    samples: FieldSamples,
    fit: LineFit,
    axes: tuple[Float64Array, Float64Array],
    settings: AnomalySettings,
    *,
    noise_ut: float,
    progress: Progress | None,
) -> GridMap:
    x, y = axes
    mean, sd = krige_grid(samples, fit.level, fit.covariance, x, y, neighbours=_NEIGHBOURS, progress=progress)
    return GridMap(
        level_id=name,
        features=FeatureSet.TOTAL,
        x0=float(x[0]),
        y0=float(y[0]),
        cell_m=settings.cell_m,
        mean=mean.astype(np.float32),
        sd=sd.astype(np.float32),
        support=_support(samples.xy, x, y, 2.0 * settings.mapped_m).astype(np.float32),
        mapped_m=settings.mapped_m,
        noise_sd=(noise_ut,),
    )


def _samples(segments: Sequence[PlacedSegment], spacing_m: float) -> FieldSamples:
    thinned = [thin(segment, spacing_m) for segment in segments]
    names = {line: number for number, line in enumerate(dict.fromkeys(segment.line for segment in segments))}
    owner = [np.full(len(values), names[s.line]) for s, (_, values) in zip(segments, thinned, strict=True)]
    return FieldSamples(
        np.concatenate([xy for xy, _ in thinned]),
        np.concatenate(owner),
        np.concatenate([values for _, values in thinned])[:, None],
    )


@dataclass(frozen=True, slots=True)
class LineFit:
    """Covariance of a survey's readings and the level that they lie about."""

    covariance: Covariance
    level: FieldLevel


def fit_lines(samples: FieldSamples, *, seed: int = 0) -> LineFit:
    """Covariance by the predictive likelihood of left-out lines; the field's variance is what makes it largest.

    Without that, the spread over a survey would stand for the spread of its quiet parts, too.
    """
    rng = np.random.default_rng(seed)
    fold = rng.integers(_FOLDS, size=int(samples.walk.max()) + 1)[samples.walk]
    asked = np.sort(rng.choice(len(samples), min(_FIT_POINTS, len(samples)), replace=False))
    best: tuple[float, LineFit] | None = None
    for coarse, (fine, length), white in itertools.product(_COARSE_M, _FINE, _WHITE):
        if length >= coarse:
            continue
        candidate = Covariance(coarse, _LINE_ERROR, _LINE_ERROR_M, white, fine, length)
        level = _level(samples, candidate)
        residual, sd = _left_out(samples, candidate, fold, asked)
        variance = sd**2 + candidate.noise * level.sd[0] ** 2
        sill = max(float(np.mean(residual**2 / variance)), 1e-6)
        score = -0.5 * float(np.log(sill) + np.log(variance).mean())
        if best is None or score > best[0]:
            best = (score, LineFit(candidate, FieldLevel(level.mean, np.sqrt(sill) * level.sd)))
    assert best is not None  # noqa: S101 - the candidates are constants
    return best[1]


def _left_out(
    samples: FieldSamples, covariance: Covariance, fold: IntArray, asked: IntArray
) -> tuple[Float64Array, Float64Array]:
    """Residuals of the asked samples against maps without the lines of their fold, and those maps' deviation, uT."""
    level = _level(samples, covariance)
    residual, sd = np.zeros(len(asked)), np.ones(len(asked))
    for f in np.unique(fold[asked]):
        rows = np.flatnonzero(fold[asked] == f)
        one = samples.subset(asked[rows])
        known = samples.subset(fold != f)
        if len(known) == 0:
            continue
        mean, deviation = krige(known, level, covariance, one.xy, neighbours=_NEIGHBOURS // 2)
        residual[rows], sd[rows] = (one.values - mean)[:, 0], deviation[:, 0]
    return residual, sd


def _level(samples: FieldSamples, covariance: Covariance) -> FieldLevel:
    variance = samples.values.var(axis=0)
    return FieldLevel(samples.values.mean(axis=0), np.sqrt(variance / (1.0 + covariance.noise)))


def _support(xy: Float64Array, x: Float64Array, y: Float64Array, cap_m: float) -> Float64Array:
    xx, yy = np.meshgrid(x, y)
    distance, _ = cKDTree(xy).query(np.stack([xx.ravel(), yy.ravel()], axis=1), distance_upper_bound=cap_m)
    support: Float64Array = np.minimum(distance, cap_m).reshape(xx.shape)
    return support


def crop(grid_map: GridMap, extent: Extent) -> GridMap:
    """Nodes of a map inside an extent, m."""
    cell = grid_map.cell_m
    c0, r0 = (
        int(np.ceil((extent[0] - grid_map.x0) / cell - 1e-9)),
        int(np.ceil((extent[1] - grid_map.y0) / cell - 1e-9)),
    )
    c1, r1 = (
        int(np.floor((extent[2] - grid_map.x0) / cell + 1e-9)),
        int(np.floor((extent[3] - grid_map.y0) / cell + 1e-9)),
    )
    rows, columns = slice(r0, r1 + 1), slice(c0, c1 + 1)
    return replace(
        grid_map,
        x0=grid_map.x0 + c0 * cell,
        y0=grid_map.y0 + r0 * cell,
        mean=np.ascontiguousarray(grid_map.mean[:, rows, columns]),
        sd=np.ascontiguousarray(grid_map.sd[:, rows, columns]),
        support=np.ascontiguousarray(grid_map.support[rows, columns]),
    )


def windows_of(survey: LineSurvey, overview: GridMap, settings: AnomalySettings, length_m: float) -> list[Window]:
    """Squares that tile a survey from its south-west corner, are mapped, and hold left-out lines of such a length."""
    x_min, y_min, x_max, y_max = overview.extent
    side = settings.side_m
    found = []
    for i, j in itertools.product(range(int((x_max - x_min) // side)), range(int((y_max - y_min) // side))):
        left, bottom = x_min + i * side, y_min + j * side
        extent = (left, bottom, left + side, bottom + side)
        part = crop(overview, extent)
        lines = {one.line for one in stretches(survey.left_out, inset(extent, settings), length_m)}
        if part.mapped.mean() >= settings.covered and len(lines) >= settings.lines:
            slopes = np.gradient(part.mean[0].astype(np.float64), part.cell_m)
            rms = float(np.sqrt(np.mean(slopes[0] ** 2 + slopes[1] ** 2)))
            found.append(Window(survey, extent, rms * 1000.0 / UT_PER_NT))
    return found


def inset(extent: Extent, settings: AnomalySettings) -> Extent:
    """Where tracks may lie: an indicated start beside them is still inside the window."""
    m = settings.inset_m
    return (extent[0] + m, extent[1] + m, extent[2] - m, extent[3] - m)


def stretches(segments: Sequence[PlacedSegment], extent: Extent, length_m: float) -> list[PlacedSegment]:
    """Parts of segments inside an extent, without gaps, of so much length."""
    found = []
    for segment in segments:
        inside = np.all((segment.xy >= extent[:2]) & (segment.xy <= extent[2:]), axis=1)
        steps = np.hypot(*np.diff(segment.xy, axis=0).T)
        breaks = np.flatnonzero(~(inside[1:] & inside[:-1]) | (steps > _GAP_M)) + 1
        found += [
            replace(segment, xy=segment.xy[rows], values=segment.values[rows])
            for rows in np.split(np.arange(len(segment)), breaks)
            if segment.way[rows[-1]] - segment.way[rows[0]] >= length_m
        ]
    return found
