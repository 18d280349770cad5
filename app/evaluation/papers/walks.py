"""Recorded walks as matchers see them: readings at an even rate, with what dead reckoning and compass indicate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.engine.inertial import find_steps, level_samples, window_means
from app.engine.inertial.legs import heading_offset
from app.engine.inertial.stride import step_durations, stride_length
from app.engine.matching import features_of
from app.engine.types import FeatureSet, Float64Array, GridMap, MapBuildSettings
from app.evaluation.datasets.kaist import DEFAULT_FLOOR, SURVEY, open_kaist
from app.evaluation.datasets.kaist import TEST as KAIST_TEST
from app.evaluation.datasets.uji import LEVEL, TEST, TRAIN, open_uji
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.errors import DataSetError
from app.evaluation.prepare import PrepareTask, prepare_level
from app.evaluation.truth import interpolate

UJI_HZ, KAIST_HZ = 5.0, 20.0
"""At which the field is read: the phone of UJI renews it five times a second."""


@dataclass(frozen=True, slots=True)
class WalkReadings:
    """Readings of one walk between its first and last label.

    Attributes
    ----------
    walk_id : str
    t : array, shape (n,), s
    x, y : array, shape (n,), m, level frame
        True positions.
    course : array, shape (n,), rad
        True direction of motion: that of the leg between labels.
    mag : array, shape (n, 3), uT
        Forward, left, up of the device.
    heading : array, shape (n,), rad, level frame
        Of the device by gyroscope, turned to agree with the legs on average.
    way : array, shape (n,), m
        Walked by step lengths.
    corners : array, shape (k, 2), m
        Labelled positions.
    """

    walk_id: str
    t: Float64Array
    x: Float64Array
    y: Float64Array
    course: Float64Array
    mag: Float64Array
    heading: Float64Array
    way: Float64Array
    corners: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def dead_reckoned(self, heading: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Positions relative to the first, m, from step lengths and headings (rad, shape (n,))."""
        step = np.diff(self.way, prepend=self.way[0])
        x, y = np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading))
        return x - x[0], y - y[0]


@dataclass(frozen=True, slots=True)
class WalkSet:
    """Map and test walks of a data set."""

    name: str
    grid_map: GridMap
    walks: tuple[WalkReadings, ...]
    rate_hz: float


def uji_walks(data: Path, cache: Path | None) -> WalkSet:
    """The laboratory: map of the train walks, readings of the test walks."""
    uji = open_uji(data)
    task = PrepareTask(LEVEL, tuple(w.survey_walk() for w in uji.walks(*TRAIN)), MapBuildSettings(), cache)
    return WalkSet("uji", _map(task, uji.folder), _read(uji.walks(TEST), UJI_HZ), UJI_HZ)


def kaist_walks(data: Path, cache: Path | None) -> WalkSet:
    """The hall: map of the survey lines, readings of the test tracks of all phones."""
    from app.evaluation.kaist import SURVEY_SETTINGS

    floor = open_kaist(data).floor(DEFAULT_FLOOR)
    survey = tuple(walk.survey_walk() for walk in floor.walks(SURVEY))
    task = PrepareTask(floor.name, survey, SURVEY_SETTINGS, cache, vector_plan=floor.plan)
    return WalkSet("kaist", _map(task, floor.folder), _read(floor.walks(KAIST_TEST), KAIST_HZ), KAIST_HZ)


def _map(task: PrepareTask, folder: Path) -> GridMap:
    prepared = prepare_level(task)
    if prepared.grid_map is None:
        raise DataSetError(folder, f"gives no map: {prepared.problem}")
    return prepared.grid_map


def _read(walks: Sequence[RecordedWalk], rate_hz: float) -> tuple[WalkReadings, ...]:
    return tuple(found for walk in walks if (found := read_walk(walk, rate_hz)) is not None)


def read_walk(walk: RecordedWalk, rate_hz: float) -> WalkReadings | None:
    """Readings at an even rate, each the mean over its interval; None for a walk without steps."""
    levelled, _ = level_samples(walk.samples)
    steps = find_steps(levelled.t, levelled.vertical)
    if len(steps) < 2:
        return None
    labels = walk.waypoints
    first, last = max(labels.t[0], levelled.t[0]), min(labels.t[-1], levelled.t[-1])
    t = np.arange(first, last, 1.0 / rate_hz)
    x, y = interpolate(t, np.empty(0) if walk.even_pace else steps.t, labels)
    leg = np.clip(np.searchsorted(labels.t, t, side="right") - 1, 0, len(labels) - 2)
    course = np.arctan2(np.diff(labels.y), np.diff(labels.x))[leg]
    heading = levelled.heading + heading_offset(levelled, steps, labels)
    walked = np.cumsum(stride_length(steps.swing, step_durations(steps.t, -np.inf)))
    return WalkReadings(
        walk_id=walk.walk_id,
        t=t,
        x=x,
        y=y,
        course=course,
        mag=window_means(levelled.t, levelled.mag, t - 0.5 / rate_hz, t + 0.5 / rate_hz),
        heading=np.interp(t, levelled.t, heading),
        way=np.interp(t, np.concatenate([[levelled.t[0]], steps.t]), np.concatenate([[0.0], walked])),
        corners=np.stack([labels.x, labels.y], axis=1),
    )


def total_map(grid_map: GridMap) -> GridMap:
    """The same map of the total field alone."""
    mean, sd = features_of(grid_map, FeatureSet.TOTAL)
    noise = float(np.sqrt(np.mean(np.square(grid_map.noise_sd))))
    return replace(grid_map, features=FeatureSet.TOTAL, mean=mean, sd=sd, noise_sd=(noise,))


def in_features(forward_left_up: Float64Array, heading: Float64Array, features: FeatureSet) -> Float64Array:
    """Readings of the device in a feature set; vectors in the level frame as these headings (rad) have it."""
    if features is FeatureSet.TOTAL:
        total: Float64Array = np.linalg.norm(forward_left_up, axis=1)[:, None]
        return total
    forward, left, up = forward_left_up.T
    if features is FeatureSet.HV:
        return np.stack([np.hypot(forward, left), up], axis=1)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * forward - s * left, s * forward + c * left, up], axis=1)
