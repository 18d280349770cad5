"""Rows of evidence gathered by source and cell: what is weighed is a pass over a cell, not a row."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from app.engine.mapping.model import MapModel
from app.engine.types import BoolArray, Evidence, EvidenceSource, Float64Array, IntArray, SourceKind

_HALF = 1 << 20
"""Cells are numbered from this on, so that negative ones pack into a key as well: a thousand kilometres either way."""
_SIDE = 1 << 21
_AROUND = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class Passes:
    """Each row: one source over one cell. In units of the field's standard deviation per channel, about its mean.

    Attributes
    ----------
    source, cell, witness : arrays, shape (p,)
        Indices; a witness is everybody who may be one and the same: a contributor with all sources and devices.
    t : array, shape (p,), s
        Of the source's first sample.
    xy : array, shape (p, 2), m
        Mean of the rows.
    value : array, shape (p, channels)
        Mean of the rows.
    noise : array, shape (p,)
        Variance of ``value`` about the field at ``xy``.
    survey : array, shape (p,), bool
    of_row : array, shape (n,)
        Which pass each row of the evidence belongs to.
    cells : array, shape (m, 2)
        Column and row of each cell: it begins at ``cell_m`` times these.
    around : array, shape (m, 9)
        Indices of the cell and its eight neighbours, row by row; -1 where nobody passed.
    cell_m : float, m
    """

    source: IntArray
    cell: IntArray
    witness: IntArray
    t: Float64Array
    xy: Float64Array
    value: Float64Array
    noise: Float64Array
    survey: BoolArray
    of_row: IntArray
    cells: IntArray
    around: IntArray
    cell_m: float

    def __len__(self) -> int:
        return len(self.source)

    def subset(self, rows: IntArray) -> Passes:
        """Passes of an index array, over the same cells; rows of the evidence are not traced any more."""
        names = ("source", "cell", "witness", "t", "xy", "value", "noise", "survey")
        return replace(self, of_row=np.empty(0, np.int64), **{name: getattr(self, name)[rows] for name in names})

    def surroundings(self, cells: IntArray) -> IntArray:
        """Cells of an index array and all that adjoin them."""
        near = np.unique(self.around[cells])
        return near[near >= 0]


def gather(evidence: Evidence, model: MapModel, cell_m: float) -> Passes:
    """Passes of all rows, whatever their weight."""
    columns = np.floor(evidence.xy.astype(np.float64) / cell_m).astype(np.int64)
    keys, cell = np.unique(_packed(columns), return_inverse=True)
    cells = np.stack([keys // _SIDE - _HALF, keys % _SIDE - _HALF], axis=1)
    both, first, of_row = np.unique(
        evidence.source.astype(np.int64) * len(cells) + cell, return_index=True, return_inverse=True
    )
    count = np.bincount(of_row, minlength=len(both)).astype(np.float64)
    source = evidence.source[first].astype(np.int64)

    def mean(rows: Float64Array) -> Float64Array:
        """Of each pass, column by column."""
        return np.stack([np.bincount(of_row, column, len(both)) / count for column in rows.T], axis=1)

    spread = np.sqrt(mean((evidence.spread.astype(np.float64) ** 2)[:, None])[:, 0])
    covariance = model.covariance
    noise = covariance.error + covariance.white / count + covariance.position_variance(spread)
    sources = evidence.sources
    return Passes(
        source=source,
        cell=cell[first],
        witness=witnesses(sources)[source],
        t=np.array([s.t for s in sources], dtype=np.float64)[source],
        xy=mean(evidence.xy.astype(np.float64)),
        value=(mean(evidence.values.astype(np.float64)) - model.level.mean) / model.level.sd,
        noise=noise,
        survey=np.array([s.kind is SourceKind.SURVEY for s in sources], dtype=np.bool_)[source],
        of_row=of_row,
        cells=cells,
        around=_around(cells, keys),
        cell_m=cell_m,
    )


def witnesses(sources: tuple[EvidenceSource, ...]) -> IntArray:
    """Index of the witness of each source, shape (s,).

    Sessions of one contributor, and of one device, are one witness; so are all sessions nobody answers for. A survey is
    a witness of its own unless it names its contributor.
    """
    names: dict[str, int] = {}
    pairs = []
    for i, source in enumerate(sources):
        session = source.kind is SourceKind.SESSION
        who = f"contributor {source.contributor}" if source.contributor or session else f"survey {source.id}"
        pairs.append((i, names.setdefault(who, len(names))))
        if session and source.device:
            pairs.append((i, names.setdefault(f"device {source.device}", len(names))))
    n = len(sources)
    a, b = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(a)), (a, n + b)), shape=(n + len(names), n + len(names)))
    _, component = connected_components(graph, directed=False)
    _, index = np.unique(component[:n], return_inverse=True)
    return index.astype(np.int64)


def _packed(columns: IntArray) -> IntArray:
    return (columns[..., 0] + _HALF) * _SIDE + columns[..., 1] + _HALF


def _around(cells: IntArray, keys: IntArray) -> IntArray:
    return find(keys, _packed(cells[:, None] + _AROUND[None]))


def find(keys: IntArray, wanted: IntArray) -> IntArray:
    """Position of each wanted key among sorted keys, -1 where it is missing; shape of ``wanted``."""
    if not len(keys):
        return np.full(wanted.shape, -1)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)
