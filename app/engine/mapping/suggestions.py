"""Where to walk next: lines whose survey would teach the map most per metre.

What a survey line takes away from the variance of a node needs no readings: by kriging with one reading on the line, at
distance d, the relative variance u (of the field's own) falls by (u rho(d))^2 / (u + noise). Lines are chosen one after
the other, those chosen before counted in (the gain of each only falls as others are chosen, so most need not be weighed
anew: Minoux 1978, doi:10.1007/BFb0006528); a greedy choice of such gains is worth at least 63 % of the best (Krause,
Singh and Guestrin 2008, JMLR 9, sections 4 and 5).
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import ndimage

from app.engine.mapping.forecast import nearest_nodes
from app.engine.mapping.model import Covariance
from app.engine.mapping.quality import ConflictView, walkable_space
from app.engine.types import BoolArray, Evidence, Float64Array, GridMap, UInt8Array

PITCH_M = 1.0
LONGEST_M, SHORTEST_M = 30.0, 6.0
APPROACH_M = 10.0
"""To go to a line costs about as much as so many metres of it; without, the shortest lines would always win."""
CLEARANCE_M = 0.75
OLD_S = 365.0 * 86400.0
_DIRECTIONS = 8
_SPACING_M = 2.0
_POINT_M = 0.5
_WEIGHED = 400
_PASS_M = 1.5


DEFAULT = Covariance()


class Reason(StrEnum):
    """Why a line should be walked."""

    UNMAPPED = "unmapped"
    CONFLICT = "conflict"
    OLD = "old"
    ONE_DIRECTION = "one_direction"
    THIN = "thin"


@dataclass(frozen=True, slots=True)
class Need:
    """How a reason counts: the gain of a node is multiplied by ``factor``; a line is given the reason if it holds for
    at least ``share`` of its length."""

    factor: float
    share: float
    words: str


NEEDS: Mapping[Reason, Need] = {
    Reason.UNMAPPED: Need(1.0, 0.3, "not mapped yet"),
    # a further witness decides who is right: as much as two passes on new ground
    Reason.CONFLICT: Need(2.0, 0.15, "earlier walks disagree here"),
    Reason.OLD: Need(1.5, 0.5, "the last walk here is more than a year ago"),
    # only the way back tells a wrong carrying angle from the field
    Reason.ONE_DIRECTION: Need(1.25, 0.5, "walked in one direction only"),
    Reason.THIN: Need(1.0, 0.0, "few walks, or far apart"),
}


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A line to walk.

    Attributes
    ----------
    start, end : (x, y), m, level frame
    length_m : float
    gain_m2 : float, m^2
        What it teaches: as much as if so much unknown ground became known without any error. Lines suggested before it
        are taken as walked.
    reasons : tuple of Reason
    """

    start: tuple[float, float]
    end: tuple[float, float]
    length_m: float
    gain_m2: float
    reasons: tuple[Reason, ...]

    @property
    def words(self) -> str:
        """The reasons in words."""
        return "; ".join(NEEDS[reason].words for reason in self.reasons)


@dataclass(frozen=True, slots=True)
class Plan:
    """Suggested lines, best first, and the relative standard deviation of the walkable space (1: nothing known) before
    and after all of them."""

    suggestions: tuple[Suggestion, ...]
    before: float
    after: float


