"""Tracks of a drifting inertial navigation over a regional map of the total field."""

from __future__ import annotations

import numpy as np

from app.engine.matching import MatchProblem, Profile, Region, Track, read_map
from app.engine.types import FeatureSet
from tests.support.fields import Truth, field_map

GRAVITY = 9.81


def drifting_flight(
    seed: int,
    *,
    n: int = 90,
    every_s: float = 20.0,
    speed: float = 12.0,
    gyro_deg_h: float = 0.005,
    accelerometer: float = 5e-4,
    noise_ut: float = 1e-3,
    start_sd_m: float = 4000.0 / 3.0,
    length_m: float = 1200.0,
    spread_ut: float = 0.1,
    side: int = 200,
) -> Truth:
    """Cells of 200 m, 40 km wide, figures of doi:10.7690/bgzdh.2026.05.004: errors grow as b t^2 / 2 and g w t^3 / 6.

    The biases' directions are drawn; their size is what the track's covariance says is their standard deviation.
    """
    rng = np.random.default_rng(seed)
    grid_map = field_map(
        rng,
        features=FeatureSet.TOTAL,
        shape=(side + 1, side + 1),
        cell_m=200.0,
        length_m=length_m,
        spread_ut=spread_ut,
        sd_ut=1e-4,
    )
    t = every_s * np.arange(n)
    heading = rng.uniform(0, 2 * np.pi) + 0.8 * np.sin(2 * np.pi * t / t[-1]) + 0.3 * np.sin(5 * np.pi * t / t[-1])
    xy = np.cumsum(speed * every_s * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    middle = np.array([grid_map.x0, grid_map.y0]) + 100.0 * side
    xy += middle - 0.5 * (xy.max(axis=0) + xy.min(axis=0))
    angle, turn = rng.uniform(0, 2 * np.pi, 2)
    slow = GRAVITY * np.radians(gyro_deg_h) / 3600.0 * t**3 / 6.0
    fast = 0.5 * accelerometer * t**2
    drift = fast[:, None] * (np.cos(angle), np.sin(angle)) + slow[:, None] * (np.cos(turn), np.sin(turn))
    cov = (fast**2 + slow**2)[:, None, None] * np.eye(2) / 2.0
    values = read_map(grid_map, FeatureSet.TOTAL, xy[:, 0], xy[:, 1]).mean + noise_ut * rng.standard_normal((n, 1))
    shift = start_sd_m * rng.standard_normal(2)
    track = Track(t, xy[:, 0] + drift[:, 0] + shift[0], xy[:, 1] + drift[:, 1] + shift[1], heading, cov)
    region = Region(track.x[0], track.y[0], np.eye(2) * start_sd_m**2, heading_sd=1e-5, scale_sd=1e-5)
    profile = Profile(FeatureSet.TOTAL, values, np.array([noise_ut]))
    return Truth(MatchProblem(profile, track, grid_map, region), xy[:, 0], xy[:, 1])
