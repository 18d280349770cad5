"""Files of tracks: what each format demands, and that nothing in doubt is drawn as a line."""

from __future__ import annotations

import csv
import io
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.geodesy import TangentPlane
from app.engine.types import Fix, FixKind, Status
from app.exchange.tracks import COLUMNS, FORMATS, TrackDocument, TrackFormat, TrackPoint
from app.exchange.tracks.document import iso_time, spread_of, stretches
from tests.support.builders import fix

PLANE = TangentPlane(48.1507, 11.5691, 12.5)
DOCUMENT = TrackDocument(
    session_id="ses_1",
    kind=FixKind.FILTERED,
    venue='Mall & "Hall" <1>\x00',
    levels={"lvl": "F1", "lvl_2": "F2 & up"},
    method="particle",
    software="isodyn test",
    map_ids=("map_1",),
    plane=PLANE,
)
T = 1_764_000_000.0


def points(*changes: dict[str, Any]) -> list[TrackPoint]:
    """A fix a second, one metre further each, changed as said."""
    made = [replace(fix(T + i, x=float(i), y=0.0), **change) for i, change in enumerate(changes)]
    return [TrackPoint(i, one, seq=i // 2) for i, one in enumerate(made)]


OK: dict[str, Any] = {}
UNSURE = {"sure": False}
AMBIGUOUS = {"status": Status.AMBIGUOUS, "sure": False}
OFF = {"status": Status.OFF_MAP, "sure": False}
UPSTAIRS = {"level_id": "lvl_2"}
MIXED = points(OK, OK, OK, AMBIGUOUS, OK, OK, UNSURE, UNSURE, OFF, OK, UPSTAIRS, UPSTAIRS)
LINES = [[0, 1, 2], [4, 5], [6, 7], [10, 11]]
"""Numbers of the points of each line; 9 stands alone."""


def written(kind: TrackFormat, of: Iterable[TrackPoint], document: TrackDocument = DOCUMENT) -> str:
    return b"".join(FORMATS[kind].write(document, of)).decode()


def test_lines_run_through_what_is_claimed_only() -> None:
    found = [[point.number for point in stretch.points] for stretch in stretches(MIXED)]
    assert found == [[0, 1, 2], [4, 5], [6, 7], [9], [10, 11]]


@pytest.mark.parametrize(("gap", "n"), [(9.9, 1), (10.1, 2), (0.0, 2), (-1.0, 2)])
def test_a_silence_or_a_clock_that_stands_breaks_a_line(gap: float, n: int) -> None:
    one, two = points(OK, OK)
    later = replace(two, fix=replace(two.fix, t=one.fix.t + gap))
    assert len(list(stretches([one, later]))) == n


@given(st.lists(st.sampled_from([OK, UNSURE, AMBIGUOUS, OFF, UPSTAIRS]), max_size=30))
def test_stretches_hold_every_claim_once_and_nothing_else(changes: list[dict[str, Any]]) -> None:
    track = points(*changes)
    held = [point.number for stretch in stretches(track) for point in stretch.points]
    assert held == [point.number for point in track if point.fix.status is Status.OK]
    for stretch in stretches(track):
        assert len({(p.fix.level_id, p.fix.sure) for p in stretch.points}) == 1


def test_geojson_has_all_points_and_the_lines() -> None:
    collection = json.loads(written(TrackFormat.GEOJSON, MIXED))
    assert collection["type"] == "FeatureCollection"
    fixes = [f for f in collection["features"] if f["properties"]["part"] == "fix"]
    lines = [f for f in collection["features"] if f["properties"]["part"] == "line"]
    assert [f["id"] for f in fixes] == list(range(len(MIXED)))
    for feature, point in zip(fixes, MIXED, strict=True):
        assert feature["geometry"]["coordinates"] == pytest.approx(PLANE.to_wgs84(point.fix.x, point.fix.y), abs=1e-8)
        assert feature["properties"]["status"] == point.fix.status.value
    for line, numbers in zip(lines, LINES, strict=True):
        assert (line["properties"]["first"], line["properties"]["last"]) == (numbers[0], numbers[-1])
        assert line["geometry"]["coordinates"] == [fixes[i]["geometry"]["coordinates"] for i in numbers]
    assert [line["properties"]["sure"] for line in lines] == [True, True, False, True]
    assert lines[-1]["properties"]["level"] == "F2 & up"


def test_mf_json_has_a_rising_time_for_each_position() -> None:
    collection = json.loads(written(TrackFormat.MF_JSON, MIXED))
    assert [f["id"] for f in collection["features"]] == ["ses_1/1", "ses_1/2", "ses_1/3", "ses_1/4"]
    for feature, numbers in zip(collection["features"], LINES, strict=True):
        assert feature["geometry"]["type"] == "LineString"
        times = [datetime.fromisoformat(one) for one in feature["properties"]["datetimes"]]
        assert [one.timestamp() for one in times] == [MIXED[i].fix.t for i in numbers]
        assert len(feature["geometry"]["coordinates"]) == len(times) == len(feature["properties"]["sd_major_m"])
        assert times == sorted(set(times))


GPX = "{http://www.topografix.com/GPX/1/1}"
SEQUENCES = {
    "gpx": ["metadata", "wpt", "rte", "trk", "extensions"],
    "metadata": ["name", "desc", "author", "copyright", "link", "time", "keywords", "bounds", "extensions"],
    "trk": ["name", "cmt", "desc", "src", "link", "number", "type", "extensions", "trkseg"],
    "trkseg": ["trkpt", "extensions"],
    "trkpt": ["ele", "time", "magvar", "geoidheight", "name", "cmt", "desc", "src", "link", "sym", "type", "fix", "sat",
              "hdop", "vdop", "pdop", "ageofdgpsdata", "dgpsid", "extensions"],
}  # fmt: skip
"""Sequences of the complex types of gpx.xsd (1.1), as published by topografix.com."""


def check_gpx(element: ET.Element) -> None:
    """Known elements in the schema's order, and the types of their values."""
    name = element.tag.removeprefix(GPX)
    if name in SEQUENCES:
        children = [child.tag.removeprefix(GPX) for child in element]
        order = SEQUENCES[name]
        assert [order.index(child) for child in children] == sorted(order.index(child) for child in children), children
        for single in set(order) - {"wpt", "rte", "trk", "link", "trkseg", "trkpt"}:
            assert children.count(single) <= 1, single
        for child in element:
            check_gpx(child)
    if name == "trkpt":
        assert -90 <= float(element.attrib["lat"]) <= 90
        assert -180 <= float(element.attrib["lon"]) < 180
    if name == "extensions":
        assert all(child.tag.startswith("{") and not child.tag.startswith(GPX) for child in element)


def test_gpx_keeps_the_order_of_its_schema() -> None:
    text = written(TrackFormat.GPX, MIXED)
    root = ET.fromstring(text.encode())
    assert (root.tag, root.attrib["version"]) == (f"{GPX}gpx", "1.1")
    assert root.attrib["creator"]
    check_gpx(root)
    segments = root.findall(f"{GPX}trk/{GPX}trkseg")
    assert [len(segment) for segment in segments] == [3, 2, 2, 1, 2]
    assert [trk.findtext(f"{GPX}name") for trk in root.iter(f"{GPX}trk")] == [
        'Mall & "Hall" <1> , F1',
        'Mall & "Hall" <1> , F2 & up',
    ]
    first = segments[0][0]
    assert first.findtext(f"{GPX}time") == "2025-11-24T16:00:00.000Z"
    rms = math.sqrt(0.5 + 0.4)
    assert float(first.findtext(f"{GPX}hdop", "")) == pytest.approx(rms / 5.0, abs=0.005)
    sd = first.findtext(f"{GPX}extensions/{{https://isodyn.dev/ns/track/1}}sd_major_m")
    assert float(sd or "") == pytest.approx(spread_of(MIXED[0].fix).major_m, abs=5e-4)


def test_the_order_check_can_fail() -> None:
    text = written(TrackFormat.GPX, points(OK, OK)).replace("<hdop>", "<sat>3</sat><time>x</time><hdop>")
    with pytest.raises(AssertionError):
        check_gpx(ET.fromstring(text.encode()))


@pytest.mark.parametrize("anchored", [True, False])
def test_csv_has_every_fix_whatever_it_claims(anchored: bool) -> None:
    document = DOCUMENT if anchored else replace(DOCUMENT, plane=None)
    rows = list(csv.DictReader(io.StringIO(written(TrackFormat.CSV, MIXED, document))))
    assert list(rows[0]) == list(COLUMNS)
    assert [int(row["number"]) for row in rows] == list(range(len(MIXED)))
    for row, point in zip(rows, MIXED, strict=True):
        assert (row["status"], row["sure"]) == (point.fix.status.value, str(point.fix.sure).lower())
        assert float(row["t_ms"]) == point.fix.t * 1000.0
        if anchored:
            place = PLANE.to_wgs84(point.fix.x, point.fix.y)
            assert (float(row["longitude_deg"]), float(row["latitude_deg"])) == pytest.approx(place, abs=1e-8)
        else:
            assert row["latitude_deg"] == row["longitude_deg"] == ""


@pytest.mark.parametrize("kind", TrackFormat)
def test_an_empty_track_is_a_file_too(kind: TrackFormat) -> None:
    text = written(kind, [])
    if kind is TrackFormat.GPX:
        check_gpx(ET.fromstring(text.encode()))
    elif kind is TrackFormat.CSV:
        assert text == ",".join(COLUMNS) + "\r\n"
    else:
        assert json.loads(text)["features"] == []


@pytest.mark.parametrize("kind", TrackFormat)
def test_long_tracks_come_in_pieces(kind: TrackFormat) -> None:
    seen: list[int] = []

    def slow() -> Iterable[TrackPoint]:
        for point in points(*([OK] * 30 + [AMBIGUOUS]) * 40):
            seen.append(point.number)
            yield point

    pieces = FORMATS[kind].write(DOCUMENT, slow())
    next(pieces)
    next(pieces)
    assert len(seen) < 31 * 40
    assert b"".join(pieces)


@pytest.mark.parametrize("kind", [kind for kind in TrackFormat if FORMATS[kind].needs_anchor])
def test_without_an_anchor_there_are_no_degrees(kind: TrackFormat) -> None:
    with pytest.raises(ValueError, match="anchor"):
        written(kind, MIXED, replace(DOCUMENT, plane=None))


@given(st.floats(0.01, 50), st.floats(0.01, 50), st.floats(-0.99, 0.99), st.floats(0, 360, exclude_max=True))
def test_the_ellipse_is_that_of_the_covariance_in_north_and_east(
    sd_x: float, sd_y: float, correlation: float, bearing: float
) -> None:
    cov = np.array([[sd_x**2, correlation * sd_x * sd_y], [correlation * sd_x * sd_y, sd_y**2]])
    one = replace(fix(), cov_xx=cov[0, 0], cov_xy=cov[0, 1], cov_yy=cov[1, 1])
    spread, plane = spread_of(one), TangentPlane(10.0, 20.0, bearing)
    b = math.radians(bearing)
    turn = np.array([[math.cos(b), math.sin(b)], [-math.sin(b), math.cos(b)]])  # x, y to east, north
    east_north = turn @ cov @ turn.T
    a = math.radians(spread.azimuth_deg(plane))
    axis = np.array([math.sin(a), math.cos(a)])
    assert axis @ east_north @ axis == pytest.approx(spread.major_m**2, rel=1e-6)
    assert spread.major_m**2 + spread.minor_m**2 == pytest.approx(float(np.trace(cov)), rel=1e-9)


@pytest.mark.parametrize(
    ("t", "text"),
    [
        (0.0, "1970-01-01T00:00:00.000Z"),
        (1_764_000_000.9996, "2025-11-24T16:00:01.000Z"),
        (1_767_225_599.9999, "2026-01-01T00:00:00.000Z"),
    ],
)
def test_times_round_without_a_sixtieth_second(t: float, text: str) -> None:
    assert iso_time(t) == text


def test_the_columns_are_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "outputs.md").read_text()
    for column in COLUMNS:
        assert f"`{column}`" in page, column


def test_the_command_line_knows_all_formats() -> None:
    from app.cli.tracks import TrackFormat as Named
    from app.cli.tracks import TrackKind

    assert [one.value for one in Named] == [one.value for one in TrackFormat]
    assert [one.value for one in TrackKind] == [one.value for one in FixKind]


def test_a_fix_is_not_changed_by_writing_it() -> None:
    before: list[Fix] = [point.fix for point in MIXED]
    for kind in TrackFormat:
        written(kind, MIXED)
    assert [point.fix for point in MIXED] == before