@dataclass(slots=True)
class _Ground:
    """Walkable ground at a pitch of about a metre."""

    x0: float
    y0: float
    pitch: float
    space: BoolArray
    variance: Float64Array
    """Relative; 0 outside the space."""
    factor: Float64Array
    noise: float
    covariance: Covariance
    holds: Mapping[Reason, BoolArray]

    def rows_columns(self, xy: Float64Array) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.int64]], ...]:
        rows, columns = self.space.shape
        c = np.rint((xy[:, 0] - self.x0) / self.pitch).astype(np.int64)
        r = np.rint((xy[:, 1] - self.y0) / self.pitch).astype(np.int64)
        return np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)

    def fall(self, line: Float64Array) -> tuple[tuple[slice, slice], Float64Array]:
        """Window about a line (2, 2) and how much the variance of its nodes would fall."""
        reach = 2.0 * self.covariance.length_m
        lo, hi = line.min(axis=0) - reach, line.max(axis=0) + reach
        rows, columns = self.space.shape
        a, b = max(int((lo[1] - self.y0) / self.pitch), 0), min(int((hi[1] - self.y0) / self.pitch) + 2, rows)
        c, d = max(int((lo[0] - self.x0) / self.pitch), 0), min(int((hi[0] - self.x0) / self.pitch) + 2, columns)
        window = (slice(a, b), slice(c, d))
        y, x = self.y0 + self.pitch * np.arange(a, b), self.x0 + self.pitch * np.arange(c, d)
        rho = correlation(self.covariance, _distance(line, x[None, :], y[:, None]))
        u = self.variance[window]
        return window, (u * rho) ** 2 / (u + self.noise)

    def gain(self, line: Float64Array) -> float:
        """Weighted fall, m^2."""
        window, fall = self.fall(line)
        return float((self.factor[window] * fall).sum()) * self.pitch**2

    def walk(self, line: Float64Array) -> float:
        """Take a line as walked; returns what that teaches, m^2."""
        window, fall = self.fall(line)
        self.variance[window] -= fall
        return float(fall.sum()) * self.pitch**2


def correlation(covariance: Covariance, distance: Float64Array) -> Float64Array:
    """Correlation of the field at a distance: both Matern 3/2 parts of the model."""
    coarse, fine = np.sqrt(3.0) * distance / covariance.length_m, np.sqrt(3.0) * distance / covariance.fine_length_m
    rho: Float64Array = (1.0 - covariance.fine) * (1.0 + coarse) * np.exp(-coarse) + covariance.fine * (
        1.0 + fine
    ) * np.exp(-fine)
    return rho


def suggest_lines(
    grid_map: GridMap,
    *,
    count: int = 10,
    field_sd: Sequence[float],
    covariance: Covariance = DEFAULT,
    evidence: Evidence | None = None,
    conflict: ConflictView | None = None,
    now: float | None = None,
) -> Plan:
    """Lines to survey next, best first.

    Candidates are straight lines of 6 to 30 m over walkable ground (the plan's; without one, ground near mapped ground)
    in eight directions, 2 m apart, in parts of the level that the survey reached.

    Parameters
    ----------
    grid_map : GridMap
    count : int
    field_sd : sequence of float, uT
        Spread of the level's field per channel: standard deviation of an unknown node.
    covariance : Covariance
        Of the map's model; the default stands for phones in shopping malls.
    evidence : Evidence or None
        Of the map; without it, directions are those of ``grid_map.routes``, and nothing is old.
    conflict : ConflictView or None
    now : float, s
        UTC; None: nothing is old.
    """
    ground = _ground(grid_map, field_sd, covariance, evidence, conflict, now)
    lines = _candidates(ground)
    size = max(int(ground.space.sum()), 1)
    before = float(np.sqrt(ground.variance.sum() / size))
    chosen = tuple(_suggestion(ground, line) for line in _greedy(ground, lines, count))
    return Plan(chosen, before, float(np.sqrt(ground.variance.sum() / size)))


def _greedy(ground: _Ground, lines: Sequence[Float64Array], count: int) -> list[Float64Array]:
    """Best lines; the caller's ground is as before until :func:`_suggestion` walks them one by one."""
    kept = ground.variance.copy()

    def score(line: Float64Array) -> float:
        return ground.gain(line) / (float(np.hypot(*(line[1] - line[0]))) + APPROACH_M)

    heap = [(-score(line), i, 0) for i, line in enumerate(lines)]
    heapq.heapify(heap)
    found: list[Float64Array] = []
    while heap and len(found) < count:
        best, i, seen = heapq.heappop(heap)
        if seen < len(found):
            heapq.heappush(heap, (-score(lines[i]), i, len(found)))
        elif -best > 1e-3:
            found.append(lines[i])
            ground.walk(lines[i])
        else:
            break
    ground.variance = kept
    return found


