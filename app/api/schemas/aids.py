"""Aids: what may come with samples. All are optional, and each has a time base of its own."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from app.api.schemas.columns import (
    AnyTimeColumn,
    BeaconColumn,
    BssidColumn,
    ColumnsIn,
    CountColumn,
    DegreeColumn,
    SensorColumn,
    TimeColumn,
)


class WifiIn(ColumnsIn):
    """Wi-Fi readings: one row per access point heard."""

    t_ms: AnyTimeColumn
    bssid: BssidColumn
    rssi: Annotated[SensorColumn, Field(description="dBm (msgpack: float32).")]


class BleIn(ColumnsIn):
    """BLE readings: one row per advertisement heard."""

    t_ms: AnyTimeColumn
    address: BeaconColumn
    rssi: Annotated[SensorColumn, Field(description="dBm (msgpack: float32).")]


class GnssIn(ColumnsIn):
    """Satellite fixes of the platform; the venue needs an anchor."""

    t_ms: TimeColumn
    latitude_deg: DegreeColumn
    longitude_deg: DegreeColumn
    accuracy_m: Annotated[
        SensorColumn,
        Field(description="Radius that holds the truth with 68 %, as Android reports it (msgpack: float32)."),
    ]


class PressureIn(ColumnsIn):
    """Barometer."""

    t_ms: TimeColumn
    hpa: Annotated[SensorColumn, Field(description="hPa, as measured (msgpack: float32).")]


class SpeedIn(ColumnsIn):
    """Speed over ground, from wheels or a vehicle bus."""

    t_ms: TimeColumn
    speed_m_s: Annotated[SensorColumn, Field(description="m/s, negative backwards (msgpack: float32).")]


class StepsIn(ColumnsIn):
    """The device's own step counter."""

    t_ms: TimeColumn
    count: Annotated[CountColumn, Field(description="Steps since any moment (msgpack: float64).")]


class AidsIn(ColumnsIn):
    """What may come with samples."""

    wifi: WifiIn | None = None
    ble: BleIn | None = None
    gnss: GnssIn | None = None
    pressure: PressureIn | None = None
    speed: SpeedIn | None = None
    steps: StepsIn | None = None


_T_MS = 1764000000000
AIDS_EXAMPLE: dict[str, Any] = {
    "wifi": {"t_ms": [_T_MS], "bssid": ["a4:2b:8c:00:11:22"], "rssi": [-61]},
    "ble": {"t_ms": [_T_MS, _T_MS + 12], "address": ["c0:ff:ee:00:00:01", "c0:ff:ee:00:00:02"], "rssi": [-70, -83]},
    "gnss": {"t_ms": [_T_MS], "latitude_deg": [48.15071], "longitude_deg": [11.56925], "accuracy_m": [12.5]},
    "pressure": {"t_ms": [_T_MS, _T_MS + 200], "hpa": [953.21, 953.19]},
    "speed": {"t_ms": [_T_MS, _T_MS + 100], "speed_m_s": [1.31, 1.33]},
    "steps": {"t_ms": [_T_MS], "count": [5120]},
}
