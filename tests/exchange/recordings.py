"""Recordings as other programs write them, of simulated walks."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cache

import numpy as np

from app.engine.geodesy import TangentPlane
from app.engine.types import SurveyWalk
from tests.support.walks import Field, survey_of, walk_through

PLANE = TangentPlane(48.15, 11.57)
RNG = np.random.default_rng(11)
CORNERS = np.array([[2.0, 3.0], [14.0, 3.0], [14.0, 11.0]])
WALK: SurveyWalk = survey_of(walk_through(CORNERS, Field.random(RNG), RNG), "walk", every_s=4.0)
SENSORS = ("mag", "acc", "gyro")


@cache
def plain_csv() -> bytes:
    """The walk with plain names and units; made once."""
    return csv_of()


def csv_of(
    walk: SurveyWalk = WALK,
    *,
    header: Sequence[str] | None = None,
    factors: dict[str, float] | None = None,
    plane: TangentPlane | None = None,
    delimiter: str = ",",
    time: str = "s",
    filled: bool = False,
) -> bytes:
    """Rows of samples, with a position in the row next to each waypoint (or filled in below it)."""
    samples, points = walk.samples, walk.waypoints
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6}[time]
    places: dict[int, tuple[float, float]] = {}
    for t, x, y in zip(points.t, points.x, points.y, strict=True):
        lon_lat = None if plane is None else plane.to_wgs84(float(x), float(y))
        row = int(np.abs(samples.t - t).argmin())
        places[row] = (float(x), float(y)) if lon_lat is None else (lon_lat[1], lon_lat[0])
    names = ["t", *(("x", "y") if plane is None else ("lat", "lon"))]
    names += [f"{sensor}_{axis}" for sensor in SENSORS for axis in "xyz"]
    out = io.StringIO()
    out.write(delimiter.join(header or names) + "\n")
    last: tuple[float, float] | None = None
    for i, t in enumerate(samples.t):
        last = places.get(i, last if filled else None)
        cells = [repr(float(t * scale)), *(("", "") if last is None else map(repr, last))]
        for sensor in SENSORS:
            factor = (factors or {}).get(sensor, 1.0)
            cells += [f"{value * factor:.9g}" for value in getattr(samples, sensor)[i]]
        out.write(delimiter.join(cells) + "\n")
    return out.getvalue().encode()


def log_of(
    walk: SurveyWalk = WALK,
    plane: TangentPlane = PLANE,
    *,
    sensor_origin: float = 51_000.0,
    delays: float = 0.02,
    floors: Sequence[float] | None = None,
    date: str | None = "Thu Jul 25 15:59:43 CEST 2019",
    seed: int = 3,
) -> bytes:
    """A GetSensorData log: sensors with clocks of their own and late by ``delays`` s (mean), at different rates."""
    rng = np.random.default_rng(seed)
    samples, points = walk.samples, walk.waypoints
    start = samples.t[0]
    lines: list[tuple[float, str]] = []
    for kind, sensor, every, shift in (("MAGN", "mag", 1, 0.0), ("ACCE", "acc", 1, 0.004), ("GYRO", "gyro", 2, 0.007)):
        t = samples.t[::every] - start + shift
        values = np.stack([np.interp(t + start, samples.t, getattr(samples, sensor)[:, i]) for i in range(3)], axis=1)
        for one, row in zip(t, values, strict=True):
            app = one + 1e-4 + rng.exponential(delays)
            reading = ";".join(f"{value:.5f}" for value in row)
            lines.append((app, f"{kind};{app:.3f};{one + sensor_origin:.5f};{reading};3"))
    for k, (t, x, y) in enumerate(zip(points.t, points.x, points.y, strict=True)):
        lon, lat = plane.to_wgs84(float(x), float(y))
        floor = 2.0 if floors is None else floors[k]
        lines.append((t - start, f"POSI;{t - start:.3f};{k + 1};{lat:.9f};{lon:.9f};{floor:g};1"))
    end = float(samples.t[-1] - start)
    for i, t in enumerate(np.arange(0.5, end, 4.0)):
        lines.append((t, f"WIFI;{t:.3f};{t + sensor_origin:.3f};cafe;bar;a4:2b:8c:91:{i % 5:02x}:f7;2437;-6{i % 9}"))
        lines.append((t, f"BLE4;{t:.3f};iBeacon;C0:FF:EE:00:00:{i % 3:02X};-7{i % 9};-59;10;7;fda50693"))
        lines.append((t, f"PRES;{t:.3f};{t + sensor_origin:.3f};954.2;0"))
    head = ["% LogFile created by the 'GetSensorData' App for Android."]
    head += [f"% Date of creation: {date}"] if date else []
    head.append("% MAGN data: 'MAGN;AppTimestamp(s);SensorTimestamp(s);Mag_X(uT);;Mag_Y(uT);Mag_Z(uT);Accuracy'")
    return "\n".join([*head, *(line for _, line in sorted(lines))]).encode() + b"\n"
