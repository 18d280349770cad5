"""Correlation criteria: how well readings along a track agree with the map's at a placement.

With readings ``m`` and the map's ``s`` at ``k = 1..N``, all as in Zhang 2021 (table 2.2) and Cheng and Zhou 2026,
doi:10.7690/bgzdh.2026.05.004 (table 1), except that the roots of NPROD are of squares, as they must be.

Several channels are one longer sequence: sums and means run over points and channels, CC takes each channel's own mean
off and so forgives an offset of each, and one gain of them all. A sequence without any variation correlates with
nothing (0).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from app.engine.errors import InputError
from app.engine.types import BoolArray, Float64Array


class Criterion(StrEnum):
    """Measure of agreement of a sequence of readings with the map's."""

    MAD = "mad"
    MSD = "msd"
    AD = "ad"
    SD = "sd"
    COR = "cor"
    CC = "cc"
    PROD = "prod"
    NPROD = "nprod"
    HAUSDORFF = "hausdorff"

    @property
    def maximized(self) -> bool:
        """Whether more is better."""
        return CRITERIA[self].better == "max"


@dataclass(frozen=True, slots=True)
class CriterionNote:
    """What a criterion is and what it lets pass.

    Attributes
    ----------
    formula : str
    better : str
        ``min`` or ``max``.
    offset, gain, order : bool
        Whether the order of candidates stays the same when a constant is added to the readings of a channel, when all
        readings are multiplied by one positive factor, when the readings change places along the track.
    forgives : str
        The same as a sentence.
    """

    formula: str
    better: str
    offset: bool
    gain: bool
    order: bool
    forgives: str


_NOTHING = "Nothing: needs a calibrated sensor."
CRITERIA: MappingProxyType[Criterion, CriterionNote] = MappingProxyType(
    {
        Criterion.MAD: CriterionNote(
            "mean |s - m|", "min", False, False, False, "Single wild readings more than squares do; no offset, no gain."
        ),
        Criterion.MSD: CriterionNote("mean (s - m)^2", "min", False, False, False, _NOTHING),
        Criterion.AD: CriterionNote("sum |s - m|", "min", False, False, False, "As MAD."),
        Criterion.SD: CriterionNote("sum (s - m)^2", "min", False, False, False, _NOTHING),
        Criterion.COR: CriterionNote(
            "mean s m", "max", False, True, False, "A gain; it is drawn to places where the field is strong."
        ),
        Criterion.CC: CriterionNote(
            "Pearson correlation of s and m", "max", True, True, False, "An offset of each channel and a common gain."
        ),
        Criterion.PROD: CriterionNote("mean s m, over the shifted set", "max", False, True, False, "As COR."),
        Criterion.NPROD: CriterionNote(
            "sum s m / (sqrt(sum s^2) sqrt(sum m^2))", "max", False, True, False, "A common gain; no offset."
        ),
        Criterion.HAUSDORFF: CriterionNote(
            "max(h(s, m), h(m, s)), h(a, b) = max_a min_b |a - b|",
            "min",
            False,
            False,
            True,
            "An unsteady pace: it compares which values occur, not where along the track; no offset, no gain.",
        ),
    }
)
"""All criteria; the documents' table is made of this one."""


@dataclass(frozen=True, slots=True)
class Moments:
    """Sums over the points of a track, of each channel at many placements.

    Attributes
    ----------
    weight : array, shape (...)
        Sum of the points' weights.
    s, ss, sz, z, zz : array, shape (channels, ...)
        Weighted sums of the map's readings, their squares, products with the measured, these, and their squares.
    """

    weight: Float64Array
    s: Float64Array
    ss: Float64Array
    sz: Float64Array
    z: Float64Array
    zz: Float64Array

    def shifted(self, by: Float64Array) -> Moments:
        """The moments after ``by`` (uT, shape (channels,)) is added to map and readings."""
        c = by.reshape(-1, *(1,) * self.weight.ndim)
        return Moments(
            self.weight,
            self.s + c * self.weight,
            self.ss + 2.0 * c * self.s + c**2 * self.weight,
            self.sz + c * (self.s + self.z) + c**2 * self.weight,
            self.z + c * self.weight,
            self.zz + 2.0 * c * self.z + c**2 * self.weight,
        )

    def centred(self) -> Moments:
        """The moments after each channel's mean difference is taken off the readings."""
        off = self.offset()
        return Moments(
            self.weight,
            self.s,
            self.ss,
            self.sz - off * self.s,
            self.s,
            self.zz - 2.0 * off * self.z + off**2 * self.weight,
        )

    def offset(self) -> Float64Array:
        """Mean of readings less map, shape (channels, ...), uT."""
        offset: Float64Array = (self.z - self.s) / np.maximum(self.weight, 1e-30)
        return offset


