"""What is recorded: samples, aids, waypoints, survey walks."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.errors import InputError
from app.engine.types.arrays import Float64Array


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
