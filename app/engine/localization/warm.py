"""Compile or load every kernel before the first request needs it."""

from __future__ import annotations

import numpy as np

from app.engine.filtering import Cloud
from app.engine.localization.integrity import Integrity
from app.engine.localization.lines import OpenStep
from app.engine.localization.radio import RadioScan, log_likelihood
from app.engine.localization.registry import METHODS, create_tracker
from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige
from app.engine.types import FeatureSet, GridMap, ImuSamples, Prior, RadioMap, Segment


class _OneMap:
    """A map source of one map."""

    def __init__(self, grid_map: GridMap) -> None:
        self._map = grid_map

    def level_ids(self) -> tuple[str, ...]:
        return (self._map.level_id,)

    def grid_map(self, level_id: str) -> GridMap:  # noqa: ARG002 - one map serves all
        return self._map


def warm_up() -> None:
    """Run every method once on a few steps over a flat map, look back once, krige one, and hear one access point.

    Idempotent; seconds without a cache.
    """
    source = _OneMap(_flat_map())
    segment = Segment(_walk(3.0))
    for name in METHODS:
        tracker = create_tracker(name)
        _, fixes = tracker.step(tracker.start(Prior("warm", 5.0, 5.0), seed=0), segment, source)
    few = Cloud.empty(2)  # a short walk does not look back
    OpenStep.of(fixes[0], Integrity(), few).estimate(few.p[14])
    samples = FieldSamples(np.zeros((1, 2)), np.zeros(1, dtype=np.int64), np.zeros((1, 3)))
    krige(samples, FieldLevel(np.zeros(3), np.ones(3)), Covariance(), np.zeros((1, 2)))
    for memory_mapped in (False, True):
        log_likelihood(_flat_radio(memory_mapped), RadioScan(0.0, 0.0, ("warm",), np.array([-60.0])))


def _flat_radio(memory_mapped: bool) -> RadioMap:
    """A map of one access point; a memory-mapped one is read-only, which is another type to a kernel."""
    layers = [np.full((1, 2, 2), 50, np.int8), *np.full((2, 1, 2, 2), 100, np.uint8)]
    for layer in layers:
        layer.setflags(write=not memory_mapped)
    mean, sd, seen = layers
    return RadioMap(0.0, 0.0, 3.0, ("warm",), mean, sd, seen)


def _flat_map() -> GridMap:
    ones = np.ones((20, 20), dtype=np.float32)
    mean = np.stack([0 * ones, 30 * ones, -30 * ones])
    return GridMap("warm", FeatureSet.VECTOR, 0.0, 0.0, 0.5, mean, np.stack([ones] * 3), 0 * ones, 1.0, (3.0,) * 3)


def _walk(duration: float) -> ImuSamples:
    t = np.arange(0.0, duration, 0.02)
    zeros = np.zeros_like(t)
    acc = np.stack([zeros, zeros, 9.81 + 2.5 * np.sin(2.0 * np.pi * 1.8 * t)], axis=1)
    mag = np.tile([0.0, 30.0, -30.0], (t.shape[0], 1))
    return ImuSamples(t, mag, acc, np.zeros((t.shape[0], 3)))
