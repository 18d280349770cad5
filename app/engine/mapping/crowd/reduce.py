"""Evidence kept within bounds: a year of traffic must not make a level grow without limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.types import Evidence, Float64Array, IntArray, SourceKind


@dataclass(frozen=True, slots=True)
class ReductionPolicy:
    """How many rows of sessions a cell keeps; rows of surveys are all kept.

    Attributes
    ----------
    cell_m : float, m
        Side of a cell. Half the field's fine length: rows nearer to one another tell of the same field.
    sources : int
        Sources of a cell; the newest are kept. Of 24 independent passes the mean errs by a fifth of what one does, and
        a change is known after five.
    per_contributor : int
        Of these, of one contributor: nobody pushes the others out.
    """

    cell_m: float = 0.75
    sources: int = 24
    per_contributor: int = 4


def reduce(evidence: Evidence, policy: ReductionPolicy | None = None) -> Evidence:
    """At most so many rows a cell: of each source one, its mean, and of each cell's sources the newest.

    Done before evidence is stored, once a map version is; idempotent. What was left out cannot be weighed again, so
    older versions keep their own evidence.

    Returns
    -------
    Evidence
        Surveys first, then sessions.
    """
    policy = policy or ReductionPolicy()
    session = np.array([source.kind is SourceKind.SESSION for source in evidence.sources], dtype=np.bool_)
    if not len(evidence) or not session[evidence.source].any():
        return evidence
    of_session = session[evidence.source]
    merged = _merged(evidence.subset(of_session), policy)
    kept = merged.subset(np.sort(_newest(merged, policy)))
    survey = evidence.subset(~of_session)
    return Evidence.joined([survey, kept])


def _cells(evidence: Evidence, cell_m: float) -> IntArray:
    columns = np.floor(evidence.xy.astype(np.float64) / cell_m).astype(np.int64)
    _, cell = np.unique(columns, axis=0, return_inverse=True)
    return cell.reshape(-1)


def _merged(evidence: Evidence, policy: ReductionPolicy) -> Evidence:
    """Rows of one source and cell as one: means, in the order of the first of them."""
    cell = _cells(evidence, policy.cell_m)
    key = evidence.source.astype(np.int64) * (int(cell.max()) + 1) + cell
    _, first, group, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)

    def mean(columns: Float64Array) -> Float64Array:
        return np.stack([np.bincount(group, column) / count for column in columns.T], axis=1)

    order = np.argsort(first)
    spread = np.sqrt(mean(evidence.spread.astype(np.float64)[:, None] ** 2)[:, 0])
    return replace(
        evidence,
        source=evidence.source[first][order],
        xy=mean(evidence.xy.astype(np.float64))[order].astype(np.float32),
        values=mean(evidence.values.astype(np.float64))[order].astype(np.float32),
        spread=spread[order].astype(np.float32),
        weight=mean(evidence.weight.astype(np.float64)[:, None])[order, 0].astype(np.float32),
    )


def _newest(evidence: Evidence, policy: ReductionPolicy) -> IntArray:
    """Rows to keep: of each cell those of the newest sources, of one contributor only so many."""
    cell = _cells(evidence, policy.cell_m)
    names = {name: i for i, name in enumerate(dict.fromkeys(s.contributor for s in evidence.sources))}
    contributor = np.array([names[s.contributor] for s in evidence.sources])[evidence.source]
    t = np.array([s.t for s in evidence.sources])[evidence.source]
    own = _place(np.stack([cell, contributor], axis=1), t) < policy.per_contributor
    rows = np.flatnonzero(own)
    return rows[_place(cell[rows, None], t[rows]) < policy.sources]


def _place(group: IntArray, t: Float64Array) -> IntArray:
    """Place of each row within its group, the newest 0."""
    order = np.lexsort((-t, *group.T[::-1]))
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (group[order[1:]] != group[order[:-1]]).any(axis=1)
    start = np.maximum.accumulate(np.where(new, np.arange(len(order)), 0))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order)) - start
    return place
