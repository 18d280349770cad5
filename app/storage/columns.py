"""Samples as compressed columns.

A blob is a header (magic, version, kind, rows) and one zlib stream. Times keep every bit: the bit patterns of the
float64 values are differenced twice as integers, which is exact and leaves an even clock as zeros. Sensor values are
float32, what phones deliver; uploads that carry more digits are rounded here. What comes with them (aids, waypoints)
keeps every bit. All columns are stored as byte planes (all first bytes, all second bytes, ...), which zlib packs better
than interleaved numbers.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from app.engine.types import (
    Float64Array,
    ImuSamples,
    PressureReadings,
    RadioScans,
    SpeedReadings,
    StepCounts,
    Waypoints,
)
from app.services.aids import Aids, GnssReadings

_HEADER = struct.Struct("<2sBBI")
_MAGIC = b"IC"
_VERSION = 1
_SAMPLES, _SCANS, _WAYPOINTS, _GNSS, _PRESSURE, _SPEED, _STEPS = range(1, 8)
_LEVEL = 1  # the next levels save 2 % and cost twice the time; this runs on the way of every segment
_SENSORS = 9

Number = TypeVar("Number", bound=np.generic)


class ColumnsError(ValueError):
    """A blob that is damaged or of another version."""


def encode_samples(samples: ImuSamples) -> bytes:
    """Samples as a blob; sensor values are rounded to float32."""
    sensors = np.empty((_SENSORS, len(samples)), dtype="<f4")
    sensors[0:3] = samples.mag.T
    sensors[3:6] = samples.acc.T
    sensors[6:9] = samples.gyro.T
    return _pack(_SAMPLES, len(samples), _time_planes(samples.t), _planes(sensors))


def decode_samples(blob: bytes) -> ImuSamples:
    """Inverse of :func:`encode_samples`."""
    n, payload = _unpack(_SAMPLES, blob)
    _check_size(payload, n * (8 + 4 * _SENSORS))
    sensors = _from_planes(payload[8 * n :], "<f4", _SENSORS, n).astype(np.float64)
    mag, acc, gyro = (np.ascontiguousarray(sensors[i : i + 3].T) for i in (0, 3, 6))
    return ImuSamples(t=_times(payload[: 8 * n], n), mag=mag, acc=acc, gyro=gyro)


def encode_scans(scans: RadioScans) -> bytes:
    """Radio scans as a blob; each address is stored once."""
    addresses = {address: i for i, address in enumerate(dict.fromkeys(scans.address))}
    names = "\0".join(addresses).encode()
    index = np.array([[addresses[address] for address in scans.address]], dtype="<u4")
    rssi = np.asarray(scans.rssi, dtype="<f8")[np.newaxis]
    size = struct.pack("<I", len(names))
    return _pack(_SCANS, len(scans.address), _time_planes(scans.t), _planes(rssi), _planes(index), size, names)


def decode_scans(blob: bytes) -> RadioScans:
    """Inverse of :func:`encode_scans`."""
    n, payload = _unpack(_SCANS, blob)
    ends = np.cumsum([8 * n, 8 * n, 4 * n, 4])
    if len(payload) < ends[-1]:
        raise ColumnsError("scans are cut short")
    rssi = _from_planes(payload[ends[0] : ends[1]], "<f8", 1, n)[0].astype(np.float64)
    index = _from_planes(payload[ends[1] : ends[2]], "<u4", 1, n)[0]
    (size,) = struct.unpack("<I", payload[ends[2] : ends[3]])
    _check_size(payload, int(ends[-1]) + size)
    names = payload[ends[-1] :].decode().split("\0")
    return RadioScans(t=_times(payload[: 8 * n], n), address=tuple(names[i] for i in index), rssi=rssi)


def encode_waypoints(waypoints: Waypoints) -> bytes:
    """Waypoints as a blob."""
    return _encode_readings(_WAYPOINTS, waypoints.t, waypoints.x, waypoints.y)


def decode_waypoints(blob: bytes) -> Waypoints:
    """Inverse of :func:`encode_waypoints`."""
    return Waypoints(*_decode_readings(_WAYPOINTS, blob, 2))


def encode_gnss(gnss: GnssReadings) -> bytes:
    """Satellite fixes as a blob."""
    return _encode_readings(_GNSS, gnss.t, gnss.latitude_deg, gnss.longitude_deg, gnss.accuracy_m)


def decode_gnss(blob: bytes) -> GnssReadings:
    """Inverse of :func:`encode_gnss`."""
    return GnssReadings(*_decode_readings(_GNSS, blob, 3))


def encode_pressure(pressure: PressureReadings) -> bytes:
    """Barometer readings as a blob."""
    return _encode_readings(_PRESSURE, pressure.t, pressure.hpa)


def decode_pressure(blob: bytes) -> PressureReadings:
    """Inverse of :func:`encode_pressure`."""
    return PressureReadings(*_decode_readings(_PRESSURE, blob, 1))


def encode_speed(speed: SpeedReadings) -> bytes:
    """Speeds as a blob."""
    return _encode_readings(_SPEED, speed.t, speed.speed)


def decode_speed(blob: bytes) -> SpeedReadings:
    """Inverse of :func:`encode_speed`."""
    return SpeedReadings(*_decode_readings(_SPEED, blob, 1))


def encode_steps(steps: StepCounts) -> bytes:
    """Step counts as a blob."""
    return _encode_readings(_STEPS, steps.t, steps.count)


def decode_steps(blob: bytes) -> StepCounts:
    """Inverse of :func:`encode_steps`."""
    return StepCounts(*_decode_readings(_STEPS, blob, 1))


def encode_aids(aids: Aids) -> dict[str, bytes | None]:
    """A blob for each aid, by its name; None where nothing was sent."""
    given = {name: getattr(aids, name) for name in AID_COLUMNS}
    return {name: None if aid is None else _AIDS[name][0](aid) for name, aid in given.items()}


def decode_aids(blobs: Mapping[str, bytes | None]) -> Aids:
    """Inverse of :func:`encode_aids`; other entries of ``blobs`` do not matter."""
    given = {name: blobs[name] for name in AID_COLUMNS}
    return Aids(**{name: None if blob is None else _AIDS[name][1](blob) for name, blob in given.items()})


_AIDS: Mapping[str, tuple[Callable[[Any], bytes], Callable[[bytes], Any]]] = {
    "wifi": (encode_scans, decode_scans),
    "ble": (encode_scans, decode_scans),
    "gnss": (encode_gnss, decode_gnss),
    "pressure": (encode_pressure, decode_pressure),
    "speed": (encode_speed, decode_speed),
    "steps": (encode_steps, decode_steps),
}
AID_COLUMNS = tuple(_AIDS)
"""Names of the aids' columns, those of the fields of :class:`app.services.aids.Aids`."""


