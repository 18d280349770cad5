"""What a matcher is given: a field along a track, a map, and what is known before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.engine.errors import InputError
from app.engine.types import FeatureSet, Float64Array, GridMap


@dataclass(frozen=True, slots=True)
class Profile:
    """Field along a track.

    Attributes
    ----------
    features : FeatureSet
    values : array, shape (n, channels), uT
        ``vector``: x, y, z of the level frame *as the track's headings have it*; turning the track turns x and y.
    noise_sd : array, shape (channels,), uT
        White noise of a reading.
    offset_sd : float, uT
        How well the sensor is calibrated: standard deviation of what all readings of a channel have in common; 0 for a
        sensor without offset.
    """

    features: FeatureSet
    values: Float64Array
    noise_sd: Float64Array
    offset_sd: float = 0.0

    def __post_init__(self) -> None:
        channels = len(self.features.channels)
        if self.values.ndim != 2 or self.values.shape[1] != channels:
            raise InputError("profile", f"needs shape (n, {channels}), got {self.values.shape}")
        if self.noise_sd.shape != (channels,):
            raise InputError("profile", f"needs one noise_sd for each of {channels} channels")
        if not np.all(np.isfinite(self.values)):
            raise InputError("profile", "holds values that are not finite")

    def __len__(self) -> int:
        return int(self.values.shape[0])

    def turned(self, angle: float) -> Profile:
        """The profile with its vectors turned counter-clockwise by ``angle`` (rad) about the vertical."""
        if self.features is not FeatureSet.VECTOR or angle == 0.0:
            return self
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = self.values.T
        return replace(self, values=np.stack([c * x - s * y, s * x + c * y, z], axis=1))

    def as_features(self, features: FeatureSet) -> Profile:
        """The profile in features that need less: from ``vector`` to ``hv`` to ``total``.

        Raises
        ------
        InputError
            They cannot be had of these.
        """
        if features is self.features:
            return self
        values, noise = reduce_features(self.values, self.noise_sd, self.features, features)
        return Profile(features, values, noise, self.offset_sd)


@dataclass(frozen=True, slots=True)
class Track:
    """Relative motion as dead reckoning indicates it, before it is located.

    Attributes
    ----------
    t : array, shape (n,), s
    x, y : array, shape (n,), m, level frame
        As indicated: begins where the region's centre is, or at the origin without a region.
    heading : array, shape (n,), rad
        Direction of motion at each point, counter-clockwise from +x.
    cov : array, shape (n, 2, 2), m^2
        Covariance of each point relative to the first: what the motion's errors have added up to.
    """

    t: Float64Array
    x: Float64Array
    y: Float64Array
    heading: Float64Array
    cov: Float64Array

    def __post_init__(self) -> None:
        n = len(self.t)
        for name in ("x", "y", "heading"):
            if getattr(self, name).shape != (n,):
                raise InputError("track", f"{name} needs shape ({n},), got {getattr(self, name).shape}")
        if self.cov.shape != (n, 2, 2):
            raise InputError("track", f"cov needs shape ({n}, 2, 2), got {self.cov.shape}")

    def __len__(self) -> int:
        return int(self.t.shape[0])

    @property
    def xy(self) -> Float64Array:
        """Positions, shape (n, 2), m."""
        return np.stack([self.x, self.y], axis=1)

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return float(np.hypot(np.diff(self.x), np.diff(self.y)).sum())

    @property
    def way(self) -> Float64Array:
        """Way from the first point on, shape (n,), m."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(self.x), np.diff(self.y)))])


@dataclass(frozen=True, slots=True)
class Region:
    """Where the track's first point is thought to be, and how well its shape is known.

    Attributes
    ----------
    x, y : float, m, level frame
    cov : array, shape (2, 2), m^2
    heading_sd : float, rad
        How far the whole track may be turned about its first point.
    scale_sd : float
        How far its strides or its speed may be off, as a part of one.
    """

    x: float
    y: float
    cov: Float64Array
    heading_sd: float = 0.1
    scale_sd: float = 0.1

    def half_widths(self, sigmas: float = 3.0) -> tuple[float, float]:
        """Half sides of the box that holds the ``sigmas`` ellipse, m."""
        return sigmas * float(np.sqrt(self.cov[0, 0])), sigmas * float(np.sqrt(self.cov[1, 1]))


