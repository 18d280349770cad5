"""MAVLink 2: the message GPS_INPUT (#232) for autopilots that take a position from outside.

Layout and CRC_EXTRA are those of the message definition (MAVLink ``common.xml``): fields sorted by size, the checksum
seeded with a hash of the definition, zeros at the end of the payload left out.
"""

from __future__ import annotations

import math
import struct
from dataclasses import astuple, dataclass
from enum import IntEnum, IntFlag

from isodyn_client.bridges.place import GeoFix

MESSAGE_ID = 232
CRC_EXTRA = 151
_MAGIC = 0xFD
_LAYOUT = struct.Struct("<QIiifffffffffHHBBBH")
_GPS_EPOCH_S = 315_964_800
"""1980-01-06T00:00Z as Unix time."""
GPS_AHEAD_S = 18
"""Leap seconds between GPS time and UTC since 2017-01-01."""
_WEEK_S = 7 * 86_400


class Ignore(IntFlag):
    """Fields that the receiver shall not use (GPS_INPUT_IGNORE_FLAGS)."""

    ALTITUDE = 1
    HDOP = 2
    VDOP = 4
    VELOCITY_HORIZONTAL = 8
    VELOCITY_VERTICAL = 16
    SPEED_ACCURACY = 32
    HORIZONTAL_ACCURACY = 64
    VERTICAL_ACCURACY = 128


class FixType(IntEnum):
    """What is known of the place."""

    NONE = 1
    PLANE = 2
    SPACE = 3


@dataclass(frozen=True, slots=True)
class GpsInput:
    """Payload of the message, in the order in which it is sent."""

    time_usec: int
    time_week_ms: int
    lat: int
    lon: int
    alt: float
    hdop: float
    vdop: float
    vn: float
    ve: float
    vd: float
    speed_accuracy: float
    horiz_accuracy: float
    vert_accuracy: float
    ignore_flags: int
    time_week: int
    gps_id: int
    fix_type: int
    satellites_visible: int
    yaw: int = 0

    def payload(self) -> bytes:
        """65 bytes, without the zeros at their end; one byte stays at least."""
        return _LAYOUT.pack(*astuple(self)).rstrip(b"\0") or b"\0"


def crc16(data: bytes, value: int = 0xFFFF) -> int:
    """CRC-16/MCRF4XX: MAVLink's checksum (ITU X.25 without the final inversion)."""
    for byte in data:
        part = (byte ^ value) & 0xFF
        part = (part ^ (part << 4)) & 0xFF
        value = (value >> 8) ^ (part << 8) ^ (part << 3) ^ (part >> 4)
    return value & 0xFFFF


def frame(payload: bytes, sequence: int, system: int, component: int) -> bytes:
    """A MAVLink 2 packet without signature."""
    head = struct.pack("<BBBBBB", len(payload), 0, 0, sequence & 0xFF, system, component)
    body = head + MESSAGE_ID.to_bytes(3, "little") + payload
    return bytes([_MAGIC]) + body + struct.pack("<H", crc16(body + bytes([CRC_EXTRA])))


def gps_time(t: float) -> tuple[int, int]:
    """GPS week, and milliseconds in it, of Unix seconds."""
    ms = round((t - _GPS_EPOCH_S + GPS_AHEAD_S) * 1000.0)
    return divmod(ms, _WEEK_S * 1000)


@dataclass(slots=True)
class MavlinkEncoder:
    """Packets of fixes, numbered.

    Attributes
    ----------
    system, component : int
        Who sends: 220 is MAV_COMP_ID_GPS.
    gps_id : int
        Which of several receivers this stands for.
    altitude_m : float or None
        Above mean sea level, if whoever runs the bridge knows it (a vehicle on a floor): then the fix is one in space.
        Without it the fix is one in the plane and the altitude is to be ignored.
    """

    system: int = 1
    component: int = 220
    gps_id: int = 0
    altitude_m: float | None = None
    _sequence: int = 0

    def encode(self, fix: GeoFix) -> bytes:
        """One packet."""
        packet = frame(self.message(fix).payload(), self._sequence, self.system, self.component)
        self._sequence = (self._sequence + 1) & 0xFF
        return packet

    def message(self, fix: GeoFix) -> GpsInput:
        """What is told of a fix: nothing that is not known, and no place where none is claimed."""
        week, week_ms = gps_time(fix.t)
        moving = fix.claimed and fix.speed_m_s is not None
        speed, course = fix.speed_m_s or 0.0, math.radians(fix.course_deg or 0.0)
        return GpsInput(
            time_usec=round(fix.t * 1e6),
            time_week_ms=week_ms,
            lat=round(fix.latitude_deg * 1e7) if fix.claimed else 0,
            lon=round(fix.longitude_deg * 1e7) if fix.claimed else 0,
            alt=self.altitude_m or 0.0,
            hdop=0.0,
            vdop=0.0,
            vn=speed * math.cos(course) if moving and fix.course_deg is not None else 0.0,
            ve=speed * math.sin(course) if moving and fix.course_deg is not None else 0.0,
            vd=0.0,
            speed_accuracy=0.0,
            horiz_accuracy=fix.rms_m if fix.claimed else 0.0,
            vert_accuracy=0.0,
            ignore_flags=int(self._ignored(fix, moving=moving)),
            time_week=week,
            gps_id=self.gps_id,
            fix_type=int(self._fix_type(fix)),
            satellites_visible=0,
        )

    def _fix_type(self, fix: GeoFix) -> FixType:
        if not fix.claimed:
            return FixType.NONE
        return FixType.PLANE if self.altitude_m is None else FixType.SPACE

    def _ignored(self, fix: GeoFix, *, moving: bool) -> Ignore:
        flags = Ignore.HDOP | Ignore.VDOP | Ignore.VELOCITY_VERTICAL | Ignore.SPEED_ACCURACY | Ignore.VERTICAL_ACCURACY
        if self.altitude_m is None:
            flags |= Ignore.ALTITUDE
        if not moving:
            flags |= Ignore.VELOCITY_HORIZONTAL
        if not fix.claimed:
            flags |= Ignore.HORIZONTAL_ACCURACY
        return flags