def evaluate(
    criterion: Criterion, measured: Float64Array, readings: Float64Array, weight: Float64Array | None = None
) -> Float64Array:
    """A criterion of one measured sequence against the map's at many placements, by its formula.

    Parameters
    ----------
    criterion : Criterion
    measured : array, shape (n, channels) or (..., n, channels), uT
    readings : array, shape (..., n, channels), uT
        Of the map.
    weight : array, shape (..., n), or None
        Of each point; 0 leaves it out. Sums are then those of as many points as there are. None: all alike.

    Returns
    -------
    array, shape (...)

    Raises
    ------
    InputError
        The sequences are not alike.
    """
    if readings.ndim < 2 or measured.shape[-2:] != readings.shape[-2:] or 0 in measured.shape:
        raise InputError("measured", f"needs the shape (n, channels) of the readings, {readings.shape[-2:]}")
    n, channels = readings.shape[-2:]
    w = np.ones(readings.shape[:-1]) if weight is None else np.asarray(weight, dtype=np.float64)
    w = w / np.maximum(w.sum(axis=-1, keepdims=True), 1e-30)  # shares: sums below are means over points
    if criterion is Criterion.HAUSDORFF:
        return _hausdorff(np.broadcast_to(measured, readings.shape), readings, w > 0.0)
    difference, share = readings - measured, w[..., None] / channels
    match criterion:
        case Criterion.MAD | Criterion.AD:
            mean = (share * np.abs(difference)).sum(axis=(-2, -1))
        case Criterion.MSD | Criterion.SD:
            mean = (share * difference**2).sum(axis=(-2, -1))
        case Criterion.COR | Criterion.PROD:
            mean = (share * readings * measured).sum(axis=(-2, -1))
        case _:
            mean = _cosine(criterion, measured, readings, share)
    total: Float64Array = mean * (n * channels) if criterion in (Criterion.AD, Criterion.SD) else mean
    return total


def evaluate_moments(criterion: Criterion, moments: Moments, n: int) -> Float64Array:
    """The same of a sequence of ``n`` points whose sums are known; shape (...).

    Raises
    ------
    InputError
        The criterion is not of second order (MAD, AD, Hausdorff).
    """
    channels = moments.s.shape[0]
    count = np.maximum(moments.weight, 1e-30) * channels
    match criterion:
        case Criterion.MSD | Criterion.SD:
            value = np.maximum(moments.ss - 2.0 * moments.sz + moments.zz, 0.0).sum(axis=0) / count
            return np.asarray(value * (n * channels) if criterion is Criterion.SD else value)
        case Criterion.COR | Criterion.PROD:
            return np.asarray(moments.sz.sum(axis=0) / count)
        case Criterion.CC | Criterion.NPROD:
            ss, sz, zz = moments.ss, moments.sz, moments.zz
            if criterion is Criterion.CC:
                w = np.maximum(moments.weight, 1e-30)
                ss, sz, zz = ss - moments.s**2 / w, sz - moments.s * moments.z / w, zz - moments.z**2 / w
            return _ratio(sz.sum(axis=0), ss.sum(axis=0), zz.sum(axis=0))
    raise InputError("criterion", f"{criterion} does not follow from sums of squares; evaluate it by its formula")


def as_cost(criterion: Criterion, value: Float64Array) -> Float64Array:
    """A criterion's value as a cost: always less is better."""
    return -value if criterion.maximized else value


def centred(measured: Float64Array, readings: Float64Array, weight: Float64Array | None = None) -> Float64Array:
    """The measured sequence with its mean difference from the map taken off, channel by channel; (..., n, channels)."""
    w = np.ones(readings.shape[:-1]) if weight is None else weight
    share = (w / np.maximum(w.sum(axis=-1, keepdims=True), 1e-30))[..., None]
    moved: Float64Array = measured - (share * (measured - readings)).sum(axis=-2, keepdims=True)
    return moved


def _cosine(criterion: Criterion, measured: Float64Array, readings: Float64Array, share: Float64Array) -> Float64Array:
    s, m = readings, np.broadcast_to(measured, readings.shape)
    if criterion is Criterion.CC:
        whole = np.maximum(share.sum(axis=-2, keepdims=True), 1e-30)
        s = s - (share * s).sum(axis=-2, keepdims=True) / whole
        m = m - (share * m).sum(axis=-2, keepdims=True) / whole
    sm, ss, mm = ((share * product).sum(axis=(-2, -1)) for product in (s * m, s * s, m * m))
    return _ratio(sm, ss, mm)


def _ratio(sm: Float64Array, ss: Float64Array, mm: Float64Array) -> Float64Array:
    """Cosine of two sequences; 0 where one has no length."""
    length = np.sqrt(np.maximum(ss, 0.0)) * np.sqrt(np.maximum(mm, 0.0))
    some = length > 1e-12
    return np.where(some, np.clip(sm / np.where(some, length, 1.0), -1.0, 1.0), 0.0)


def _hausdorff(measured: Float64Array, readings: Float64Array, used: BoolArray) -> Float64Array:
    """Hausdorff distance of the two sets of readings (Euclidean over channels); 0 where no point is used."""
    squared = np.zeros((*readings.shape[:-1], readings.shape[-2]))
    for c in range(readings.shape[-1]):
        squared += (readings[..., :, None, c] - measured[..., None, :, c]) ** 2
    squared[~(used[..., :, None] & used[..., None, :])] = np.inf
    ways = [np.where(used, squared.min(axis=axis), 0.0).max(axis=-1) for axis in (-1, -2)]
    return np.asarray(np.sqrt(np.maximum(*ways)))
