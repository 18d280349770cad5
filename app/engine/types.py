"""Data types of the engine: frozen dataclasses over numpy arrays.

Conventions (frames, units, time) are those of :mod:`app.engine`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.engine.errors import InputError

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Progress = Callable[[float, str], None]
"""``progress(fraction, what)``: called now and then with 0..1 and a short phrase."""


class FeatureSet(StrEnum):
    """What of the field is compared with the map."""

    VECTOR = "vector"
    HV = "hv"
    TOTAL = "total"

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in storage order."""
        return _CHANNELS[self]


_CHANNELS: dict[FeatureSet, tuple[str, ...]] = {
    FeatureSet.VECTOR: ("x", "y", "z"),
    FeatureSet.HV: ("h", "v"),
    FeatureSet.TOTAL: ("total",),
}


class Status(StrEnum):
    """What a fix claims."""

    OK = "ok"
    AMBIGUOUS = "ambiguous"
    INSUFFICIENT = "insufficient"
    OFF_MAP = "off_map"
    DISTURBED = "disturbed"


class FixKind(StrEnum):
    """Which samples a fix rests on, seen from its time.

    * ``filtered``: those up to its time (and the few tenths of a second that confirm a step); the answer of the moment.
    * ``fixed_lag``: also those of about five seconds after it; told that much later.
    * ``smoothed``: all of the session, before and after; for afterwards.
    """

    FILTERED = "filtered"
    FIXED_LAG = "fixed_lag"
    SMOOTHED = "smoothed"


@dataclass(frozen=True, slots=True)
class ImuSamples:
    """Magnetometer and inertial samples on one time base.

    Attributes
    ----------
    t : array, shape (n,), s
        UTC seconds, strictly increasing.
    mag : array, shape (n, 3), uT, body frame
    acc : array, shape (n, 3), m/s^2, body frame
        Specific force (gravity included: at rest the reading points up).
    gyro : array, shape (n, 3), rad/s, body frame
    """

    t: Float64Array
    mag: Float64Array
    acc: Float64Array
    gyro: Float64Array

    def __post_init__(self) -> None:
        n = self.t.shape[0] if self.t.ndim == 1 else -1
        if n < 0:
            raise InputError("t", f"needs shape (n,), got {self.t.shape}")
        for name in ("mag", "acc", "gyro"):
            shape = getattr(self, name).shape
            if shape != (n, 3):
                raise InputError(name, f"needs shape ({n}, 3), got {shape}")

    def __len__(self) -> int:
        return int(self.t.shape[0])


@dataclass(frozen=True, slots=True)
class RadioScans:
    """Wi-Fi or BLE readings: one row per access point seen.

    Attributes
    ----------
    t : array, shape (m,), s
        UTC seconds at which the access point was last seen.
    address : tuple of str, length m
    rssi : array, shape (m,), dBm
    """

    t: Float64Array
    address: tuple[str, ...]
    rssi: Float64Array


@dataclass(frozen=True, slots=True)
class GnssFixes:
    """Satellite fixes: ``t`` (m,) s, ``x`` and ``y`` (m,) metres in the level frame, ``sd`` (m,) metres per axis."""

    t: Float64Array
    x: Float64Array
    y: Float64Array
    sd: Float64Array


@dataclass(frozen=True, slots=True)
class PressureReadings:
    """Barometer: ``t`` (m,) s, ``hpa`` (m,) hPa."""

    t: Float64Array
    hpa: Float64Array


@dataclass(frozen=True, slots=True)
class SpeedReadings:
    """Speed over ground from wheels or a vehicle bus: ``t`` (m,) s, ``speed`` (m,) m/s, negative backwards."""

    t: Float64Array
    speed: Float64Array


@dataclass(frozen=True, slots=True)
class StepCounts:
    """A device's own step counter: ``t`` (m,) s, ``count`` (m,) steps since any moment, never falling."""

    t: Float64Array
    count: Float64Array


@dataclass(frozen=True, slots=True)
class Segment:
    """One uploaded chunk of a session: samples and optional aids."""

    samples: ImuSamples
    wifi: RadioScans | None = None
    ble: RadioScans | None = None
    gnss: GnssFixes | None = None
    pressure: PressureReadings | None = None
    speed: SpeedReadings | None = None
    steps: StepCounts | None = None


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Labelled positions of a survey walk: ``t`` (m,) s, ``x`` and ``y`` (m,) metres, level frame."""

    t: Float64Array
    x: Float64Array
    y: Float64Array

    def __len__(self) -> int:
        return int(self.t.shape[0])


@dataclass(frozen=True, slots=True)
class SurveyWalk:
    """Samples with known positions.

    Attributes
    ----------
    walk_id : str
    samples : ImuSamples
    waypoints : Waypoints
        At least two, strictly increasing in time.
    wifi : RadioScans or None
    device_heading : float or None, rad, level frame
        Mean direction of the device's y axis, counter-clockwise from +x, where the surveyor kept it apart from the
        direction of motion (a trolley pushed sideways, a phone that points one way on every line). None: along the
        motion, give or take how it was held.
    """

    walk_id: str
    samples: ImuSamples
    waypoints: Waypoints
    wifi: RadioScans | None = None
    device_heading: float | None = None
    ble: RadioScans | None = None


Int8Array = NDArray[np.int8]
Int16Array = NDArray[np.int16]
Int32Array = NDArray[np.int32]
UInt8Array = NDArray[np.uint8]


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


SOFT_IRON_UNKNOWN = 0.04
"""Standard deviation of an element of a device's soft iron, over devices whose platform calibrates them."""
SixFloats = tuple[float, float, float, float, float, float]
_UNKNOWN_SIX = (SOFT_IRON_UNKNOWN,) * 6


