"""Fixes and maps as numpy arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from isodyn_client.models import Ellipse, FixKind, Hypothesis, Model, Status

Float64Array = NDArray[np.float64]

CHI2_95 = 5.991464547107979
"""95 % quantile of chi-square with two degrees of freedom: scales a covariance to its 95 % ellipse."""


def _nan(value: object) -> object:
    return math.nan if value is None else value


class FixColumns(Model):
    """Fixes as the service sends them: one list per column."""

    t_ms: tuple[float, ...]
    kind: tuple[FixKind, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    cov_xx: tuple[float, ...]
    cov_xy: tuple[float, ...]
    cov_yy: tuple[float, ...]
    heading_deg: tuple[float, ...]
    status: tuple[Status, ...]
    quality: tuple[float, ...]
    sure: tuple[bool, ...]
    walk_on_m: tuple[Annotated[float, BeforeValidator(_nan)], ...]
    level_id: tuple[str, ...]
    hypotheses: tuple[tuple[Hypothesis, ...], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """Positions in time order, one array per column, shape (n,).

    Attributes
    ----------
    t_ms : array, Unix ms
    kind : tuple of FixKind
        Which samples each rests on.
    x, y : array, m, level frame
    cov_xx, cov_xy, cov_yy : array, m^2
        Covariance; its 95 % ellipse is the service's promise.
    heading_deg : array, degrees counter-clockwise from +x
        Direction of motion.
    status : tuple of Status
    quality : array, 0..1
    sure : array of bool
        Fixes that may be acted on.
    walk_on_m : array, m
        About how many more metres are needed (``insufficient``); NaN otherwise.
    level_id : tuple of str
    hypotheses : tuple of tuples of Hypothesis
        While several places fit: the heaviest of them, with the last fix of a segment; else empty.
    """

    t_ms: Float64Array
    kind: tuple[FixKind, ...]
    x: Float64Array
    y: Float64Array
    cov_xx: Float64Array
    cov_xy: Float64Array
    cov_yy: Float64Array
    heading_deg: Float64Array
    status: tuple[Status, ...]
    quality: Float64Array
    sure: NDArray[np.bool_]
    walk_on_m: Float64Array
    level_id: tuple[str, ...]
    hypotheses: tuple[tuple[Hypothesis, ...], ...]

    def __len__(self) -> int:
        return len(self.t_ms)

    @classmethod
    def from_columns(cls, columns: FixColumns) -> Self:
        """Arrays from an answer."""
        return cls(
            **{name: np.array(getattr(columns, name), dtype=np.float64) for name in _FLOATS},
            kind=columns.kind,
            status=columns.status,
            sure=np.array(columns.sure, dtype=np.bool_),
            level_id=columns.level_id,
            hypotheses=columns.hypotheses or ((),) * len(columns.t_ms),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Fixes]) -> Fixes:
        """Several stretches as one, in the order given."""
        return cls(
            **{name: np.concatenate([np.zeros(0), *(getattr(part, name) for part in parts)]) for name in _FLOATS},
            kind=tuple(kind for part in parts for kind in part.kind),
            status=tuple(status for part in parts for status in part.status),
            sure=np.concatenate([np.zeros(0, dtype=np.bool_), *(part.sure for part in parts)]),
            level_id=tuple(level for part in parts for level in part.level_id),
            hypotheses=tuple(places for part in parts for places in part.hypotheses),
        )

    @property
    def xy(self) -> Float64Array:
        """Positions, shape (n, 2), m."""
        return np.column_stack([self.x, self.y])

    @property
    def covariance(self) -> Float64Array:
        """Covariance matrices, shape (n, 2, 2), m^2."""
        rows = [[self.cov_xx, self.cov_xy], [self.cov_xy, self.cov_yy]]
        return np.moveaxis(np.array(rows, dtype=np.float64), -1, 0)

    def ellipse95(self, i: int) -> Ellipse:
        """The 95 % ellipse of fix ``i``."""
        variance, axes = np.linalg.eigh(self.covariance[i])
        minor, major = np.sqrt(np.maximum(variance, 0.0) * CHI2_95)
        angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        return Ellipse(semi_major_m=float(major), semi_minor_m=float(minor), angle_deg=angle % 180.0)

    def inside95(self, x: Float64Array, y: Float64Array) -> NDArray[np.bool_]:
        """Whether points ``(x[i], y[i])`` lie inside the 95 % ellipse of fix ``i``."""
        offset = np.stack([np.asarray(x) - self.x, np.asarray(y) - self.y], axis=-1)
        distance2 = np.einsum("ni,ni->n", offset, np.linalg.solve(self.covariance, offset[..., None])[..., 0])
        inside: NDArray[np.bool_] = distance2 <= CHI2_95
        return inside


_FLOATS = ("t_ms", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading_deg", "quality", "walk_on_m")


@dataclass(frozen=True, slots=True, eq=False)
class FieldRaster:
    """One channel of a map.

    Attributes
    ----------
    values : array, shape (rows, columns), float32
        Node ``[r, c]`` lies at ``(x0 + c * cell_m, y0 + r * cell_m)``; NaN where there is no map.
    x0, y0 : float, m
    cell_m : float, m
    """

    values: NDArray[np.float32]
    x0: float
    y0: float
    cell_m: float

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """``(x_min, y_min, x_max, y_max)`` of the nodes, m."""
        rows, columns = self.values.shape
        return self.x0, self.y0, self.x0 + (columns - 1) * self.cell_m, self.y0 + (rows - 1) * self.cell_m

    def at(self, x: float, y: float) -> float:
        """Value of the node nearest to a point; NaN outside."""
        row, column = round((y - self.y0) / self.cell_m), round((x - self.x0) / self.cell_m)
        rows, columns = self.values.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return math.nan
        return float(self.values[row, column])


class CoverageRuns(Model):
    """Coverage as the service sends it: lengths of alternating runs, row by row, unmapped first."""

    rows: int
    columns: int
    x0: float
    y0: float
    cell_m: float
    mapped_m: float
    mapped_share: float
    mapped_area_m2: float
    runs: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Where a map holds: ``mapped`` is a mask of shape (rows, columns), placed like :class:`FieldRaster`."""

    mapped: NDArray[np.bool_]
    x0: float
    y0: float
    cell_m: float
    mapped_share: float
    mapped_area_m2: float

    @classmethod
    def from_runs(cls, answer: CoverageRuns) -> Self:
        """The mask of an answer; raises ValueError if the runs do not fill it."""
        values = np.arange(len(answer.runs)) % 2 == 1
        mapped = np.repeat(values, answer.runs).reshape(answer.rows, answer.columns)
        return cls(mapped, answer.x0, answer.y0, answer.cell_m, answer.mapped_share, answer.mapped_area_m2)