def _suggestion(ground: _Ground, line: Float64Array) -> Suggestion:
    length = float(np.hypot(*(line[1] - line[0])))
    t = np.linspace(0.0, 1.0, max(int(length / _POINT_M), 2))[:, None]
    at = ground.rows_columns(line[0] + t * (line[1] - line[0]))
    reasons = [r for r, mask in ground.holds.items() if mask[at].mean() >= NEEDS[r].share]
    (x0, y0), (x1, y1) = line.tolist()
    return Suggestion((x0, y0), (x1, y1), length, ground.walk(line), tuple(reasons) or (Reason.THIN,))


def _ground(
    grid_map: GridMap,
    field_sd: Sequence[float],
    covariance: Covariance,
    evidence: Evidence | None,
    conflict: ConflictView | None,
    now: float | None,
) -> _Ground:
    every = max(round(PITCH_M / grid_map.cell_m), 1)
    thin = (slice(None, None, every), slice(None, None, every))
    space = _reached(grid_map)
    field = np.array(field_sd, dtype=np.float64)[:, None, None] ** 2
    variance = np.clip((grid_map.sd.astype(np.float64)[:, *thin] ** 2 / field).mean(axis=0), 0.0, 1.0)
    mapped = grid_map.mapped
    disputed = np.zeros(grid_map.shape, bool) if conflict is None else conflict.at_nodes(grid_map)[2]
    holds = {
        Reason.UNMAPPED: ~mapped,
        Reason.CONFLICT: disputed & mapped,
        Reason.OLD: mapped & _old(grid_map, evidence, now),
        Reason.ONE_DIRECTION: mapped & one_direction(grid_map, evidence),
    }
    factor = np.ones(variance.shape)
    for reason, mask in holds.items():
        factor[mask[thin]] *= NEEDS[reason].factor
    return _Ground(
        x0=grid_map.x0,
        y0=grid_map.y0,
        pitch=every * grid_map.cell_m,
        space=space[thin],
        variance=np.where(space[thin], variance, 0.0),
        factor=factor,
        noise=float(np.mean(np.array(grid_map.noise_sd) ** 2 / field.ravel())),
        covariance=covariance,
        holds={reason: mask[thin] for reason, mask in holds.items()},
    )


def _reached(grid_map: GridMap) -> BoolArray:
    """Connected parts of the walkable space that hold mapped ground; all of it if none does."""
    space = walkable_space(grid_map)
    label, count = ndimage.label(space, structure=np.ones((3, 3)))
    reached = np.zeros(count + 1, dtype=bool)
    reached[label[grid_map.mapped & space]] = True
    reached[0] = False
    found: BoolArray = reached[label] if reached.any() else space
    return found


def _candidates(ground: _Ground) -> list[Float64Array]:
    """Straight lines over walkable ground, those with the most unknown about them."""
    # room to either side, unless that would close a corridor of the plan
    room = ndimage.distance_transform_edt(np.pad(ground.space, 1))[1:-1, 1:-1] * ground.pitch
    free = room >= min(CLEARANCE_M + 0.5 * ground.pitch, float(room.max()))
    rows, columns = ground.space.shape
    centre = np.array([ground.x0 + 0.5 * columns * ground.pitch, ground.y0 + 0.5 * rows * ground.pitch])
    half = 0.5 * ground.pitch * float(np.hypot(rows, columns))
    along, beside = np.arange(-half, half, _POINT_M), np.arange(-half, half, _SPACING_M)
    lines, worth = [], []
    want = ground.factor * ground.variance
    for angle in np.pi / _DIRECTIONS * np.arange(_DIRECTIONS):
        u = np.array([np.cos(angle), np.sin(angle)])
        v = np.array([-u[1], u[0]])
        for offset in beside:
            points = centre + offset * v + along[:, None] * u
            r = np.rint((points[:, 1] - ground.y0) / ground.pitch).astype(np.int64)
            c = np.rint((points[:, 0] - ground.x0) / ground.pitch).astype(np.int64)
            inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            r, c = np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)
            total = np.concatenate([[0.0], np.cumsum(want[r, c])])
            for a, b in _pieces(inside & free[r, c]):
                lines.append(points[[a, b - 1]])
                worth.append((total[b] - total[a]) / (b - a + APPROACH_M / _POINT_M))
    order = np.argsort(-np.array(worth), kind="stable")[:_WEIGHED]
    return [lines[i] for i in order]


