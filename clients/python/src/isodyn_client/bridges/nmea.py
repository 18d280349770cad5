"""NMEA 0183: GGA, RMC and GST sentences of a fix.

Nothing here pretends to be a satellite receiver: a position has fix quality 6 and mode E ("estimated"), zero
satellites, and its true standard deviations in GST; without one, quality 0, status V, mode N and empty fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from isodyn_client.bridges.place import GeoFix

SENTENCES = ("GGA", "RMC", "GST")
RANGE_ERROR_M = 5.0
"""Readers multiply HDOP with about this error of one range to get metres: HDOP is rms error / 5 m."""
_KNOT_M_S = 1852.0 / 3600.0
_MINUTE = 100_000
"""Parts of a minute of arc that are told: five decimals, 2 cm."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def checksum(body: str) -> str:
    """Exclusive or of all characters between ``$`` and ``*``, two hexadecimal digits."""
    value = 0
    for character in body.encode("ascii"):
        value ^= character
    return f"{value:02X}"


def sentence(body: str) -> str:
    """A whole line."""
    return f"${body}*{checksum(body)}\r\n"


def latitude(degrees: float) -> str:
    """``ddmm.mmmmm,N``."""
    return f"{_angle(degrees, 2)},{_hemisphere(degrees, 'N', 'S')}"


def longitude(degrees: float) -> str:
    """``dddmm.mmmmm,E``."""
    return f"{_angle(degrees, 3)},{_hemisphere(degrees, 'E', 'W')}"


def _angle(degrees: float, digits: int) -> str:
    # in whole parts of a minute, so that 59.999996 minutes become the next degree and never 60.00000
    parts = round(abs(degrees) * 60 * _MINUTE)
    whole, rest = divmod(parts, 60 * _MINUTE)
    minutes, fraction = divmod(rest, _MINUTE)
    return f"{whole:0{digits}d}{minutes:02d}.{fraction:05d}"


def _hemisphere(degrees: float, positive: str, negative: str) -> str:
    return negative if round(degrees * 60 * _MINUTE) < 0 else positive


def clock(t: float) -> tuple[str, str]:
    """``hhmmss.ss`` and ``ddmmyy`` of Unix seconds, rounded together: what rounds up to midnight is the next day."""
    when = _EPOCH + timedelta(milliseconds=10 * round(t * 100.0))
    return f"{when:%H%M%S}.{when.microsecond // 10_000:02d}", f"{when:%d%m%y}"


@dataclass(frozen=True, slots=True)
class NmeaEncoder:
    """Sentences of fixes.

    Attributes
    ----------
    talker : str
        Two letters in front of the sentence: ``GP`` is heard by every reader, ``IN`` (integrated navigation) is the
        standard's own word for what this is.
    sentences : sequence of str
        Which of GGA, RMC and GST, in this order.
    """

    talker: str = "GP"
    sentences: Sequence[str] = SENTENCES

    def __post_init__(self) -> None:
        if not (len(self.talker) == 2 and self.talker.isascii() and self.talker.isalpha() and self.talker.isupper()):
            raise ValueError(f"talker needs two capital letters such as GP or IN, got {self.talker!r}")
        if unknown := set(self.sentences) - set(SENTENCES):
            raise ValueError(f"sentences are {', '.join(SENTENCES)}; got {', '.join(sorted(unknown))}")

    def encode(self, fix: GeoFix) -> bytes:
        """Sentences of one fix, each a line."""
        bodies = {"GGA": _gga, "RMC": _rmc, "GST": _gst}
        return "".join(sentence(self.talker + bodies[name](fix)) for name in self.sentences).encode("ascii")


def _gga(fix: GeoFix) -> str:
    """Time, place, quality, satellites, HDOP; height, geoid and differential data are not known and left empty."""
    time, _ = clock(fix.t)
    if not fix.claimed:
        return f"GGA,{time},,,,,0,00,,,M,,M,,"
    hdop = min(max(fix.rms_m / RANGE_ERROR_M, 0.01), 99.99)
    return f"GGA,{time},{latitude(fix.latitude_deg)},{longitude(fix.longitude_deg)},6,00,{hdop:.2f},,M,,M,,"


def _rmc(fix: GeoFix) -> str:
    """Time, status, place, speed in knots, course, date, magnetic variation (left empty), mode."""
    time, date = clock(fix.t)
    if not fix.claimed:
        return f"RMC,{time},V,,,,,,,{date},,,N"
    speed = "" if fix.speed_m_s is None else f"{fix.speed_m_s / _KNOT_M_S:.2f}"
    # rounded before it is wrapped: 359.96 is 0.0, not 360.0
    course = "" if fix.course_deg is None else f"{round(fix.course_deg, 1) % 360.0:.1f}"
    place = f"{latitude(fix.latitude_deg)},{longitude(fix.longitude_deg)}"
    return f"RMC,{time},A,{place},{speed},{course},{date},,,E"


def _gst(fix: GeoFix) -> str:
    """Ellipse of one standard deviation, deviations to north and east; of ranges and of height nothing is known."""
    time, _ = clock(fix.t)
    if not fix.claimed:
        return f"GST,{time},,,,,,,"
    major, minor, azimuth = fix.ellipse
    turned = round(azimuth, 1) % 180.0
    return f"GST,{time},,{major:.2f},{minor:.2f},{turned:.1f},{fix.sd_north:.2f},{fix.sd_east:.2f},"
