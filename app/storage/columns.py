"""Samples as compressed columns.

A blob is a header (magic, version, kind, rows) and one zlib stream. Times keep every bit: the bit patterns of the
float64 values are differenced twice as integers, which is exact and leaves an even clock as zeros. Sensor values are
float32, what phones deliver; uploads that carry more digits are rounded here. All columns are stored as byte
planes (all first bytes, all second bytes, ...), which zlib packs better than interleaved numbers.
"""

from __future__ import annotations

import struct
import zlib
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from app.engine.types import Float64Array, ImuSamples, RadioScans, Waypoints

_HEADER = struct.Struct("<2sBBI")
_MAGIC = b"IC"
_VERSION = 1
_SAMPLES, _SCANS, _WAYPOINTS = 1, 2, 3
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
    """Waypoints as a blob, exact."""
    positions = np.stack([waypoints.x, waypoints.y]).astype("<f8")
    return _pack(_WAYPOINTS, len(waypoints), _time_planes(waypoints.t), _planes(positions))


def decode_waypoints(blob: bytes) -> Waypoints:
    """Inverse of :func:`encode_waypoints`."""
    n, payload = _unpack(_WAYPOINTS, blob)
    _check_size(payload, 24 * n)
    positions = _from_planes(payload[8 * n :], "<f8", 2, n).astype(np.float64)
    return Waypoints(t=_times(payload[: 8 * n], n), x=positions[0], y=positions[1])


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
