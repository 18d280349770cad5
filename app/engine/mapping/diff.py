"""What differs between two versions of a level's map, node by node.

Versions of a level share their lattice (nodes are multiples of the cell), so nothing is interpolated: a node is
compared with the same node of the other version. They may differ in extent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.engine.errors import InputError
from app.engine.mapping.components import as_features, magnitude, poorer_features
from app.engine.types import BoolArray, FeatureSet, Float32Array, Float64Array, GridMap

LEAST_UT = 1.0
"""A change below this is none: two walks over one spot differ by two or three times as much (``noise_sd``)."""
SIGNIFICANT = 2.0
"""Combined standard deviations from which a change counts as significant."""
_OFF_LATTICE = 1e-3
_Window = tuple[slice, slice]
_Box = tuple[float, float, float, float]


class Component(StrEnum):
    """What of the change is looked at: ``all`` is the length of its vector of channels, the others have a sign."""

    ALL = "all"
    X = "x"
    Y = "y"
    Z = "z"
    H = "h"
    V = "v"
    TOTAL = "total"


COMPONENTS: dict[FeatureSet, tuple[Component, ...]] = {
    FeatureSet.VECTOR: tuple(Component),
    FeatureSet.HV: (Component.ALL, Component.H, Component.V, Component.TOTAL),
    FeatureSet.TOTAL: (Component.ALL, Component.TOTAL),
}
"""Components that maps compared in these features tell."""
_PARTS: dict[FeatureSet, dict[str, tuple[int, ...]]] = {
    FeatureSet.VECTOR: {"x": (0,), "y": (1,), "z": (2,), "h": (0, 1), "v": (2,), "total": (0, 1, 2)},
    FeatureSet.HV: {"h": (0,), "v": (1,), "total": (0, 1)},
    FeatureSet.TOTAL: {"total": (0,)},
}


@dataclass(frozen=True, slots=True)
class ChangeStatistics:
    """Change of one component where both versions are mapped, uT: mean, rms, 95 % quantile of its size, largest."""

    component: Component
    mean: float
    rms: float
    p95: float
    largest: float


@dataclass(frozen=True, slots=True)
class DiffSummary:
    """A difference in numbers; counts are nodes, ``box`` encloses all that differs (m, level frame; None: nothing)."""

    features: FeatureSet
    cell_m: float
    least_ut: float
    compared: int
    changed: int
    significant: int
    newly_mapped: int
    no_longer_mapped: int
    box: _Box | None
    change: tuple[ChangeStatistics, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MapDifference:
    """A version beside another one, on the nodes of both extents together.

    Node ``[r, c]`` lies at ``(x0 + c * cell_m, y0 + r * cell_m)``.

    Attributes
    ----------
    features : FeatureSet
        The poorer of the two sets: what can be compared.
    x0, y0, cell_m : float, m
    now, then : arrays, each mean and sd of shape (channels, rows, columns), float32, uT
        NaN where a version has no node.
    mapped_now, mapped_then : array, shape (rows, columns), bool
    """

    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    now: tuple[Float32Array, Float32Array]
    then: tuple[Float32Array, Float32Array]
    mapped_now: BoolArray
    mapped_then: BoolArray

    @property
    def both(self) -> BoolArray:
        """Nodes that both versions map: only there is a change."""
        return self.mapped_now & self.mapped_then

    def change(self, component: Component) -> Float32Array:
        """New minus old, uT, shape (rows, columns); NaN where either version is not mapped.

        Raises
        ------
        InputError
            The features that both versions have do not tell this component.
        """
        if component is Component.ALL:
            return self._masked(np.sqrt(((self.now[0] - self.then[0]) ** 2).sum(axis=0)))
        (now, _), (then, _) = self._component(component)
        return self._masked(now - then)

    def significance(self, component: Component) -> Float32Array:
        """Change over the combined standard deviation of both versions; of ``all``, the rms over the channels.

        Versions mostly rest on the same walks, so that their errors go together: the combined deviation is then too
        large and the significance too small, never the other way round.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            if component is Component.ALL:
                z = (self.now[0] - self.then[0]) / np.hypot(self.now[1], self.then[1])
                return self._masked(np.sqrt((np.nan_to_num(z) ** 2).mean(axis=0)))
            (now, now_sd), (then, then_sd) = self._component(component)
            return self._masked(np.nan_to_num((now - then) / np.hypot(now_sd, then_sd)))

    def summary(self, least_ut: float = LEAST_UT) -> DiffSummary:
        """The difference in numbers; a node is changed if its field moved by more than ``least_ut``."""
        both, size = self.both, self.change(Component.ALL)
        changed = both & (np.nan_to_num(size) > least_ut)
        significant = changed & (np.nan_to_num(self.significance(Component.ALL)) > SIGNIFICANT)
        newly, gone = self.mapped_now & ~self.mapped_then, self.mapped_then & ~self.mapped_now
        return DiffSummary(
            features=self.features,
            cell_m=self.cell_m,
            least_ut=least_ut,
            compared=int(both.sum()),
            changed=int(changed.sum()),
            significant=int(significant.sum()),
            newly_mapped=int(newly.sum()),
            no_longer_mapped=int(gone.sum()),
            box=self._box(changed | newly | gone),
            change=self._statistics(both) if both.any() else (),
        )

    def _statistics(self, both: BoolArray) -> tuple[ChangeStatistics, ...]:
        return tuple(_statistics(one, self.change(one)[both].astype(np.float64)) for one in COMPONENTS[self.features])

    def _component(
        self, component: Component
    ) -> tuple[tuple[Float32Array, Float32Array], tuple[Float32Array, Float32Array]]:
        parts = _PARTS[self.features].get(component)
        if parts is None:
            shown = ", ".join(COMPONENTS[self.features])
            raise InputError("component", f"{component!s} does not follow from {self.features!s}, only {shown}")
        rows = list(parts)
        now, then = (magnitude(mean[rows], sd[rows]) for mean, sd in (self.now, self.then))
        return now, then

    def _masked(self, values: Float32Array) -> Float32Array:
        return np.where(self.both, values, np.float32(np.nan)).astype(np.float32)

    def _box(self, mask: BoolArray) -> _Box | None:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if not rows.size:
            return None
        x, y = self.x0 + self.cell_m * columns[[0, -1]], self.y0 + self.cell_m * rows[[0, -1]]
        return float(x[0]), float(y[0]), float(x[1]), float(y[1])


