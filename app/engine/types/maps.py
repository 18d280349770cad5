"""Maps of the field and of radio, and how they are built."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from app.engine.types.arrays import BoolArray, Float32Array, Int8Array, Int32Array, UInt8Array
from app.engine.types.evidence import Evidence
from app.engine.types.features import FeatureSet


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class RadioMap:
    """Signal strengths of access points and beacons over a level, on a grid coarser than the field's.

    Node ``[r, c]`` lies at ``(x0 + c * cell_m, y0 + r * cell_m)`` in the level frame.

    Attributes
    ----------
    x0, y0 : float, m
    cell_m : float, m
    addresses : tuple of str, length a
        Transmitters, sorted.
    mean : array, shape (a, rows, columns), int8, dBm
        Expected strength of a reading.
    sd : array, shape (a, rows, columns), uint8, 0.1 dB
        Standard deviation of a reading about ``mean``: noise, and what the survey does not tell about the place.
    seen : array, shape (a, rows, columns), uint8, 1/255
        Probability that a scan there reports the transmitter.
    """

    x0: float
    y0: float
    cell_m: float
    addresses: tuple[str, ...]
    mean: Int8Array
    sd: UInt8Array
    seen: UInt8Array


@dataclass(frozen=True, slots=True, eq=False)
class RouteLines:
    """Lines of a level that were walked to survey it: where a sequence of readings can be compared with the map.

    Attributes
    ----------
    xy : array, shape (m, 2), float32, m, level frame
        Points of all lines, one line after the other.
    first : array, shape (r,), int32
        Index of each line's first point.
    """

    xy: Float32Array
    first: Int32Array

    def lines(self) -> tuple[Float32Array, ...]:
        """Points of each line, shape (k, 2)."""
        return tuple(np.split(self.xy, self.first[1:]))


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class GridMap:
    """Magnetic map of a level on a regular grid.

    Node ``[r, c]`` lies at ``(x0 + c * cell_m, y0 + r * cell_m)`` in the level frame.

    Attributes
    ----------
    level_id : str
    features : FeatureSet
    x0, y0 : float, m
        Position of node ``[0, 0]``.
    cell_m : float, m
    mean, sd : array, shape (channels, rows, columns), float32, uT
        Field and the standard deviation of the *map* (sensor noise is not in it). Far from all
        samples these are the level's mean and spread: an unmapped node is finite but uninformative.
    support : array, shape (rows, columns), float32, m
        Distance to the nearest survey sample, capped at ``support_cap_m``.
    mapped_m : float
        A node with ``support <= mapped_m`` counts as mapped.
    noise_sd : tuple of float, uT
        Repeatability per channel: what two walks over the same spot differ by after their offsets
        are removed.
    obstacle : array, shape (rows, columns), float32, m, or None
        How deep a node lies in walls and closed rooms of the floor plan or outside the floor; 0 where people can
        walk. None without a plan.
    radio : RadioMap or None
        Signal strengths, where the survey brought radio scans.
    routes : RouteLines or None
        The survey's lines; None for maps built before they were kept.
    """

    level_id: str
    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    mean: Float32Array
    sd: Float32Array
    support: Float32Array
    mapped_m: float
    noise_sd: tuple[float, ...]
    obstacle: Float32Array | None = None
    radio: RadioMap | None = None
    routes: RouteLines | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return int(self.mean.shape[1]), int(self.mean.shape[2])

    @property
    def mapped(self) -> BoolArray:
        """Boolean mask of mapped nodes, shape (rows, columns)."""
        mask: BoolArray = self.support <= self.mapped_m
        return mask

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """``(x_min, y_min, x_max, y_max)`` of the nodes, metres."""
        rows, columns = self.shape
        return (
            self.x0,
            self.y0,
            self.x0 + (columns - 1) * self.cell_m,
            self.y0 + (rows - 1) * self.cell_m,
        )


class MapSource(Protocol):
    """Gives a tracker the maps it may use."""

    def level_ids(self) -> tuple[str, ...]:
        """Levels the session may be on."""
        ...

    def grid_map(self, level_id: str) -> GridMap:
        """Map of one level."""
        ...


@dataclass(frozen=True, slots=True)
class MapBuildSettings:
    """What a surveyor may choose about a map; everything else is fitted."""

    features: FeatureSet = FeatureSet.VECTOR
    cell_m: float = 0.5
    mapped_m: float = 1.5
    extent: tuple[float, float, float, float] | None = None
    """``(x_min, y_min, x_max, y_max)``; None: the samples' bounding box and a margin."""
    align: bool = True
    """Estimate each walk's hard iron, carrying angle and label errors against the other walks. Not for a survey by
    calibrated devices along lines that hardly cross: there what differs between walks is the field."""


@dataclass(frozen=True, slots=True)
class WalkReport:
    """What map building found out about one survey walk."""

    walk_id: str
    n_steps: int
    length_m: float
    offset: tuple[float, ...]
    """Estimated body-frame field offset of the walk, uT (x, y, z)."""
    residual_rms: float
    rejected: str | None = None
    """Why the walk was left out, if it was."""
    stride_scale: float | None = None
    """The walker's stride over the stride model's; None where the walk does not tell."""


@dataclass(frozen=True, slots=True)
class MapBuild:
    """A built map and the report about it.

    ``evidence`` is what the map rests on, and ``model`` what was fitted to it (plain values of a
    :class:`app.engine.mapping.MapModel`): with both, later evidence can be added without a new build.
    """

    grid_map: GridMap
    walks: tuple[WalkReport, ...]
    n_samples: int
    length_scale_m: float
    field_sd: tuple[float, ...]
    evidence: Evidence
    model: dict[str, Any]
