"""A map as a document: its layers, where they lie, and what a reader of the file should know about them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from app.engine.geodesy import TangentPlane
from app.engine.types import FeatureSet, Float32Array, Float64Array, GridMap

Value = str | float | tuple[float, ...]
"""What an attribute holds."""

MEAN, SD = "mean_", "sd_"
SUPPORT, OBSTACLE = "support", "obstacle"
FIELD_UNIT, LENGTH_UNIT = "uT", "m"

CHANNEL_WORDS: Mapping[str, str] = {
    "x": "component along +x of the level frame",
    "y": "component along +y of the level frame",
    "z": "upward component",
    "h": "horizontal magnitude",
    "v": "upward component",
    "total": "magnitude",
}
"""What each channel is of the magnetic flux density."""


@dataclass(frozen=True, slots=True, eq=False)
class MapDocument:
    """A map version with what a file says about it. Radio layer and survey lines of the map are never written.

    Attributes
    ----------
    grid : GridMap
    title, history, licence, attribution : str
        Free text; empty: not said.
    map_id : str
    version : int
    content_hash : str
        Of the map as the service keeps it.
    length_scale_m : float
        Over how many metres the field changes.
    field_sd : tuple of float, uT
        How much the field varies over the level, per channel.
    software : str
        Name and version of what writes.
    plane : TangentPlane or None
        Takes the level frame to WGS 84; None where the venue has no anchor.
    """

    grid: GridMap
    title: str
    history: str
    licence: str
    attribution: str
    map_id: str
    version: int
    content_hash: str
    length_scale_m: float
    field_sd: tuple[float, ...]
    software: str
    plane: TangentPlane | None = None

    def layers(self) -> Iterator[Layer]:
        """Mean and sd of each channel, support, and the depth in obstacles if the map has it."""
        grid = self.grid
        for i, channel in enumerate(grid.features.channels):
            words = f"magnetic flux density, {CHANNEL_WORDS[channel]}"
            yield Layer(MEAN + channel, FIELD_UNIT, words, grid.mean[i])
        for i, channel in enumerate(grid.features.channels):
            words = f"standard deviation of the mapped magnetic flux density, {CHANNEL_WORDS[channel]}"
            yield Layer(SD + channel, FIELD_UNIT, words, grid.sd[i])
        yield Layer(SUPPORT, LENGTH_UNIT, "distance to the nearest survey sample", grid.support)
        if grid.obstacle is not None:
            yield Layer(OBSTACLE, LENGTH_UNIT, "depth in walls, closed rooms or outside the floor", grid.obstacle)

    def axes(self) -> tuple[Float64Array, Float64Array]:
        """Node coordinates ``x`` (columns,) and ``y`` (rows,), m, level frame."""
        rows, columns = self.grid.shape
        grid = self.grid
        return even_axis(grid.x0, grid.cell_m, columns), even_axis(grid.y0, grid.cell_m, rows)

    def attributes(self) -> dict[str, Value]:
        """What goes into every format: texts and numbers by name, the empty ones left out."""
        grid = self.grid
        values: dict[str, Value] = {
            "title": self.title,
            "history": self.history,
            "licence": self.licence,
            "attribution": self.attribution,
            "source": "magnetic survey map of Isodyn",
            "software": self.software,
            "map_id": self.map_id,
            "map_version": float(self.version),
            "content_hash": self.content_hash,
            "feature_set": grid.features.value,
            "x0": float(grid.x0),
            "y0": float(grid.y0),
            "cell_m": float(grid.cell_m),
            "mapped_m": float(grid.mapped_m),
            "noise_sd": tuple(float(value) for value in grid.noise_sd),
            "field_sd": self.field_sd,
            "length_scale_m": self.length_scale_m,
        }
        if self.plane is not None:
            values |= {
                "anchor_latitude_deg": self.plane.latitude_deg,
                "anchor_longitude_deg": self.plane.longitude_deg,
                "anchor_bearing_deg": self.plane.bearing_deg,
                "anchor_height_m": self.plane.height_m,
            }
        return {name: value for name, value in values.items() if value != ""}


def even_axis(first: float, step: float, n: int) -> Float64Array:
    """``n`` coordinates from ``first`` on, shape (n,); infinite where they are beyond float64."""
    with np.errstate(over="ignore", invalid="ignore"):
        axis: Float64Array = np.asarray(first + step * np.arange(n), dtype=np.float64)
    return axis


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One raster: ``values`` shape (rows, columns), float32, row 0 at the lowest y."""

    name: str
    unit: str
    words: str
    values: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Rasters:
    """Layers on one lattice, as a file holds them: names and units are the file's own.

    Attributes
    ----------
    x, y : arrays, shape (columns,) and (rows,), m
        Ascending.
    layers : mapping of str to array, shape (rows, columns)
        NaN where the file has no value.
    units : mapping of str to str
        Of the layers for which the file names one.
    attributes : mapping
    """

    x: Float64Array
    y: Float64Array
    layers: Mapping[str, Float64Array | Float32Array]
    units: Mapping[str, str]
    attributes: Mapping[str, Value]


FEATURES_OF: Mapping[frozenset[str], FeatureSet] = {frozenset(one.channels): one for one in FeatureSet}
"""The feature set that a set of channels makes."""
