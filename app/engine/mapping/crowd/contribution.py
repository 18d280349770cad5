"""From a located session to evidence for the map: where it was sure of its place, what it read there.

Positions are those of the smoothed fixes, so they err: by how much their covariance says, and the evidence carries it
as ``spread``. Nothing here makes a position a truth; the map raises the variance of a row by what a displacement of
that spread changes the field. What a session read is corrected for its device in two ways: by what earlier sessions
taught of it, and by comparing the session with the map it was located on, for hard iron differs from day to day and
the angle at which a phone is carried from walk to walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from app.engine.calibration import unknown_device, without_soft_iron
from app.engine.errors import InputError
from app.engine.inertial import LevelledSamples, level_samples, window_means
from app.engine.mapping.adjustment import AdjustmentPolicy, OthersMap, displacement
from app.engine.mapping.builder import to_features
from app.engine.mapping.crowd.lookup import read_field
from app.engine.mapping.crowd.offsets import expected_of, fit_offset
from app.engine.mapping.offsets import ExpectedOffsets, OffsetsOnMap
from app.engine.mapping.samples import WINDOW_S, PlacedSamples
from app.engine.types import (
    DeviceCalibration,
    Evidence,
    EvidenceSource,
    FeatureSet,
    Fix,
    Float64Array,
    GridMap,
    ImuSamples,
    IntArray,
    Segment,
    SourceKind,
    Status,
)

_PAUSE_S = 0.8
"""A step's displacement happens within this time before it."""
_BREAK_S = 3.0
"""Without a step for so long, what follows is a stretch of its own: the gyroscope's azimuth may have gone."""


class Omission(StrEnum):
    """Why steps of a session are not in its contribution."""

    STATUS = "status"
    NOT_SURE = "not_sure"
    SPREAD = "spread"
    NEAR_LOST = "near_lost"
    OTHER_LEVEL = "other_level"
    SHORT = "short"
    UNRELATED = "unrelated"

    @property
    def words(self) -> str:
        """For people."""
        return _WORDS[self]


_WORDS = {
    Omission.STATUS: "the fix claims no position",
    Omission.NOT_SURE: "the fix is not sure enough",
    Omission.SPREAD: "the position is known too coarsely",
    Omission.NEAR_LOST: "the track was lost or ambiguous shortly before or after",
    Omission.OTHER_LEVEL: "the fix is on another level",
    Omission.SHORT: "the stretch is too short to tell the device's offset from the field",
    Omission.UNRELATED: "the stretch touches too little mapped ground to tell the device's offset from the field",
}


@dataclass(frozen=True, slots=True)
class ContributionPolicy:
    """Which steps of a session are contributed.

    Attributes
    ----------
    spread_m : float, m
        Standard deviation per axis up to which a step counts. Beyond about the field's fine length (1.5 m) a
        reading tells little of its place that its neighbours do not; with 4 m left-out survey walks were tracked worse.
    off_map : bool
        Whether steps on unmapped ground count, while their spread is within the limit. Their place rests on dead
        reckoning between mapped ground before and after, which errs by more than it claims: the map grows faster, and
        left-out survey walks were tracked no better for it. Without, it grows by its edge (``mapped_m``).
    unsure : bool
        Whether steps count that are ``ok``, but not sure.
    guard_s : float, s
        So long before and after steps without a claim nothing is taken: nobody knows when a lost track was lost.
    min_steps : int
        Of a stretch; fewer do not tell an offset.
    min_mapped : float
        Share of a stretch's rows on mapped ground from which its offset is told by the map.
    adjust : bool
        Whether positions are moved to where their field agrees best with the map.
    adjustment : AdjustmentPolicy
    """

    spread_m: float = 2.0
    off_map: bool = False
    unsure: bool = False
    guard_s: float = 4.0
    min_steps: int = 10
    min_mapped: float = 0.1
    adjust: bool = True
    adjustment: AdjustmentPolicy = field(default_factory=AdjustmentPolicy)