def _pieces(free: BoolArray) -> list[tuple[int, int]]:
    """Runs of points, cut to the longest line with half of it shared between neighbours."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], free, [False]]).astype(np.int8)))
    longest, shortest = int(LONGEST_M / _POINT_M), int(SHORTEST_M / _POINT_M)
    found = []
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        starts = range(a, max(b - longest // 2, a + 1), longest // 2)
        found += [(s, min(s + longest, b)) for s in starts if min(s + longest, b) - s >= shortest]
    return found


def _distance(line: Float64Array, x: Float64Array, y: Float64Array) -> Float64Array:
    """From points to a straight line of two ends, m."""
    along = line[1] - line[0]
    t = ((x - line[0, 0]) * along[0] + (y - line[0, 1]) * along[1]) / max(float(along @ along), 1e-12)
    t = np.clip(t, 0.0, 1.0)
    distance: Float64Array = np.hypot(x - line[0, 0] - t * along[0], y - line[0, 1] - t * along[1])
    return distance


def one_direction(grid_map: GridMap, evidence: Evidence | None) -> BoolArray:
    """Nodes that walks passed within 1.5 m, but never in two opposite directions, shape (rows, columns)."""
    octants = np.zeros(grid_map.shape, dtype=np.uint8)
    for xy in _passes(grid_map, evidence):
        leg = np.diff(xy, axis=0)
        moves = np.hypot(leg[:, 0], leg[:, 1]) > 0.05
        octant = np.rint(np.arctan2(leg[moves, 1], leg[moves, 0]) * 4.0 / np.pi).astype(np.int64) % 8
        row, column, inside = nearest_nodes(grid_map, xy[:-1][moves])
        np.bitwise_or.at(octants, (row[inside], column[inside]), (1 << octant[inside]).astype(np.uint8))
    near = _spread(octants, max(round(_PASS_M / grid_map.cell_m), 1))
    # neighbours of the opposite octant count as opposite too: nobody walks that straight
    opposite = _turned(near, 3) | _turned(near, 4) | _turned(near, 5)
    alone: BoolArray = (near > 0) & ((near & opposite) == 0)
    return alone


def _turned(octants: UInt8Array, by: int) -> UInt8Array:
    # uint8: what is shifted out on the left comes in on the right
    return np.asarray((octants << by) | (octants >> (8 - by)), dtype=np.uint8)


def _spread(octants: UInt8Array, reach: int) -> UInt8Array:
    """Bits of all nodes of the square about each node."""
    found = octants.copy()
    for axis in (0, 1):
        base = found.copy()
        for shift in range(1, reach + 1):
            cut = [slice(None), slice(None)]
            other = [slice(None), slice(None)]
            cut[axis], other[axis] = slice(shift, None), slice(None, -shift)
            found[tuple(cut)] |= base[tuple(other)]
            found[tuple(other)] |= base[tuple(cut)]
    return found


def _passes(grid_map: GridMap, evidence: Evidence | None) -> list[Float64Array]:
    """Points of each walk, (k, 2)."""
    if evidence is not None:
        return [evidence.xy[evidence.source == k].astype(np.float64) for k in range(len(evidence.sources))]
    return [] if grid_map.routes is None else [line.astype(np.float64) for line in grid_map.routes.lines()]


def _old(grid_map: GridMap, evidence: Evidence | None, now: float | None) -> BoolArray:
    """Nodes whose last pass is more than a year ago."""
    if evidence is None or now is None or not len(evidence):
        return np.zeros(grid_map.shape, dtype=bool)
    t = np.array([source.t for source in evidence.sources])[evidence.source]
    recent = t > now - OLD_S
    row, column, inside = nearest_nodes(grid_map, evidence.xy[recent].astype(np.float64))
    fresh = np.zeros(grid_map.shape, dtype=np.uint8)
    fresh[row[inside], column[inside]] = 1
    old: BoolArray = _spread(fresh, max(round(_PASS_M / grid_map.cell_m), 1)) == 0
    return old
