"""What a device measured along its track beside what the map says there, for people to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.inertial.attitude import Attitude, level_samples
from app.engine.inertial.conditioning import MAX_GAP_S, window_means
from app.engine.mapping.components import as_features
from app.engine.types import (
    BoolArray,
    DeviceCalibration,
    FeatureSet,
    Fix,
    Float32Array,
    Float64Array,
    GridMap,
    ImuSamples,
)

CHANNELS = ("total", "h", "v")
"""Intensity; its horizontal magnitude and vertical component (up): none of them needs a heading."""
_BIN_S = 0.2
_WINDOW_S = 0.35
"""Half of the time that a reading at a fix is a mean over: a step."""


@dataclass(frozen=True, slots=True)
class FieldReadings:
    """Means of the levelled field over a fifth of a second each: all that a profile needs of the samples.

    Attributes
    ----------
    t : array, shape (n,), s
    field : array, shape (n, 3), uT
        Forward, left, up of the levelled device.
    """

    t: Float64Array
    field: Float64Array


@dataclass(frozen=True, slots=True)
class FieldProfile:
    """Measured and mapped field at fixes; NaN where nothing was measured, or nothing is mapped.

    Attributes
    ----------
    measured, mapped, sd : array, shape (3, n), uT
        Rows are ``CHANNELS``; ``sd`` is what the two may differ by: of the map, and of a reading.
    """

    measured: Float64Array
    mapped: Float64Array
    sd: Float64Array


def read_field(samples: ImuSamples, attitude: Attitude | None) -> tuple[FieldReadings, Attitude]:
    """Level the samples after those that ``attitude`` is of, and take means.

    After a gap of more than a second the attitude is found anew.
    """
    if attitude is not None and samples.t[0] - attitude.t > MAX_GAP_S:
        attitude = None
    levelled, end = level_samples(samples, attitude)
    begin = np.arange(levelled.t[0], levelled.t[-1] + 1e-6, _BIN_S)
    return FieldReadings(begin + _BIN_S / 2.0, window_means(levelled.t, levelled.mag, begin, begin + _BIN_S)), end


def corrected(field: Float64Array, calibration: DeviceCalibration) -> Float64Array:
    """The field without what the device's own iron adds, shape (n, 3), forward, left, up, uT."""
    ff, ll, uu, fl, fu, lu = calibration.soft_iron
    iron = np.eye(3) + np.array([[ff, fl, fu], [fl, ll, lu], [fu, lu, uu]])
    true: Float64Array = np.linalg.solve(iron, (field - np.array(calibration.offset)).T).T
    return true


def field_profile(
    readings: FieldReadings,
    fixes: Sequence[Fix],
    maps: Mapping[str, GridMap],
    calibration: DeviceCalibration | None = None,
) -> FieldProfile:
    """Compare readings with the map of each fix's level, at the fix.

    Parameters
    ----------
    readings : FieldReadings, in time order
    fixes : sequence of Fix
    maps : mapping of level id to GridMap
    calibration : DeviceCalibration or None
        Taken off the readings.
    """
    shape = (len(CHANNELS), len(fixes))
    mapped, sd = np.full(shape, np.nan), np.full(shape, np.nan)
    for level_id, grid_map in maps.items():
        here = np.array([fix.level_id == level_id for fix in fixes], dtype=np.bool_)
        if here.any():
            xy = np.array([(fix.x, fix.y) for fix in fixes])[here]
            mapped[:, here], sd[:, here] = _on_map(grid_map, xy)
    return FieldProfile(_at_fixes(readings, fixes, calibration), mapped, sd)


def _at_fixes(readings: FieldReadings, fixes: Sequence[Fix], calibration: DeviceCalibration | None) -> Float64Array:
    measured = np.full((len(CHANNELS), len(fixes)), np.nan)
    if not len(readings.t) or not fixes:
        return measured
    t = np.array([fix.t for fix in fixes])
    field = window_means(readings.t, readings.field, t - _WINDOW_S, t + _WINDOW_S)
    if calibration is not None:
        field = corrected(field, calibration)
    near = np.clip(np.searchsorted(readings.t, t), 1, max(len(readings.t) - 1, 1))
    gap = np.minimum(abs(t - readings.t[near - 1]), abs(t - readings.t[np.minimum(near, len(readings.t) - 1)]))
    horizontal = np.hypot(field[:, 0], field[:, 1])
    measured[:] = np.hypot(horizontal, field[:, 2]), horizontal, field[:, 2]
    measured[:, gap > MAX_GAP_S] = np.nan
    return measured


def _on_map(grid_map: GridMap, xy: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Field and its standard deviation (a reading's included) at places, shape (3, n) each, uT."""
    mean, inside = _between_nodes(grid_map, grid_map.mean, xy)
    spread, _ = _between_nodes(grid_map, grid_map.sd, xy)
    spread = np.hypot(spread, np.array(grid_map.noise_sd)[:, None]).astype(np.float32)
    out, out_sd = (np.full((len(CHANNELS), len(xy)), np.nan) for _ in range(2))
    for wanted, rows in ((FeatureSet.TOTAL, [0]), (FeatureSet.HV, [1, 2])):
        if wanted is FeatureSet.TOTAL or grid_map.features is not FeatureSet.TOTAL:
            out[rows], out_sd[rows] = as_features(mean, spread, grid_map.features, wanted)
    out[:, ~inside] = out_sd[:, ~inside] = np.nan
    return out, out_sd


def _between_nodes(grid_map: GridMap, layers: Float32Array, xy: Float64Array) -> tuple[Float32Array, BoolArray]:
    """Bilinear values, shape (channels, n), and whether the nearest node is mapped."""
    rows, columns = grid_map.shape
    column = (xy[:, 0] - grid_map.x0) / grid_map.cell_m
    row = (xy[:, 1] - grid_map.y0) / grid_map.cell_m
    c0 = np.clip(np.floor(column).astype(np.int64), 0, max(columns - 2, 0))
    r0 = np.clip(np.floor(row).astype(np.int64), 0, max(rows - 2, 0))
    c1, r1 = np.minimum(c0 + 1, columns - 1), np.minimum(r0 + 1, rows - 1)
    u, v = np.clip(column - c0, 0.0, 1.0), np.clip(row - r0, 0.0, 1.0)
    low = (1 - u) * layers[:, r0, c0] + u * layers[:, r0, c1]
    high = (1 - u) * layers[:, r1, c0] + u * layers[:, r1, c1]
    r, c = np.rint(row).astype(np.int64), np.rint(column).astype(np.int64)
    inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
    mapped: BoolArray = inside.copy()
    mapped[inside] = grid_map.support[r[inside], c[inside]] <= grid_map.mapped_m
    return ((1 - v) * low + v * high).astype(np.float32), mapped
