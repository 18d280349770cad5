"""Between the engine's types (seconds) and the client's (milliseconds)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from app.engine.types import Fix, FixKind, Float64Array, ImuSamples, Prior, RadioScans, Segment, Status, Waypoints

if TYPE_CHECKING:
    import isodyn_client as isodyn


def to_ms(t: Float64Array) -> Float64Array:
    """Seconds to milliseconds, to the microsecond: float64 seconds carry no more, and whole ones stay whole."""
    return np.round(t * 1000.0, 3)


def samples_of(samples: ImuSamples) -> isodyn.Samples:
    """Samples for an upload."""
    import isodyn_client as isodyn

    return isodyn.Samples(to_ms(samples.t), samples.mag, samples.acc, samples.gyro)


def wifi_of(scans: RadioScans | None) -> isodyn.WifiScans | None:
    """Wi-Fi readings for an upload."""
    import isodyn_client as isodyn

    return None if scans is None else isodyn.WifiScans(to_ms(scans.t), scans.address, scans.rssi)


def ble_of(scans: RadioScans | None) -> isodyn.BleScans | None:
    """BLE readings for an upload."""
    import isodyn_client as isodyn

    return None if scans is None else isodyn.BleScans(to_ms(scans.t), scans.address, scans.rssi)


def aids_of(segment: Segment) -> isodyn.Aids:
    """Aids of a segment for an upload.

    Satellite fixes stay behind: here they are in level metres, and the service takes degrees.
    """
    import isodyn_client as isodyn

    pressure, speed, steps = segment.pressure, segment.speed, segment.steps
    return isodyn.Aids(
        wifi=wifi_of(segment.wifi),
        ble=ble_of(segment.ble),
        pressure=None if pressure is None else isodyn.PressureReadings(to_ms(pressure.t), pressure.hpa),
        speed=None if speed is None else isodyn.SpeedReadings(to_ms(speed.t), speed.speed),
        steps=None if steps is None else isodyn.StepCounts(to_ms(steps.t), steps.count),
    )


def waypoints_of(waypoints: Waypoints) -> isodyn.Waypoints:
    """Labelled positions for an upload."""
    import isodyn_client as isodyn

    return isodyn.Waypoints(to_ms(waypoints.t), waypoints.x, waypoints.y)


def prior_of(prior: Prior) -> isodyn.Prior:
    """The engine's prior as the API takes it."""
    import isodyn_client as isodyn

    known_heading = prior.heading is not None
    return isodyn.Prior(
        x=prior.x,
        y=prior.y,
        radius_m=prior.radius_m,
        heading_deg=math.degrees(prior.heading) if prior.heading is not None else None,
        heading_sd_deg=math.degrees(prior.heading_sd) if known_heading else None,
    )


def fixes_from(fixes: isodyn.Fixes) -> tuple[Fix, ...]:
    """Fixes of an answer as the engine's."""
    return tuple(
        Fix(
            t=float(fixes.t_ms[i]) / 1000.0,
            level_id=fixes.level_id[i],
            x=float(fixes.x[i]),
            y=float(fixes.y[i]),
            cov_xx=float(fixes.cov_xx[i]),
            cov_xy=float(fixes.cov_xy[i]),
            cov_yy=float(fixes.cov_yy[i]),
            heading=math.radians(float(fixes.heading_deg[i])),
            status=Status(fixes.status[i].value),
            quality=float(fixes.quality[i]),
            sure=bool(fixes.sure[i]),
            walk_on_m=None if math.isnan(fixes.walk_on_m[i]) else float(fixes.walk_on_m[i]),
            kind=FixKind(fixes.kind[i].value),
        )
        for i in range(len(fixes))
    )