@dataclass(frozen=True, slots=True)
class DeviceCalibration:
    """What earlier sessions taught about a device, with how well it is known.

    Attributes
    ----------
    offset, offset_sd : tuple of three floats, uT
        Hard iron left by the platform's calibration, levelled device frame (forward, left, up).
    stride_scale, stride_scale_sd : float
        Stride of the carrier over that of the stride model.
    soft_iron, soft_iron_sd : tuple of six floats
        Elements forward-forward, left-left, up-up, forward-left, forward-up, left-up of the symmetric matrix ``S``,
        same frame: a true field ``m`` reads ``(I + S) m + offset``. As they are by default, nothing is known of them.
    """

    offset: tuple[float, float, float]
    offset_sd: tuple[float, float, float]
    stride_scale: float
    stride_scale_sd: float
    soft_iron: SixFloats = (0.0,) * 6
    soft_iron_sd: SixFloats = _UNKNOWN_SIX


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before the first segment.

    ``level_id`` None means any of the levels that the map source has.

    ``x`` and ``y`` are both given (a disc of ``radius_m``, uniform inside) or both None (anywhere on the
    level). ``heading`` is the direction of the device's y axis in the level frame, radians
    counter-clockwise from +x; None means unknown. ``calibration`` is what is known about the device.
    """

    level_id: str | None
    x: float | None = None
    y: float | None = None
    radius_m: float = 3.0
    heading: float | None = None
    heading_sd: float = 0.35
    calibration: DeviceCalibration | None = None

    def __post_init__(self) -> None:
        if (self.x is None) != (self.y is None):
            raise InputError("prior", "x and y must be given together or not at all")
        if self.level_id is None and self.x is not None:
            raise InputError("prior", "x and y mean nothing without a level")


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One of several places that fit: level, position (m, level frame), covariance (m^2), probability of being right.

    What the weights of all hypotheses lack of one is for places not listed.
    """

    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    weight: float


@dataclass(frozen=True, slots=True)
class Fix:
    """One position.

    Attributes
    ----------
    t : float, s
        UTC seconds. A ``filtered`` fix uses samples up to ``t`` (and the few tenths of a second after it that
        confirm a step), never later ones.
    level_id : str
    x, y : float, m, level frame
    cov_xx, cov_xy, cov_yy : float, m^2
        Covariance whose 95 % ellipse (scale ``sqrt(5.991)``) is the promise.
    heading : float, rad
        Direction of motion, counter-clockwise from +x.
    status : Status
    quality : float
        0 (nothing known) to 1; ``sure`` marks fixes that may be acted on.
    sure : bool
    walk_on_m : float or None
        With ``insufficient``: about how many more metres are needed.
    hypotheses : tuple of Hypothesis
        While several places fit, the heaviest of them, heaviest first; given with the last fix of a segment. ``x`` and
        ``y`` are then the first one's, and the covariance is that of *all* places about it.
    kind : FixKind
        Which samples it rests on.
    """

    t: float
    level_id: str
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    heading: float
    status: Status
    quality: float
    sure: bool
    walk_on_m: float | None = None
    hypotheses: tuple[Hypothesis, ...] = ()
    kind: FixKind = FixKind.FILTERED


@dataclass(frozen=True, slots=True)
class TrackerState:
    """State of a tracker between two segments: opaque bytes that carry their own version.

    ``last_t`` is the time of the newest sample seen (None before the first).
    """

    method: str
    payload: bytes
    last_t: float | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """What a tracker makes of a segment.

    Attributes
    ----------
    state : TrackerState
        After the segment.
    fixes : tuple of Fix
        ``filtered``, in time order: those of :meth:`Tracker.step`.
    lagged : tuple of Fix
        ``fixed_lag``, in time order, within a segment and from one to the next: earlier steps, each told once and at
        most, now that more is known of them. Empty for methods that look back on nothing.
    """

    state: TrackerState
    fixes: tuple[Fix, ...]
    lagged: tuple[Fix, ...] = ()


class Tracker(Protocol):
    """A recursive method: state and segment in, state and fixes out.

    A tracker holds parameters only. The same state and segment always give the same answer (the random
    generator is part of the state), so any worker may take the next segment and may take it again
    after a crash.
    """

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        """State before the first segment."""
        ...

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment: a fix per step confirmed, and one at the time up to which steps are settled.

        Fixes are in time order, within a segment and from one to the next. A step takes its peak and 0.3 s to be
        confirmed, so the last fix lies that much before the segment's end.
        """
        ...

    def answer(self, state: TrackerState, segment: Segment, map_source: MapSource) -> Answer:
        """Advance like :meth:`step`, to the same state and fixes, and also look back."""
        ...

    def learned(self, state: TrackerState) -> DeviceCalibration | None:
        """What the session so far teaches about the device; None while it is not to be relied on."""
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
    """A built map and the report about it."""

    grid_map: GridMap
    walks: tuple[WalkReport, ...]
    n_samples: int
    length_scale_m: float
    field_sd: tuple[float, ...]
    parameters: dict[str, float] = field(default_factory=dict)
