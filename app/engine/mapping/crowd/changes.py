"""Changes of the field that stay: a new lift, steel that was moved.

A change is claimed where several independent passes differ from what was read before, alike among one another, and no
later pass goes on reading the old field. It is looked for cell by cell, each with its eight neighbours, since two
passes hardly ever tread on the same square metre: passes are lined up by time, and the date is sought at which the
means before and after differ most for their variance (the likelihood ratio of one change point, Hinkley 1970,
doi:10.1093/biomet/57.1.1). What differs is the residual to the map, not the field, which changes from cell to cell
anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from app.engine.mapping.crowd.agreement import compare
from app.engine.mapping.crowd.passes import Passes
from app.engine.mapping.crowd.policy import ChangePolicy
from app.engine.mapping.model import MapModel
from app.engine.types import BoolArray, Float64Array, IntArray

_SETTLED = 0.1
"""Variance, units of the field's, by which residuals in neighbouring cells differ because the map between is not known
exactly."""

_MIDDLE = 0.5
"""Of the way from the old field to the new one: who is beyond has read the new one."""


@dataclass(frozen=True, slots=True)
class ChangeEvent:
    """The field changed.

    Attributes
    ----------
    cells : tuple of (float, float), m, level frame
        Centre of each cell that changed.
    cell_m : float, m
        Their side.
    after_t, before_t : float, s
        It happened after the last pass that read the old field and before the first that read the new one.
    delta : tuple of float, uT
        New minus old field, per channel, mean over the cells.
    witnesses : int
        Independent ones of sessions that read the new field.
    """

    cells: tuple[tuple[float, float], ...]
    cell_m: float
    after_t: float
    before_t: float
    delta: tuple[float, ...]
    witnesses: int


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Of each cell with its neighbours: the date that divides its passes best. Arrays of shape (m,) or (m, channels).

    ``score`` is 0 where no date will do; ``before`` and ``after`` are means, ``t0`` and ``t1`` the passes' times on
    either side.
    """

    score: Float64Array
    before: Float64Array
    after: Float64Array
    t0: Float64Array
    t1: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Overtaken:
    """Passes that a change has made history, and those that tell of it; masks of shape (p,)."""

    old: BoolArray
    new: BoolArray


def find_changes(
    passes: Passes, credit: Float64Array, model: MapModel, policy: ChangePolicy
) -> tuple[list[ChangeEvent], Overtaken]:
    """One change at most of each place.

    Parameters
    ----------
    passes : Passes
    credit : array, shape (p,)
        Passes without any are not heard.
    model : MapModel
    policy : ChangePolicy
    """
    comparison = compare(passes, model.covariance, credit)
    heard = (credit > 0) & (comparison.explained > _SETTLED)
    split = best_split(passes, comparison.residual, heard, model.level.sd, policy)
    seeds = np.flatnonzero(split.score >= policy.evidence)
    events: list[ChangeEvent] = []
    old, new = np.zeros(len(passes), dtype=np.bool_), np.zeros(len(passes), dtype=np.bool_)
    for component in _components(passes.around, seeds):
        region = passes.surroundings(passes.surroundings(component))
        rows = np.flatnonzero(np.isin(passes.cell, region) & (credit > 0))
        strongest = component[split.score[component].argmax()]
        dates = (float(split.t0[strongest]), float(split.t1[strongest]))
        place = passes.surroundings(component)
        found = _event(passes.subset(rows), credit[rows], place, dates, model, policy)
        if found is not None:
            events.append(found[0])
            old[rows] |= found[1].old
            new[rows] |= found[1].new
    return events, Overtaken(old, new)


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """Passes over each cell or a neighbour of it, gathered by source, lined up by cell and time; shape (e, ...)."""

    cell: IntArray
    t: Float64Array
    witness: IntArray
    residual: Float64Array
    noise: Float64Array


def _line_up(passes: Passes, residual: Float64Array, heard: BoolArray) -> _Line:
    rows = np.flatnonzero(heard)
    near = passes.around[passes.cell[rows]]
    there = near >= 0
    cell, row = near[there], np.repeat(rows, there.sum(axis=1))
    n = int(passes.source.max(initial=0)) + 1
    _, first, group = np.unique(cell * n + passes.source[row], return_index=True, return_inverse=True)
    count = np.bincount(group).astype(np.float64)
    mean = np.stack([np.bincount(group, column[row]) / count for column in residual.T], axis=1)
    noise = np.bincount(group, passes.noise[row]) / count
    cell, t, witness = cell[first], passes.t[row[first]], passes.witness[row[first]]
    order = np.lexsort((t, cell))
    return _Line(cell[order], t[order], witness[order], mean[order], noise[order])


