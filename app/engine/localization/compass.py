"""Which way a session begins, where the prior does not say: the device's field against the level's."""

from __future__ import annotations

import numpy as np

from app.engine.inertial import PedestrianState, StepEvents
from app.engine.types import FeatureSet, Float64Array, GridMap, Prior

COMPASS_SD = 0.38
"""rad: of a heading read off the horizontal field of one place indoors, and of how the device is held."""


def start_heading(
    prior: Prior, pedestrian: PedestrianState, events: StepEvents, grid_map: GridMap
) -> tuple[float, float, float]:
    """Heading of the first step in the level frame.

    Returns
    -------
    heading, sd, free : float, rad
        Direction of the device's y axis, how well it is known, and the free-azimuth heading it belongs to. Maps without
        a horizontal direction tell nothing: any heading, then.
    """
    walked = len(events) > 0
    free = float(events.heading[0] if walked else pedestrian.tail.heading[-1])
    if prior.heading is not None:
        return prior.heading, prior.heading_sd, free
    if grid_map.features is not FeatureSet.VECTOR:
        return 0.0, np.pi / np.sqrt(3.0), free
    mag = events.mag[0] if walked else pedestrian.tail.mag[-10:].mean(axis=0)
    mean = mean_field(grid_map)
    return float(np.arctan2(mean[1], mean[0]) - np.arctan2(mag[1], mag[0])), COMPASS_SD, free


def mean_field(grid_map: GridMap) -> Float64Array:
    """Mean of the map over mapped ground, shape (channels,), uT."""
    mapped = grid_map.mapped
    nodes = grid_map.mean[:, mapped] if mapped.any() else grid_map.mean.reshape(len(grid_map.mean), -1)
    mean: Float64Array = nodes.mean(axis=1, dtype=np.float64)
    return mean
