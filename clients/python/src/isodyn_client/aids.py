"""What may come with samples: radio readings, satellite fixes, pressure, speed, step counts. numpy in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from isodyn_client.arrays import Float64Array, store, vector

SLACK_MS = 10_000.0
"""The service takes readings so far outside the time of the samples they come with (Wi-Fi: any)."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Base of all aids: columns of one length, ``t_ms`` (Unix ms) first. Only lengths are checked here."""

    t_ms: Float64Array

    def __post_init__(self) -> None:
        store(self, "t_ms", vector("t_ms", self.t_ms))
        for name in self._names():
            value = getattr(self, name)
            if name in _TEXTS:
                store(self, name, tuple(value))
                if len(value) != len(self.t_ms):
                    raise ValueError(f"{name} needs {len(self.t_ms)} entries, got {len(value)}")
            else:
                store(self, name, vector(name, value, len(self.t_ms)))

    def __len__(self) -> int:
        return len(self.t_ms)

    def between(self, start_ms: float, stop_ms: float) -> Self:
        """Readings with ``start_ms <= t_ms < stop_ms``."""
        keep = np.flatnonzero((self.t_ms >= start_ms) & (self.t_ms < stop_ms))
        rest = {
            name: tuple(value[i] for i in keep) if name in _TEXTS else value[keep]
            for name, value in ((name, getattr(self, name)) for name in self._names())
        }
        return type(self)(self.t_ms[keep], **rest)

    def columns(self) -> dict[str, Any]:
        """Columns as lists, as an upload names them."""
        values = {name: getattr(self, name) for name in ("t_ms", *self._names())}
        return {name: list(value) if name in _TEXTS else value.tolist() for name, value in values.items()}

    def _names(self) -> tuple[str, ...]:
        """Columns beside the time."""
        return tuple(field.name for field in fields(self) if field.name != "t_ms")


_TEXTS = frozenset({"bssid", "address"})


@dataclass(frozen=True, slots=True, eq=False)
class WifiScans(Readings):
    """Wi-Fi readings: one row per access point heard.

    Parameters
    ----------
    t_ms : array, shape (m,), Unix ms
        When the access point was last heard, in any order.
    bssid : sequence of str, length m
    rssi : array, shape (m,), dBm
    """

    bssid: Sequence[str]
    rssi: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class BleScans(Readings):
    """BLE readings: one row per advertisement heard.

    Parameters
    ----------
    t_ms : array, shape (m,), Unix ms
        In any order.
    address : sequence of str, length m
        What names the transmitter for good: a MAC address that does not change, or a beacon's UUID with its numbers.
    rssi : array, shape (m,), dBm
    """

    address: Sequence[str]
    rssi: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class GnssFixes(Readings):
    """Satellite fixes of the platform; the venue needs an anchor.

    Parameters
    ----------
    t_ms : array, shape (m,), Unix ms, strictly increasing
    latitude_deg, longitude_deg : array, shape (m,), WGS 84
    accuracy_m : array, shape (m,), m
        Radius that holds the truth with 68 %, as Android reports it.
    """

    latitude_deg: Float64Array
    longitude_deg: Float64Array
    accuracy_m: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class PressureReadings(Readings):
    """Barometer: ``t_ms`` (m,) Unix ms, strictly increasing; ``hpa`` (m,) hPa."""

    hpa: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class SpeedReadings(Readings):
    """Speed of wheels or a vehicle bus: ``t_ms`` (m,), strictly increasing; ``speed_m_s`` (m,), negative backwards."""

    speed_m_s: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class StepCounts(Readings):
    """The device's own step counter: ``t_ms`` (m,), strictly increasing; ``count`` (m,), never falling."""

    count: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class Aids:
    """What may come with samples; all optional.

    >>> import numpy as np
    >>> Aids(pressure=PressureReadings(np.array([1.764e12]), hpa=np.array([953.2]))).names
    ('pressure',)
    """

    wifi: WifiScans | None = None
    ble: BleScans | None = None
    gnss: GnssFixes | None = None
    pressure: PressureReadings | None = None
    speed: SpeedReadings | None = None
    steps: StepCounts | None = None

    @classmethod
    def from_columns(cls, body: Mapping[str, Any]) -> Self:
        """Aids in the body of an upload; what else is in it does not matter."""
        given: dict[str, Any] = {name: kind(**body[name]) for name, kind in _KINDS.items() if body.get(name)}
        return cls(**given)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of those that have rows."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name))

    def columns(self) -> dict[str, dict[str, Any]]:
        """Those that have rows, as an upload names them."""
        return {name: getattr(self, name).columns() for name in self.names}

    def heard(self, after_ms: float, start_ms: float, until_ms: float) -> Aids:
        """What goes with samples from ``start_ms`` on when everything before ``after_ms`` was sent already.

        Readings up to ``until_ms``; of those that are older than the samples the service takes 10 s, of Wi-Fi all.
        """
        recent = max(after_ms, start_ms - SLACK_MS)
        parts = {
            name: getattr(self, name).between(after_ms if name == "wifi" else recent, until_ms) for name in self.names
        }
        return Aids(**parts)


_KINDS: dict[str, type[Readings]] = {
    "wifi": WifiScans,
    "ble": BleScans,
    "gnss": GnssFixes,
    "pressure": PressureReadings,
    "speed": SpeedReadings,
    "steps": StepCounts,
}
NO_AIDS = Aids()
