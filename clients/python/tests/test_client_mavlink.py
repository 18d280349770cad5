"""MAVLink 2: known checksums, a decoder written from the definition, and nothing told that is not known."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client.bridges.mavlink import CRC_EXTRA, MESSAGE_ID, GpsInput, MavlinkEncoder, crc16, frame, gps_time
from test_client_nmea import FIX

# The definition in common.xml: fields in its order, the extension last.
FIELDS = [
    ("uint64_t", "time_usec"), ("uint8_t", "gps_id"), ("uint16_t", "ignore_flags"), ("uint32_t", "time_week_ms"),
    ("uint16_t", "time_week"), ("uint8_t", "fix_type"), ("int32_t", "lat"), ("int32_t", "lon"), ("float", "alt"),
    ("float", "hdop"), ("float", "vdop"), ("float", "vn"), ("float", "ve"), ("float", "vd"),
    ("float", "speed_accuracy"), ("float", "horiz_accuracy"), ("float", "vert_accuracy"),
    ("uint8_t", "satellites_visible"),
]  # fmt: skip
EXTENSIONS = [("uint16_t", "yaw")]
CODES = {"uint64_t": "Q", "uint32_t": "I", "int32_t": "i", "float": "f", "uint16_t": "H", "uint8_t": "B"}


def on_the_wire() -> list[tuple[str, str]]:
    """Larger types first, else as defined; extensions behind."""
    return sorted(FIELDS, key=lambda field: -struct.calcsize(CODES[field[0]])) + EXTENSIONS


def bitwise_crc(data: bytes) -> int:
    """The same polynomial, reflected 0x1021, a bit at a time."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0x8408 if value & 1 else value >> 1
    return value


def decoded(packet: bytes) -> dict[str, Any]:
    """Fields of a packet; everything about it is checked."""
    magic, length, incompatible, compatible, sequence, system, component = packet[:7]
    assert (magic, incompatible, compatible) == (0xFD, 0, 0)
    assert int.from_bytes(packet[7:10], "little") == 232
    payload, tail = packet[10:-2], packet[-2:]
    assert len(payload) == length
    assert length == 1 or payload[-1] != 0
    assert int.from_bytes(tail, "little") == bitwise_crc(packet[1:-2] + bytes([151]))
    whole = payload + bytes(65 - length)
    found: dict[str, Any] = {"sequence": sequence, "system": system, "component": component}
    place = 0
    for kind, name in on_the_wire():
        (found[name],) = struct.unpack_from("<" + CODES[kind], whole, place)
        place += struct.calcsize(CODES[kind])
    assert place == 65
    return found


def test_known_checksums() -> None:
    # CRC-16/MCRF4XX of "123456789" is 0x6F91 (catalogue of parametrised CRC algorithms, G. Cook)
    assert crc16(b"123456789") == 0x6F91
    assert crc16(b"") == 0xFFFF


@given(st.binary(max_size=80))
def test_the_checksum_is_that_of_the_polynomial(data: bytes) -> None:
    assert crc16(data) == bitwise_crc(data)


def test_crc_extra_is_the_hash_of_the_definition() -> None:
    """MAVLink's rule: CRC of "NAME " and then "type name " of each field as sorted, without extensions, folded."""
    text = "GPS_INPUT " + "".join(f"{kind} {name} " for kind, name in on_the_wire() if (kind, name) not in EXTENSIONS)
    value = bitwise_crc(text.encode())
    assert ((value & 0xFF) ^ (value >> 8)) == CRC_EXTRA == 151
    assert MESSAGE_ID == 232


def test_a_sure_fix() -> None:
    fix = replace(FIX, speed_m_s=2.0, course_deg=90.0)
    found = decoded(MavlinkEncoder(system=42).encode(fix))
    assert (found["system"], found["component"], found["sequence"]) == (42, 220, 0)
    assert found["time_usec"] == 1_764_000_000_250_000
    assert (found["lat"], found["lon"]) == (481_173_000, -115_166_667)
    assert found["fix_type"] == 2
    assert found["satellites_visible"] == 0
    assert found["horiz_accuracy"] == pytest.approx(math.sqrt(13))
    assert (found["vn"], found["ve"]) == pytest.approx((0.0, 2.0), abs=1e-6)
    # altitude, hdop, vdop, vertical speed, speed accuracy, vertical accuracy
    assert found["ignore_flags"] == 1 | 2 | 4 | 16 | 32 | 128
    assert found["yaw"] == 0


def test_with_a_known_altitude_the_fix_is_in_space() -> None:
    found = decoded(MavlinkEncoder(altitude_m=515.5).encode(FIX))
    assert (found["fix_type"], found["alt"]) == (3, 515.5)
    assert not found["ignore_flags"] & 1


def test_what_is_not_claimed_is_no_fix_and_no_place() -> None:
    found = decoded(MavlinkEncoder(altitude_m=515.5).encode(replace(FIX, claimed=False)))
    assert (found["fix_type"], found["lat"], found["lon"], found["horiz_accuracy"]) == (1, 0, 0, 0.0)
    assert found["ignore_flags"] & (8 | 64) == 8 | 64


def test_speed_that_is_not_known_is_to_be_ignored() -> None:
    assert decoded(MavlinkEncoder().encode(replace(FIX, speed_m_s=None, course_deg=None)))["ignore_flags"] & 8
    still = decoded(MavlinkEncoder().encode(replace(FIX, speed_m_s=0.1, course_deg=None)))
    assert (still["vn"], still["ve"], still["ignore_flags"] & 8) == (0.0, 0.0, 0)


def test_packets_are_numbered_round() -> None:
    encoder = MavlinkEncoder()
    numbers = [decoded(encoder.encode(FIX))["sequence"] for _ in range(258)]
    assert numbers == [i % 256 for i in range(258)]


@pytest.mark.parametrize(
    ("utc", "told"),
    [
        (datetime(2017, 1, 1, tzinfo=UTC), (1930, 18_000)),  # a Sunday, 18 leap seconds ahead
        (datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), (1930, 17_000)),
        (datetime(2026, 11, 29, 0, 0, 0, tzinfo=UTC), (2447, 18_000)),
        (datetime(2026, 11, 28, 23, 59, 41, 999_600, tzinfo=UTC), (2447, 0)),
    ],
)
def test_gps_time(utc: datetime, told: tuple[int, int]) -> None:
    if utc.year > 2016:
        assert gps_time(utc.timestamp()) == told
    else:
        assert gps_time(utc.timestamp())[0] == told[0]


F32 = st.floats(-1e6, 1e6, width=32)


@given(st.integers(0, 2**63), st.integers(-(2**31), 2**31 - 1), F32, st.integers(0, 255), st.integers(0, 65535))
def test_packing_round_trips(time: int, lat: int, value: float, byte: int, yaw: int) -> None:
    message = GpsInput(
        time_usec=time, time_week_ms=time % 2**32, lat=lat, lon=-lat - 1, alt=value, hdop=value, vdop=-value, vn=value,
        ve=value, vd=value, speed_accuracy=value, horiz_accuracy=value, vert_accuracy=value, ignore_flags=yaw,
        time_week=yaw, gps_id=byte, fix_type=byte, satellites_visible=byte, yaw=yaw,
    )  # fmt: skip
    found = decoded(frame(message.payload(), byte, 1, 2))
    for _, name in on_the_wire():
        assert found[name] == getattr(message, name), name
