"""NMEA 0183: the standard's own examples, every field read back, and the corners of clock and angle."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client.bridges.nmea import NmeaEncoder, checksum, clock, latitude, longitude, sentence
from isodyn_client.bridges.place import GeoFix

FIX = GeoFix(
    t=1_764_000_000.25,
    latitude_deg=48.1173,
    longitude_deg=-11.5166667,
    var_east=9.0,
    cov_east_north=0.0,
    var_north=4.0,
    course_deg=84.4,
    speed_m_s=11.523,
    claimed=True,
    number=3,
)


@pytest.mark.parametrize(
    ("body", "value"),
    [
        # Sentences that manuals of receivers print with their checksums (GGA, RMC: the often quoted pair of 1994;
        # GST: NovAtel OEM manual; GLL: u-blox protocol specification)
        ("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,", "47"),
        ("GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W", "6A"),
        ("GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031", "6A"),
        ("GPGLL,4717.11364,N,00833.91565,E,092321.00,A,A", "60"),
    ],
)
def test_checksums_of_printed_sentences(body: str, value: str) -> None:
    assert checksum(body) == value
    assert sentence(body) == f"${body}*{value}\r\n"


def parsed(data: bytes) -> dict[str, list[str]]:
    """Fields of each sentence by its name; checksums are checked by another way of adding up."""
    found = {}
    for line in data.decode("ascii").splitlines(keepends=True):
        assert len(line) <= 82, "the standard's longest line"
        match = re.fullmatch(r"\$([A-Z]{2})([A-Z]{3}),([^*]*)\*([0-9A-F]{2})\r\n", line)
        assert match, line
        bits = [format(ord(c), "08b") for c in line[1 : line.index("*")]]
        parity = "".join(str(sum(int(b[i]) for b in bits) % 2) for i in range(8))
        assert int(parity, 2) == int(match[4], 16)
        found[match[2]] = match[3].split(",")
    return found


def degrees(text: str, hemisphere: str) -> float:
    point = text.index(".") - 2
    minutes = float(text[point:])
    assert minutes < 60
    return (int(text[:point]) + minutes / 60) * (-1 if hemisphere in "SW" else 1)


def test_every_field() -> None:
    found = parsed(NmeaEncoder().encode(FIX))
    assert list(found) == ["GGA", "RMC", "GST"]
    gga, rmc, gst = found.values()
    assert gga == ["160000.25", "4807.03800", "N", "01131.00000", "W", "6", "00", "0.72", "", "M", "", "M", "", ""]
    knots = f"{11.523 * 3600 / 1852:.2f}"
    place = ["4807.03800", "N", "01131.00000", "W"]
    assert rmc == ["160000.25", "A", *place, knots, "84.4", "241125", "", "", "E"]
    assert gst == ["160000.25", "", "3.00", "2.00", "90.0", "2.00", "3.00", ""]


def test_without_a_sure_position_there_is_none() -> None:
    gga, rmc, gst = parsed(NmeaEncoder().encode(replace(FIX, claimed=False))).values()
    assert gga == ["160000.25", "", "", "", "", "0", "00", "", "", "M", "", "M", "", ""]
    assert rmc == ["160000.25", "V", "", "", "", "", "", "", "241125", "", "", "N"]
    assert gst == ["160000.25", "", "", "", "", "", "", ""]
    assert b"4807" not in NmeaEncoder().encode(replace(FIX, claimed=False))


def test_speed_and_course_that_are_not_known_are_empty() -> None:
    rmc = parsed(NmeaEncoder().encode(replace(FIX, speed_m_s=None, course_deg=None)))["RMC"]
    assert rmc[6:8] == ["", ""]
    assert parsed(NmeaEncoder().encode(replace(FIX, course_deg=359.97)))["RMC"][7] == "0.0"


@pytest.mark.parametrize(
    ("degrees_", "text"),
    [
        (47 + 59.99995 / 60, "4759.99995,N"),
        (47 + 59.999994 / 60, "4759.99999,N"),
        (47 + 59.999996 / 60, "4800.00000,N"),
        (-(0 + 59.9999999 / 60), "0100.00000,S"),
        (-1e-9, "0000.00000,N"),
        (-0.0, "0000.00000,N"),
        (90.0, "9000.00000,N"),
    ],
)
def test_minutes_never_reach_sixty(degrees_: float, text: str) -> None:
    assert latitude(degrees_) == text


@pytest.mark.parametrize(("degrees_", "text"), [(179.999999999, "18000.00000,E"), (-7.5, "00730.00000,W")])
def test_longitudes_have_three_digits(degrees_: float, text: str) -> None:
    assert longitude(degrees_) == text


@given(st.floats(-90, 90))
def test_angles_come_back(value: float) -> None:
    text, hemisphere = latitude(value).split(",")
    assert degrees(text, hemisphere) == pytest.approx(value, abs=0.6e-5 / 60)


@pytest.mark.parametrize(
    ("when", "told"),
    [
        (datetime(2026, 11, 30, 23, 59, 59, 994_000, UTC), ("235959.99", "301126")),
        (datetime(2026, 11, 30, 23, 59, 59, 996_000, UTC), ("000000.00", "011226")),
        (datetime(2025, 12, 31, 23, 59, 59, 999_000, UTC), ("000000.00", "010126")),
        (datetime(2028, 2, 28, 23, 59, 59, 999_000, UTC), ("000000.00", "290228")),
        (datetime(2026, 1, 2, 3, 4, 5, 60_000, UTC), ("030405.06", "020126")),
    ],
)
def test_the_day_turns_with_the_clock(when: datetime, told: tuple[str, str]) -> None:
    assert clock(when.timestamp()) == told


@given(st.floats(0, 4e9))
def test_clocks_come_back(t: float) -> None:
    time, date = clock(t)
    when = datetime.strptime(f"{date} {time}0000", "%d%m%y %H%M%S.%f").replace(tzinfo=UTC)
    if when.year >= 1970 and t < 3.1e9:  # two digits of a year: 1969 to 2068
        assert when.timestamp() == pytest.approx(t, abs=0.0051)


@given(st.floats(0.05, 90), st.floats(0.05, 90), st.floats(-0.95, 0.95))
def test_the_ellipse_is_that_of_the_covariance(east: float, north: float, correlation: float) -> None:
    fix = replace(FIX, var_east=east**2, var_north=north**2, cov_east_north=correlation * east * north)
    _, _, major, minor, azimuth, sd_north, sd_east, _ = parsed(NmeaEncoder().encode(fix))["GST"]
    assert (float(sd_north), float(sd_east)) == pytest.approx((north, east), abs=0.0051)
    assert float(major) >= float(minor) - 0.011
    assert 0 <= float(azimuth) < 180
    assert float(major) ** 2 + float(minor) ** 2 == pytest.approx(east**2 + north**2, rel=0.02, abs=0.02)
    a = math.radians(fix.ellipse[2])
    along = fix.var_north * math.cos(a) ** 2 + fix.var_east * math.sin(a) ** 2
    along += 2 * fix.cov_east_north * math.sin(a) * math.cos(a)
    assert along == pytest.approx(fix.ellipse[0] ** 2, rel=1e-9)


def test_sentences_and_talker_are_chosen() -> None:
    data = NmeaEncoder("IN", ("RMC",)).encode(FIX)
    assert data.startswith(b"$INRMC,")
    assert data.count(b"$") == 1
    for talker, names in (("G", ("GGA",)), ("gp", ("GGA",)), ("G1", ("GGA",)), ("GP", ("GLL",))):
        with pytest.raises(ValueError, match=r"talker|sentences"):
            NmeaEncoder(talker, names)


@pytest.mark.parametrize(("rms", "hdop"), [(0.0, "0.01"), (5.0, "1.00"), (1e4, "99.99")])
def test_hdop_is_the_error_over_five_metres(rms: float, hdop: str) -> None:
    gga = parsed(NmeaEncoder().encode(replace(FIX, var_east=rms**2, var_north=0.0)))["GGA"]
    assert gga[7] == hdop