def diff_maps(new: GridMap, old: GridMap) -> MapDifference:
    """Put two maps of a level side by side, in the features that both tell.

    Raises
    ------
    InputError
        Maps of different levels, or whose nodes do not coincide (``cell_m`` differs, or the lattice is shifted).
    """
    if new.level_id != old.level_id:
        raise InputError("level_id", f"of the maps differs: {new.level_id} and {old.level_id}")
    cell = new.cell_m
    if not np.isclose(cell, old.cell_m, rtol=1e-9):
        raise InputError("cell_m", f"of the maps differs: {cell:g} and {old.cell_m:g} m")
    corners = np.array([[new.x0, new.y0], [old.x0, old.y0]]) / cell
    first = np.round(corners - corners.min(axis=0))
    if np.abs(corners - corners.min(axis=0) - first).max() > _OFF_LATTICE:
        raise InputError("x0", "the nodes of the maps do not coincide: one lattice is shifted")
    origin = corners.min(axis=0) * cell
    shape = tuple((first[:, ::-1].astype(int) + np.array([new.shape, old.shape])).max(axis=0).tolist())
    features = poorer_features(new.features, old.features)
    windows = [_window(at, one) for at, one in zip(first.astype(int), (new, old), strict=True)]
    now, then = (_laid_out(one, features, shape, window) for one, window in zip((new, old), windows, strict=True))
    mapped_now, mapped_then = (_mapped(one, shape, window) for one, window in zip((new, old), windows, strict=True))
    return MapDifference(features, float(origin[0]), float(origin[1]), cell, now, then, mapped_now, mapped_then)


def _window(first: np.ndarray[tuple[int], np.dtype[np.int_]], grid: GridMap) -> _Window:
    rows, columns = grid.shape
    column, row = first.tolist()
    return slice(row, row + rows), slice(column, column + columns)


def _laid_out(
    grid: GridMap, features: FeatureSet, shape: tuple[int, ...], window: _Window
) -> tuple[Float32Array, Float32Array]:
    """Mean and sd of a map on the nodes of both."""
    layers = as_features(grid.mean, grid.sd, grid.features, features)
    if grid.shape == shape:
        return layers
    mean, sd = (np.full((len(features.channels), *shape), np.nan, np.float32) for _ in layers)
    mean[:, *window], sd[:, *window] = layers
    return mean, sd


def _mapped(grid: GridMap, shape: tuple[int, ...], window: _Window) -> BoolArray:
    mask = np.zeros(shape, bool)
    mask[window] = grid.mapped
    return mask


def _statistics(component: Component, change: Float64Array) -> ChangeStatistics:
    size = np.abs(change)
    return ChangeStatistics(
        component=component,
        mean=float(change.mean()),
        rms=float(np.sqrt((change**2).mean())),
        p95=float(np.percentile(size, 95)),
        largest=float(size.max()),
    )