def _encode_readings(kind: int, t: Float64Array, *columns: Float64Array) -> bytes:
    return _pack(kind, len(t), _time_planes(t), _planes(np.stack(columns).astype("<f8")))


def _decode_readings(kind: int, blob: bytes, k: int) -> tuple[Float64Array, ...]:
    """Times and ``k`` columns."""
    n, payload = _unpack(kind, blob)
    _check_size(payload, 8 * n * (1 + k))
    columns = _from_planes(payload[8 * n :], "<f8", k, n).astype(np.float64)
    return (_times(payload[: 8 * n], n), *columns)


def _pack(kind: int, n: int, *parts: bytes) -> bytes:
    return _HEADER.pack(_MAGIC, _VERSION, kind, n) + zlib.compress(b"".join(parts), _LEVEL)


def _unpack(kind: int, blob: bytes) -> tuple[int, bytes]:
    if len(blob) < _HEADER.size:
        raise ColumnsError("shorter than its header")
    magic, version, found, n = _HEADER.unpack_from(blob)
    if (magic, version, found) != (_MAGIC, _VERSION, kind):
        raise ColumnsError(f"header {magic!r} version {version} kind {found} is not {_MAGIC!r} {_VERSION} {kind}")
    try:
        return n, zlib.decompress(memoryview(blob)[_HEADER.size :])
    except zlib.error as error:
        raise ColumnsError(f"damaged: {error}") from error


def _check_size(payload: bytes, expected: int) -> None:
    if len(payload) != expected:
        raise ColumnsError(f"holds {len(payload)} bytes, not {expected}")


def _planes(columns: NDArray[Number]) -> bytes:
    """Byte planes of each row of ``columns``, shape (k, n)."""
    k, n = columns.shape
    return columns.view(np.uint8).reshape(k, n, columns.itemsize).transpose(0, 2, 1).tobytes()


def _from_planes(data: bytes, dtype: str, k: int, n: int) -> NDArray[np.generic]:
    itemsize = np.dtype(dtype).itemsize
    planes = np.frombuffer(data, dtype=np.uint8).reshape(k, itemsize, n)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype).reshape(k, n)


def _time_planes(t: Float64Array) -> bytes:
    bits = np.ascontiguousarray(t, dtype="<f8").view("<i8")
    second = np.diff(np.diff(bits, prepend=np.int64(0)), prepend=np.int64(0))  # wraps around, exactly invertible
    zigzag = (second << 1) ^ (second >> 63)  # small negative numbers have small codes, too
    return _planes(zigzag[np.newaxis])


def _times(data: bytes, n: int) -> Float64Array:
    zigzag = _from_planes(data, "<u8", 1, n)[0].astype(np.uint64)
    second = (zigzag >> np.uint64(1)).astype(np.int64) ^ -(zigzag & np.uint64(1)).astype(np.int64)
    bits: NDArray[np.int64] = np.cumsum(np.cumsum(second, dtype=np.int64), dtype=np.int64)
    return bits.view(np.float64)
