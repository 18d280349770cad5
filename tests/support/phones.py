"""Phones: what their applications send and write of a walk, in the very formats."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from app.engine.types import Float64Array, ImuSamples, IntArray, Waypoints

NS = 1_000_000_000
GRAVITY = 9.80665
_SENSORS = ("magnetometer", "accelerometer", "gravity", "gyroscope")
_TABLES = {
    "magnetometer": "Magnetometer", "accelerometer": "Accelerometer", "gravity": "Gravity", "gyroscope": "Gyroscope",
    "barometer": "Barometer", "location": "Location", "pedometer": "Pedometer", "annotation": "Annotation",
    "magnetometeruncalibrated": "MagnetometerUncalibrated",
}  # fmt: skip


@dataclass(frozen=True)
class Phone:
    """How a phone tells its readings.

    Attributes
    ----------
    ios : bool
        Accelerometer and gravity with Apple's signs.
    asynchronous : bool
        Each sensor at times of its own (up to half a sample apart from the others', jittered); else all at the
        samples' times, and then what is read back are the samples.
    uncalibrated : bool
        The magnetometer tells uncalibrated readings only.
    barometer, location : mapping, times (s) to hPa, or to latitude, longitude and accuracy
    session_id, device_id : str
    seed : int
    """

    ios: bool = False
    asynchronous: bool = False
    uncalibrated: bool = False
    barometer: Mapping[float, float] = field(default_factory=dict)
    location: Mapping[float, tuple[float, float, float]] = field(default_factory=dict)
    session_id: str = "4f9c1a52-7f0e-4b9d-8a41-52c3c1f3a001"
    device_id: str = "b8a0d2c4-1111-4222-9333-a1b2c3d4e5f6"
    seed: int = 5

    def rows(
        self, samples: ImuSamples, waypoints: Waypoints | None = None, labels: Sequence[str] = ()
    ) -> list[tuple[int, str, dict[str, object]]]:
        """Time (ns), name and values of all readings, in time order; waypoints are annotations "x,y", or labels."""
        rng = np.random.default_rng(self.seed)
        rows: list[tuple[int, str, dict[str, object]]] = []
        for name, values in self._sensors(samples).items():
            t_ns = self._times(samples.t, rng)
            told = values if not self.asynchronous else at(t_ns / NS, samples.t, values)
            label = "magnetometeruncalibrated" if self.uncalibrated and name == "magnetometer" else name
            rows += [(int(t), label, xyz(row)) for t, row in zip(t_ns, told, strict=True)]
        rows += [(ns(t), "barometer", {"pressure": hpa, "relativeAltitude": 0.0}) for t, hpa in self.barometer.items()]
        for t, (latitude, longitude, accuracy) in self.location.items():
            place = {"latitude": latitude, "longitude": longitude, "horizontalAccuracy": accuracy, "speed": -1.0}
            rows.append((ns(t), "location", place))
        if waypoints is not None:
            texts = labels or [f"{x:.3f},{y:.3f}" for x, y in zip(waypoints.x, waypoints.y, strict=True)]
            for t, text in zip(waypoints.t, texts, strict=True):
                rows.append((ns(t), "annotation", {"text": text, "millisecond_press_duration": 80}))
        return sorted(rows, key=lambda row: row[0])

    def _sensors(self, samples: ImuSamples) -> dict[str, Float64Array]:
        sign = -1.0 if self.ios else 1.0
        gravity = sign * gravity_of(samples.acc)
        return {
            "magnetometer": samples.mag,
            "accelerometer": sign * samples.acc - gravity,
            "gravity": gravity,
            "gyroscope": samples.gyro,
        }

    def _times(self, t: Float64Array, rng: np.random.Generator) -> IntArray:
        whole = np.round(t * 1e6).astype(np.int64) * 1000
        if not self.asynchronous:
            return whole
        step = int(np.median(np.diff(whole)))
        shift = rng.integers(0, step // 2) + rng.integers(0, step // 5, len(whole))
        moved: IntArray = whole + shift
        return moved


def sensor_logger_messages(
    samples: ImuSamples,
    waypoints: Waypoints | None = None,
    *,
    phone: Phone = Phone(),
    labels: Sequence[str] = (),
    batch_s: float = 1.0,
    swapped: Sequence[int] = (),
    repeated: Sequence[int] = (),
) -> list[bytes]:
    """Push messages of Sensor Logger, one every ``batch_s`` seconds.

    Parameters
    ----------
    samples : ImuSamples
    waypoints : Waypoints or None
        Become annotations.
    phone : Phone
    labels : sequence of str
        Texts of the annotations, instead of "x,y".
    batch_s : float, s
    swapped : sequence of int
        Messages (by number) that arrive after the next one.
    repeated : sequence of int
        Messages that arrive twice.
    """
    rows = phone.rows(samples, waypoints, labels)
    batches: dict[int, list[dict[str, object]]] = {}
    for t_ns, name, values in rows:
        batch = int((t_ns - rows[0][0]) // int(batch_s * NS))
        batches.setdefault(batch, []).append({"name": name, "time": t_ns, "values": values, "accuracy": 3})
    bodies = [
        json.dumps(
            {"messageId": number, "sessionId": phone.session_id, "deviceId": phone.device_id, "payload": batches[one]}
        ).encode()
        for number, one in enumerate(sorted(batches))
    ]
    order = list(range(len(bodies)))
    for one in swapped:
        order[one], order[one + 1] = order[one + 1], order[one]
    return [bodies[one] for place in order for one in [place] * (1 + (place in repeated))]


def sensor_logger_zip(
    samples: ImuSamples,
    waypoints: Waypoints | None = None,
    *,
    phone: Phone = Phone(),
    labels: Sequence[str] = (),
    standardised: bool = False,
    metadata: bool = True,
) -> bytes:
    """An export of Sensor Logger: a zip file of CSV tables. A phone that standardises tells Android's signs."""
    told = Phone(**{**vars(phone), "ios": phone.ios and not standardised})
    rows = told.rows(samples, waypoints, labels)
    tables: dict[str, list[str]] = {}
    for t_ns, name, values in rows:
        columns = list(values)[::-1]
        lines = tables.setdefault(name, [",".join(["time", "seconds_elapsed", *columns])])
        cells = [f'"{values[one]}"' if one == "text" else str(values[one]) for one in columns]
        lines.append(",".join([str(t_ns), f"{(t_ns - rows[0][0]) / NS:.6f}", *cells]))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, lines in tables.items():
            archive.writestr(f"{_TABLES[name]}.csv", "\n".join(lines) + "\n")
        archive.writestr("Battery.csv", f"time,seconds_elapsed,batteryLevel\n{rows[0][0]},0,0.9\n")
        if metadata:
            archive.writestr("Metadata.csv", _metadata(rows[0][0], ios=phone.ios, standardised=standardised))
    return out.getvalue()


def sensor_logger_json(
    samples: ImuSamples,
    waypoints: Waypoints | None = None,
    *,
    phone: Phone = Phone(),
) -> bytes:
    """A JSON export of Sensor Logger: an array of flat objects of texts."""
    rows = phone.rows(samples, waypoints)
    flat = [
        {
            "sensor": _TABLES[name],
            "time": str(t_ns),
            "seconds_elapsed": str((t_ns - rows[0][0]) / NS),
            **{key: str(value) for key, value in values.items()},
        }
        for t_ns, name, values in rows
    ]
    return json.dumps(flat).encode()


def _metadata(t_ns: int, *, ios: bool, standardised: bool) -> str:
    names = (
        "version,device name,recording epoch time,recording time,recording timezone,platform,appVersion,standardisation"
    )
    values = [3, "A phone", t_ns // 1_000_000, "2023-11-14_22-13-20", "Europe/Berlin", "ios" if ios else "android"]
    return f"{names}\n{','.join(map(str, values))},1.63,{str(standardised).lower()}\n"


def gravity_of(acc: Float64Array) -> Float64Array:
    """Gravity as phones estimate it: the direction of the smoothed specific force."""
    kernel = np.ones(min(51, len(acc))) / min(51, len(acc))
    smooth = np.stack([np.convolve(acc[:, i], kernel, mode="same") for i in range(3)], axis=1)
    gravity: Float64Array = GRAVITY * smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
    return gravity


def at(t: Float64Array, times: Float64Array, values: Float64Array) -> Float64Array:
    """Columns interpolated at other times."""
    return np.stack([np.interp(t, times, values[:, i]) for i in range(values.shape[1])], axis=1)


def xyz(row: Float64Array) -> dict[str, object]:
    """A reading of three axes."""
    return {axis: float(value) for axis, value in zip("xyz", row, strict=True)}


def ns(t: float) -> int:
    """Seconds to nanoseconds, to the microsecond."""
    return round(t * 1e6) * 1000


PAUSE_S = 40.0
"""Between the two runs of an experiment that was paused."""


def phyphox_bodies(
    samples: ImuSamples, *, ios: bool = False, interval_s: float = 1.0, timed: bool = True, pressure: bool = False
) -> list[bytes]:
    """What the experiment sends, one body every ``interval_s`` seconds; ``timed``: with the phone's clock."""
    start = float(samples.t[0]) - 0.2
    t = np.round(samples.t - start, 6)
    bodies = []
    for k in range(int(t[-1] // interval_s) + 1):
        rows = np.flatnonzero((t >= k * interval_s) & (t < (k + 1) * interval_s))
        body: dict[str, object] = {"uniqueID": "0123456789abcdef", "deviceModel": "iPhone12,1" if ios else "Pixel 6a"}
        for name, values in (("m", samples.mag), ("a", -samples.acc if ios else samples.acc), ("g", samples.gyro)):
            body |= {f"{name}{axis}": values[rows, i].tolist() for i, axis in enumerate("xyz")}
            body[f"{name}t"] = t[rows].tolist()
        if pressure:
            body |= {"p": [1003.25], "pt": [float(t[rows[0]])]}
        if timed:
            began = {"event": "START", "experimentTime": 0, "systemTime": round(start, 3)}
            body["time"] = {"now": start + (k + 1) * interval_s, "events": [began]}
        bodies.append(json.dumps(body).encode())
    return bodies


def phyphox_zip(
    samples: ImuSamples,
    *,
    ios: bool = False,
    delimiter: str = ",",
    decimal: str = ".",
    dated: bool = True,
    paused_at: int | None = None,
) -> bytes:
    """A CSV export of phyphox, one table a sensor; ``paused_at``: the experiment stood still before that sample."""
    start = round(float(samples.t[0]) - 0.5, 3)
    t = samples.t - start
    events = [("START", 0.0, start)]
    if paused_at is not None:
        t = np.where(np.arange(len(t)) >= paused_at, t - PAUSE_S, t)
        began = float(t[paused_at]) - 0.005
        events += [("PAUSE", began, start + began), ("START", began, start + began + PAUSE_S)]
    tables = {
        "Magnetometer": ("Magnetic Field {} (µT)", samples.mag),
        "Accelerometer": ("Acceleration {} (m/s^2)", -samples.acc if ios else samples.acc),
        "Gyroscope": ("Gyroscope {} (rad/s)", samples.gyro),
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, (label, values) in tables.items():
            labels = ["Time (s)", *(label.format(axis) for axis in "xyz"), "Absolute (x)"]
            lines = [delimiter.join(f'"{one}"' for one in labels)]
            for at_s, row in zip(t, values, strict=True):
                cells = [at_s, *row, float(np.linalg.norm(row))]
                lines.append(delimiter.join(f"{one:.9E}".replace(".", decimal) for one in cells))
            archive.writestr(f"{name}.csv", "\n".join(lines) + "\n")
        model = "iPhone12,1" if ios else "Pixel 6a"
        archive.writestr("meta/device.csv", f'"property"{delimiter}"value"\n"deviceModel"{delimiter}"{model}"\n')
        if dated:
            rows = [
                delimiter.join([f'"{kind}"', f"{one:.9E}".replace(".", decimal), f"{system:.3f}".replace(".", decimal)])
                for kind, one, system in events
            ]
            archive.writestr("meta/time.csv", "\n".join([delimiter.join(['"event"', '"experiment time"']), *rows]))
    return out.getvalue()