@dataclass(frozen=True, slots=True)
class ContributionResult:
    """What a session contributes.

    Attributes
    ----------
    evidence : Evidence
        Rows of one source, weight 1; :func:`weigh` decides what they count for.
    offsets : tuple of OffsetsOnMap
        Of each stretch: hard iron and turn against the map.
    steps : int
        Of the session.
    kept : int
        Of these in the evidence.
    omitted : tuple of (Omission, int)
        Steps left out, by reason; those that occurred.
    """

    evidence: Evidence
    offsets: tuple[OffsetsOnMap, ...]
    steps: int
    kept: int
    omitted: tuple[tuple[Omission, int], ...]

    def reasons(self) -> tuple[str, ...]:
        """What was left out and why, in plain words."""
        return tuple(f"{count} steps: {omission.words}" for omission, count in self.omitted)


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Fixes as columns, one row a step."""

    t: Float64Array
    xy: Float64Array
    variance: Float64Array

    @classmethod
    def of(cls, fixes: Sequence[Fix]) -> _Track:
        variance = np.array([0.5 * (fix.cov_xx + fix.cov_yy) for fix in fixes])
        return cls(np.array([fix.t for fix in fixes]), np.array([(fix.x, fix.y) for fix in fixes]), variance)


def contribute(
    source: EvidenceSource,
    fixes: Sequence[Fix],
    segments: Sequence[Segment],
    grid_map: GridMap,
    *,
    calibration: DeviceCalibration | None = None,
    policy: ContributionPolicy | None = None,
) -> ContributionResult:
    """Evidence of a session that was located on a map.

    Parameters
    ----------
    source : EvidenceSource
        Of kind ``session``.
    fixes : sequence of Fix
        Smoothed, one per step, in time order.
    segments : sequence of Segment
        The session's, in time order.
    grid_map : GridMap
        Of the level; what the session is compared with.
    calibration : DeviceCalibration or None
        What is known of the device; None: nothing.

    Raises
    ------
    InputError
        The source is of another kind.
    """
    if source.kind is not SourceKind.SESSION:
        raise InputError("source.kind", "must be session; surveys are placed by their waypoints")
    policy = policy or ContributionPolicy()
    ordered = sorted(fixes, key=lambda fix: fix.t)
    why = _omissions(ordered, grid_map.level_id, policy)
    stretches = _stretches(ordered, why, policy)
    parts, offsets = [Evidence.empty(grid_map.features)], []
    if stretches:
        levelled = _levelled(segments, calibration)
        prior = expected_of(calibration or unknown_device())
        for rows in stretches:
            part = _stretch(source, [ordered[i] for i in rows], levelled, grid_map, prior, policy)
            if part is None:
                why[rows] = Omission.UNRELATED
                continue
            parts.append(part[0])
            offsets.append(part[1])
    counts = tuple((o, int((why == o).sum())) for o in Omission if (why == o).any())
    kept = len(ordered) - sum(count for _, count in counts)
    return ContributionResult(Evidence.joined(parts), tuple(offsets), len(ordered), kept, counts)


def _omissions(fixes: Sequence[Fix], level_id: str, policy: ContributionPolicy) -> np.ndarray[tuple[int], np.dtype]:
    """Why each step is left out, shape (n,); "" where it is not."""
    why = np.array([_omission(fix, level_id, policy) for fix in fixes], dtype=object)
    unclaimed = np.array([fix.t for fix, one in zip(fixes, why, strict=True) if one == Omission.STATUS])
    for i, fix in enumerate(fixes):
        if why[i] == "" and len(unclaimed) and np.abs(unclaimed - fix.t).min() < policy.guard_s:
            why[i] = Omission.NEAR_LOST
    return why


def _omission(fix: Fix, level_id: str, policy: ContributionPolicy) -> Omission | str:
    if fix.level_id != level_id:
        return Omission.OTHER_LEVEL
    off_map = fix.status is Status.OFF_MAP
    if not (fix.status is Status.OK or (off_map and policy.off_map)):
        return Omission.STATUS
    if not (fix.sure or off_map or policy.unsure):
        return Omission.NOT_SURE
    if 0.5 * (fix.cov_xx + fix.cov_yy) > policy.spread_m**2:
        return Omission.SPREAD
    return ""


def _stretches(fixes: Sequence[Fix], why: np.ndarray, policy: ContributionPolicy) -> list[IntArray]:
    """Indices of the steps of each stretch; those of stretches that are too short are marked in ``why``."""
    kept = np.flatnonzero(why == "")
    if not len(kept):
        return []
    t = np.array([fix.t for fix in fixes])[kept]
    breaks = np.flatnonzero((np.diff(kept) > 1) | (np.diff(t) > _BREAK_S)) + 1
    stretches = []
    for rows in np.split(kept, breaks):
        if len(rows) < policy.min_steps:
            why[rows] = Omission.SHORT
        else:
            stretches.append(rows)
    return stretches


def _levelled(segments: Sequence[Segment], calibration: DeviceCalibration | None) -> LevelledSamples:
    """All samples of the session, levelled, soft iron taken off."""
    samples = [segment.samples for segment in segments]
    columns = (np.concatenate([getattr(s, name) for s in samples]) for name in ("t", "mag", "acc", "gyro"))
    levelled, _ = level_samples(ImuSamples(*columns))
    return replace(levelled, mag=without_soft_iron(levelled.mag, calibration))


def _stretch(
    source: EvidenceSource,
    fixes: Sequence[Fix],
    levelled: LevelledSamples,
    grid_map: GridMap,
    prior: ExpectedOffsets,
    policy: ContributionPolicy,
) -> tuple[Evidence, OffsetsOnMap] | None:
    """Evidence of one stretch and its offset; None where the map does not tell the offset."""
    placed, spread = _place(source.id, fixes, levelled)
    on_map = read_field(grid_map, placed.xy).mapped
    if on_map.mean() < policy.min_mapped:
        return None
    offset = fit_offset(placed, grid_map, prior, spread)
    if policy.adjust and grid_map.features is FeatureSet.VECTOR:
        moved = displacement(placed, offset.field(placed), _others(grid_map, placed.xy), policy.adjustment)
        placed = replace(placed, xy=placed.xy + moved)
        offset = fit_offset(placed, grid_map, prior, spread)
    values = to_features(offset.field(placed), grid_map.features)
    evidence = Evidence.of(grid_map.features, source, placed.xy, values)
    return replace(evidence, spread=spread.astype(np.float32)), offset


def _place(name: str, fixes: Sequence[Fix], levelled: LevelledSamples) -> tuple[PlacedSamples, Float64Array]:
    """Samples at steps and half steps, and the spread of their places, shape (n,), m."""
    track = _Track.of(fixes)
    half = track.t[1:] - 0.5 * np.minimum(np.diff(track.t), _PAUSE_S)
    t = np.sort(np.concatenate([track.t, half]))
    xy = np.stack([np.interp(t, track.t, track.xy[:, axis]) for axis in (0, 1)], axis=1)
    spread = np.sqrt(np.interp(t, track.t, track.variance))
    free = np.interp(t, levelled.t, levelled.heading)
    mag = window_means(levelled.t, levelled.mag, t - WINDOW_S, t + WINDOW_S)
    return PlacedSamples(name, t, xy, free + _turn(xy, free), mag), spread


def _turn(xy: Float64Array, free: Float64Array) -> float:
    """Angle from the free azimuth to the level frame, rad: way covered against way made by heading."""
    pieces = np.diff(xy[:, 0]) + 1j * np.diff(xy[:, 1])
    made = np.exp(1j * 0.5 * (free[1:] + free[:-1]))
    return float(np.angle(np.sum(pieces * np.conj(made))))


def _others(grid_map: GridMap, xy: Float64Array) -> OthersMap:
    """The map about a stretch, on the lattice that displacements are found on."""
    cell, margin = 0.5, 4.0
    lo = np.floor((xy.min(axis=0) - margin) / cell) * cell
    shape = np.ceil((xy.max(axis=0) + margin - lo) / cell).astype(int) + 1
    xx, yy = np.meshgrid(lo[0] + cell * np.arange(shape[0]), lo[1] + cell * np.arange(shape[1]))
    there = read_field(grid_map, np.stack([xx.ravel(), yy.ravel()], axis=1))
    mean, sd = (v.T.reshape(-1, *xx.shape) for v in (there.mean, there.sd))
    return OthersMap(float(lo[0]), float(lo[1]), mean, sd, np.array(grid_map.noise_sd))
