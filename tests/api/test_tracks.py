from __future__ import annotations

import csv
import io
import json
import xml.etree.ElementTree as ET

import pytest

from app.api.schemas.tracks import TRACK_EXAMPLE
from app.services import tracks
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body
from tests.exchange.test_tracks import check_gpx

ANCHOR = {"latitude_deg": 48.15, "longitude_deg": 11.57, "bearing_deg": 0.0}


def walked(api: Api, *, n: int = 3, anchored: bool = True) -> str:
    session_id = api.session_id()
    if anchored:
        venue_id = api.ok("GET", f"/v1/sessions/{session_id}")["venue_id"]
        api.ok("PATCH", f"/v1/venues/{venue_id}", json={"anchor": ANCHOR})
    for seq in range(n):
        api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(seq)))
    return f"/v1/sessions/{session_id}"


def test_all_fixes_whatever_the_page(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    path = walked(api)
    whole = api.get(f"{path}/track", key=Scope.LOCATE)
    monkeypatch.setattr(tracks, "MAX_LIMIT", 2)
    assert api.get(f"{path}/track").content == whole.content
    assert whole.headers["Content-Type"] == "application/geo+json"
    collection = whole.json()
    fixes = [f for f in collection["features"] if f["properties"]["part"] == "fix"]
    told = api.ok("GET", f"{path}/positions")
    assert [f["id"] for f in fixes] == told["number"]
    assert [f["properties"]["seq"] for f in fixes] == told["seq"]
    assert fixes[0]["properties"].keys() == TRACK_EXAMPLE["features"][0]["properties"].keys()
    assert collection["properties"].keys() >= TRACK_EXAMPLE["properties"].keys()


@pytest.mark.parametrize(
    ("form", "suffix"), [("geojson", ".geojson"), ("mf-json", ".mf.json"), ("gpx", ".gpx"), ("csv", ".csv")]
)
@pytest.mark.parametrize("kind", ["filtered", "fixed_lag", "smoothed"])
def test_files_of_every_kind(api: Api, form: str, suffix: str, kind: str) -> None:
    path = walked(api)
    response = api.get(f"{path}/track?format={form}&kind={kind}")
    assert response.status_code == 200
    session_id = path.rpartition("/")[2]
    name = session_id + ("" if kind == "filtered" else f"-{kind}") + suffix
    assert response.headers["Content-Disposition"] == f'attachment; filename="{name}"'
    if form == "gpx":
        check_gpx(ET.fromstring(response.content))
    elif form == "csv":
        rows = list(csv.DictReader(io.StringIO(response.text)))
        assert {row["kind"] for row in rows} == {kind}
        assert len(rows) == {"filtered": 9, "fixed_lag": 4, "smoothed": 3}[kind]
    else:
        assert json.loads(response.content)["properties"]["kind"] == kind


def test_without_an_anchor_only_csv(api: Api) -> None:
    path = walked(api, n=1, anchored=False)
    for form in ("geojson", "mf-json", "gpx"):
        response = api.get(f"{path}/track?format={form}")
        assert (response.status_code, response.json()["type"].rpartition("/")[2]) == (409, "no-anchor")
        assert "csv" in response.json()["detail"]
    (first, *_) = csv.DictReader(io.StringIO(api.get(f"{path}/track?format=csv").text))
    assert first["latitude_deg"] == ""
    assert first["x_m"]


def test_a_session_that_cannot_be_smoothed_is_refused_before_the_file_begins(api: Api) -> None:
    level = api.anchored_level()
    session_id = api.ok("POST", "/v1/sessions", json={"level_id": level.id, "method": "dead_reckoning"})["id"]
    response = api.get(f"/v1/sessions/{session_id}/track?kind=smoothed")
    assert (response.status_code, response.json()["errors"][0]["field"]) == (409, "method")


@pytest.mark.parametrize(("query", "field"), [("format=kml", "format"), ("kind=best", "kind")])
def test_other_words_are_refused(api: Api, query: str, field: str) -> None:
    response = api.get(f"{walked(api, n=1)}/track?{query}")
    assert response.status_code == 422
    assert response.json()["errors"][0]["field"] == field


def test_no_such_session(api: Api) -> None:
    assert api.get("/v1/sessions/ses_0/track").status_code == 404