@dataclass(frozen=True, slots=True)
class RouteMap:
    """Map along one line: a lane, a corridor, a survey walk. Walked either way.

    Attributes
    ----------
    spacing_m : float, m
        Between points, along the line.
    x, y : array, shape (m,), m, level frame
    mean, sd : array, shape (m, channels), uT
        ``vector`` is x, y, z of the level frame.
    features : FeatureSet
    """

    spacing_m: float
    x: Float64Array
    y: Float64Array
    mean: Float64Array
    sd: Float64Array
    features: FeatureSet

    def __len__(self) -> int:
        return int(self.x.shape[0])

    @property
    def direction(self) -> Float64Array:
        """Of the line at each point, rad, counter-clockwise from +x, shape (m,)."""
        if len(self) < 2:
            return np.zeros(len(self))
        return np.arctan2(np.gradient(self.y), np.gradient(self.x))

    def reversed(self) -> RouteMap:
        """The same line from its end to its beginning."""
        return replace(self, x=self.x[::-1], y=self.y[::-1], mean=self.mean[::-1], sd=self.sd[::-1])


@dataclass(frozen=True, slots=True)
class MatchProblem:
    """One question to a matcher.

    Attributes
    ----------
    profile : Profile
    track : Track
        As long as the profile.
    grid_map : GridMap
    region : Region or None
        None: anywhere on the map; the headings are the track's, give or take a compass error.
    routes : tuple of RouteMap
        Lines of the map that a sequence can be compared with; empty where it has none.
    deadline_s : float or None
        Seconds of this thread's processor time after which a search answers with what it has.
    seed : int
        Of all that is drawn: the same problem always has the same answer.
    """

    profile: Profile
    track: Track
    grid_map: GridMap
    region: Region | None = None
    routes: tuple[RouteMap, ...] = ()
    deadline_s: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if len(self.profile) != len(self.track):
            raise InputError("profile", f"has {len(self.profile)} readings for a track of {len(self.track)} points")

    def __len__(self) -> int:
        return len(self.track)


_ORDER = (FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL)


def reachable(have: FeatureSet, want: FeatureSet) -> None:
    """Refuse to make features of others that do not hold them.

    Raises
    ------
    InputError
        As when ``vector`` is wanted of ``total``.
    """
    if _ORDER.index(want) < _ORDER.index(have):
        raise InputError("features", f"{want} cannot be had from {have}")


def common_features(wanted: FeatureSet, *available: FeatureSet) -> FeatureSet:
    """The first of ``wanted``, ``hv``, ``total`` that all of ``available`` can give."""
    return _ORDER[max(_ORDER.index(one) for one in (wanted, *available))]


def reduce_features(
    values: Float64Array, sd: Float64Array, have: FeatureSet, want: FeatureSet
) -> tuple[Float64Array, Float64Array]:
    """Values and standard deviations (shape (..., channels)) in features that need less.

    Standard deviations are those of the first order: the root mean square of the parts, which have one size anyway.

    Raises
    ------
    InputError
        They cannot be had.
    """
    reachable(have, want)
    if have is want:
        return values, sd
    if have is FeatureSet.VECTOR and want is FeatureSet.HV:
        horizontal = np.hypot(values[..., 0], values[..., 1])
        spread = np.sqrt(0.5 * (sd[..., 0] ** 2 + sd[..., 1] ** 2))
        return np.stack([horizontal, values[..., 2]], axis=-1), np.stack([spread, sd[..., 2]], axis=-1)
    total = np.sqrt((values**2).sum(axis=-1, keepdims=True))
    return total, np.sqrt((sd**2).mean(axis=-1, keepdims=True))