def best_split(
    passes: Passes, residual: Float64Array, heard: BoolArray, sd: Float64Array, policy: ChangePolicy
) -> Split:
    """For each cell the date with the largest difference for its variance; see :class:`Split`."""
    m, channels = len(passes.cells), residual.shape[1]
    none = np.zeros((m, channels))
    split = Split(np.zeros(m), none, none.copy(), np.zeros(m), np.zeros(m))
    line = _line_up(passes, residual, heard)
    e = len(line.cell)
    if e < 2:
        return split
    begin = np.searchsorted(line.cell, line.cell, side="left")
    end = np.searchsorted(line.cell, line.cell, side="right")
    earlier, later = _distinct(line, begin, end)
    sums = _Cumulative.of(line, begin, end)
    before, after = sums.before(), sums.after()
    k0, k1 = np.maximum(earlier, 1), np.maximum(later, 1)
    variance = (sums.noise() + _SETTLED) * (1.0 / k0 + 1.0 / k1)
    difference = after - before
    score = (difference**2).sum(axis=1) / variance
    least = np.linalg.norm(difference * sd, axis=1) >= policy.least_ut
    valid = least & (later >= policy.witnesses) & (earlier >= 1) & (np.arange(e) + 1 < end)
    valid[:-1] &= line.t[1:] > line.t[:-1]
    score = np.where(valid, score, 0.0)
    order = np.lexsort((score, line.cell))
    best = order[np.searchsorted(line.cell[order], np.arange(m), side="right") - 1]
    has = np.isin(np.arange(m), line.cell)
    best = np.where(has, best, 0)
    following = np.minimum(best + 1, e - 1)
    split = Split(np.where(has, score[best], 0.0), before[best], after[best], line.t[best], line.t[following])
    return replace(split, score=np.where(_consistent(line, split, policy), split.score, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Cumulative:
    """Sums up to and including each entry, and over all, of its own cell."""

    line: _Line
    done: Float64Array
    total: Float64Array
    place: Float64Array
    count: Float64Array

    @classmethod
    def of(cls, line: _Line, begin: IntArray, end: IntArray) -> _Cumulative:
        columns = np.column_stack([line.residual, line.noise])
        running = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
        place = np.asarray(np.arange(len(line.cell)) - begin + 1, dtype=np.float64)
        return cls(
            line,
            running[1:] - running[begin],
            running[end] - running[begin],
            place,
            np.asarray(end - begin, dtype=np.float64),
        )

    def before(self) -> Float64Array:
        """Mean residual of the passes up to each."""
        return np.asarray(self.done[:, :-1] / self.place[:, None])

    def after(self) -> Float64Array:
        """Mean residual of those after it."""
        rest = np.maximum(self.count - self.place, 1.0)
        return np.asarray((self.total - self.done)[:, :-1] / rest[:, None])

    def noise(self) -> Float64Array:
        """Mean variance of the cell's passes."""
        return np.asarray(self.total[:, -1] / self.count)


def _distinct(line: _Line, begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
    """How many witnesses there are up to and including each entry of its cell, and after it."""
    key = line.cell * (int(line.witness.max()) + 1) + line.witness
    _, first = np.unique(key, return_index=True)
    _, last = np.unique(key[::-1], return_index=True)
    opens, closes = np.zeros(len(key) + 1, dtype=np.int64), np.zeros(len(key) + 1, dtype=np.int64)
    opens[first + 1] = 1
    closes[len(key) - last] = 1
    opened, closed = np.cumsum(opens), np.cumsum(closes)
    index = np.arange(1, len(key) + 1)
    return opened[index] - opened[begin], closed[end] - closed[index]


def _consistent(line: _Line, split: Split, policy: ChangePolicy) -> BoolArray:
    """Whether enough passes on either side of the date lie on their own side of the middle, shape (m,)."""
    difference = (split.after - split.before)[line.cell]
    squared = np.maximum((difference**2).sum(axis=1), 1e-12)
    share = ((line.residual - split.before[line.cell]) * difference).sum(axis=1) / squared
    later = line.t > split.t0[line.cell]
    m = len(split.score)
    right_after = np.bincount(line.cell, later & (share > _MIDDLE), m) / np.maximum(np.bincount(line.cell, later, m), 1)
    right_before = np.bincount(line.cell, ~later & (share < _MIDDLE), m) / np.maximum(
        np.bincount(line.cell, ~later, m), 1
    )
    return np.asarray((right_after >= policy.agreed) & (right_before >= policy.agreed))


def _components(around: IntArray, seeds: IntArray) -> list[IntArray]:
    """Seeds that adjoin one another, together."""
    if not len(seeds):
        return []
    m = len(around)
    near = around[seeds]
    linked = np.isin(near, seeds)
    a, b = np.repeat(seeds, linked.sum(axis=1)), near[linked]
    _, label = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(m, m)), directed=False)
    own = label[seeds]
    return [seeds[own == one] for one in np.unique(own)]


def _event(
    passes: Passes,
    credit: Float64Array,
    place: IntArray,
    dates: tuple[float, float],
    model: MapModel,
    policy: ChangePolicy,
) -> tuple[ChangeEvent, Overtaken] | None:
    """The event at a place, and the passes it concerns, once it is known about when.

    All passes are compared with those before the date alone: the residual is nought for the old field and the whole
    difference for the new one, in every cell. (Against old and new together it would be a part of it that depends on
    how many of either a cell has.)
    """
    here = np.isin(passes.cell, place)
    before = compare(passes, model.covariance, np.where(passes.t > dates[0], 0.0, credit))
    here &= before.explained > _SETTLED
    delta = _mean(before.residual, here & (passes.t > dates[0]), passes.noise)
    for _ in range(2):  # what has changed tells by how much, and by how much tells what has changed
        share = (before.residual * delta).sum(axis=1) / max(float((delta**2).sum()), 1e-12)
        cells = _touched(passes, here & (passes.t > dates[0]), share)
        touched = here & np.isin(passes.cell, cells)
        new = touched & (passes.t > dates[0]) & (share > _MIDDLE)
        if not new.any():
            return None
        delta = _mean(before.residual, new, passes.noise)
        dates = _date(passes, touched, share, dates)
    # walks of one survey follow each other within minutes: what they differ by is labels and offsets, not steel
    witnesses = len(np.unique(passes.witness[new & ~passes.survey]))
    if len(cells) < policy.cells or witnesses < policy.witnesses:
        return None
    centres = (passes.cells[cells] + 0.5) * passes.cell_m
    event = ChangeEvent(
        cells=tuple((float(x), float(y)) for x, y in centres),
        cell_m=passes.cell_m,
        after_t=dates[0],
        before_t=dates[1],
        delta=tuple(float(v) for v in delta * model.level.sd),
        witnesses=witnesses,
    )
    return event, Overtaken(np.isin(passes.cell, cells) & (passes.t <= dates[0]), new)


def _mean(residual: Float64Array, rows: BoolArray, noise: Float64Array) -> Float64Array:
    """Mean residual of some passes, shape (channels,); nought of none."""
    weight = np.where(rows, 1.0 / noise, 0.0)
    return np.asarray(weight @ residual / max(float(weight.sum()), 1e-12))


def _touched(passes: Passes, later: BoolArray, share: Float64Array) -> IntArray:
    """Cells whose own later passes read the new field, on average."""
    m = len(passes.cells)
    weight = np.where(later, 1.0 / passes.noise, 0.0)
    total = np.bincount(passes.cell, weight, m)
    mean = np.bincount(passes.cell, weight * share, m) / np.maximum(total, 1e-9)
    return np.flatnonzero((total > 0) & (mean > _MIDDLE))


def _date(
    passes: Passes, concerned: BoolArray, share: Float64Array, otherwise: tuple[float, float]
) -> tuple[float, float]:
    """Times of the last source that read the old field and of the first that read the new one, over all cells.

    One cell dates by a pass or two that may have erred; over the whole change each source has a mean of many.
    """
    t, group = np.unique(passes.t[concerned], return_inverse=True)
    if len(t) < 2:
        return otherwise
    weight = 1.0 / passes.noise[concerned]
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * np.clip(share[concerned], -0.5, 1.5)) / total
    # squared distance from 0 of those before, from 1 of those after; differs from cut to cut by 1 - 2 share
    cost = np.cumsum(total * (2.0 * mean - 1.0))[:-1]
    last = int(cost.argmin())
    return float(t[last]), float(t[last + 1])


def merge_events(events: Sequence[ChangeEvent]) -> list[ChangeEvent]:
    """Events of adjoining cells whose dates overlap, as one."""
    merged: list[ChangeEvent] = []
    for event in events:
        for i, other in enumerate(merged):
            if _same(event, other):
                merged[i] = _joined(event, other)
                break
        else:
            merged.append(event)
    return merged if len(merged) == len(events) else merge_events(merged)


def _same(a: ChangeEvent, b: ChangeEvent) -> bool:
    overlap = max(a.after_t, b.after_t) <= min(a.before_t, b.before_t)
    gap = np.abs(np.array(a.cells)[:, None] - np.array(b.cells)[None]).max(axis=-1).min()
    return bool(overlap and gap < 2.5 * a.cell_m)


def _joined(a: ChangeEvent, b: ChangeEvent) -> ChangeEvent:
    """Both together; the date is that of the larger, which has more passes to tell it."""
    n, m = len(a.cells), len(b.cells)
    larger = a if n >= m else b
    delta = tuple((n * x + m * y) / (n + m) for x, y in zip(a.delta, b.delta, strict=True))
    return replace(larger, cells=tuple(sorted({*a.cells, *b.cells})), delta=delta)
