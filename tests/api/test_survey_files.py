"""Files of survey recordings over HTTP: read, reported, and checked like any walk."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest

from app.exchange.surveys import survey_archive
from tests.api.harness import ANCHOR, Api
from tests.exchange.recordings import WALK, csv_of, log_of, plain_csv
from tests.support.phones import sensor_logger_zip

BYTES = {"Content-Type": "application/octet-stream"}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    made = Api(tmp_path_factory.mktemp("survey-files"))
    yield made
    made.close()


@pytest.fixture
def survey_id(api: Api) -> str:
    return str(api.ok("POST", "/v1/surveys", json={"level_id": api.level().id, "name": "files"})["id"])


def send(api: Api, survey_id: str, content: bytes, **query: Any) -> httpx.Response:
    headers = {**BYTES, **({"Content-Encoding": "gzip"} if content[:2] == b"\x1f\x8b" else {})}
    return api.post(f"/v1/surveys/{survey_id}/import", content=content, params=query, headers=headers)


def report(api: Api, survey_id: str, content: bytes, **query: Any) -> Any:
    response = send(api, survey_id, content, **query)
    assert response.status_code == 200, response.text
    return response.json()


def test_a_file_becomes_walks_with_an_account(api: Api, survey_id: str) -> None:
    done = report(api, survey_id, gzip.compress(plain_csv()), format="csv", name="hall")
    (walk,) = done["walks"]
    assert (walk["name"], walk["fate"], walk["n_samples"]) == ("hall", "new", len(WALK.samples))
    assert done["read"]
    assert done["assumed"]  # units that the header does not tell
    stored = api.ok("GET", f"/v1/surveys/{survey_id}/walks/{walk['walk_id']}")
    assert stored["n_waypoints"] == len(WALK.waypoints)
    np.testing.assert_allclose(walk["x"], WALK.waypoints.x)
    (again,) = report(api, survey_id, plain_csv(), format="csv")["walks"]
    assert (again["fate"], again["walk_id"]) == ("known", walk["walk_id"])
    assert api.ok("GET", f"/v1/surveys/{survey_id}")["n_walks"] == 1


def test_a_dry_run_stores_nothing_and_says_the_same(api: Api, survey_id: str) -> None:
    tried = report(api, survey_id, plain_csv(), format="csv", dry_run="true")
    assert tried["dry_run"]
    assert [(walk["fate"], walk["walk_id"]) for walk in tried["walks"]] == [("new", None)]
    assert api.ok("GET", f"/v1/surveys/{survey_id}")["n_walks"] == 0
    done = report(api, survey_id, plain_csv(), format="csv")
    assert [done[part] for part in ("read", "assumed", "skipped")] == [
        tried[part] for part in ("read", "assumed", "skipped")
    ]


def test_a_walk_that_cannot_be_used_stops_no_other(api: Api, survey_id: str) -> None:
    far = replace(WALK, waypoints=replace(WALK.waypoints, x=WALK.waypoints.x + 9_000.0))
    archive = b"".join(survey_archive({}, [("far", far), ("near", WALK)], radio=False))
    first, second = report(api, survey_id, archive, format="archive")["walks"]
    assert (first["name"], first["fate"], first["walk_id"]) == ("far", "refused", None)
    assert "waypoints" in first["reasons"][0]
    assert (second["name"], second["fate"]) == ("near", "new")


def test_what_the_header_does_not_tell_is_told(api: Api, survey_id: str) -> None:
    content = csv_of(factors={"mag": 1000.0}).replace(b"mag_x", b"Feld", 1)
    refused = send(api, survey_id, content, format="csv").json()
    assert refused["errors"][0]["remedy"]
    (walk,) = report(api, survey_id, content, format="csv", unit="mag=nT", column="mag_x=Feld")["walks"]
    (plain,) = report(api, survey_id, plain_csv(), format="csv", unit="mag=uT")["walks"]
    assert walk["fate"] == "new"
    assert walk["n_samples"] == plain["n_samples"]


def test_a_log_needs_the_venues_anchor(api: Api, survey_id: str) -> None:
    plane = ANCHOR.plane()
    error = send(api, survey_id, log_of(plane=plane), format="getsensordata").json()["errors"][0]
    assert "anchor" in error["message"] + error["remedy"]
    survey = api.ok("GET", f"/v1/surveys/{survey_id}")
    venue_id = api.services.venues.get_level(survey["level_id"]).venue_id
    api.services.venues.update(venue_id, "House", ANCHOR)
    (walk,) = report(api, survey_id, log_of(plane=plane), format="getsensordata")["walks"]
    assert walk["fate"] == "new"
    np.testing.assert_allclose(walk["x"], WALK.waypoints.x, atol=0.01)


@pytest.mark.parametrize(
    ("content", "query", "field"),
    [
        (b"no zip", {"format": "archive"}, "file"),
        (b"t,x,y\n", {"format": "csv"}, "header"),
        (b"", {"format": "xls"}, "format"),
        (plain_csv(), {"format": "csv", "unit": "mag"}, "unit"),
        (plain_csv(), {"format": "csv", "unit": "mag=stone"}, "unit"),
    ],
)
def test_a_file_that_cannot_be_read_stores_nothing(
    api: Api, survey_id: str, content: bytes, query: dict[str, str], field: str
) -> None:
    response = send(api, survey_id, content, **query)
    assert response.status_code == 422, response.text
    (error, *_) = response.json()["errors"]
    assert error["field"] == field
    assert error["message"]
    assert error["remedy"]
    assert api.ok("GET", f"/v1/surveys/{survey_id}")["n_walks"] == 0


def test_an_unknown_survey_is_not_found(api: Api) -> None:
    assert send(api, "srv_none", plain_csv(), format="csv").status_code == 404


def test_tracks_of_one_survey_come_in_pages(api: Api, survey_id: str) -> None:
    moved = replace(WALK, waypoints=replace(WALK.waypoints, y=WALK.waypoints.y + 1.0))
    level_id = api.ok("GET", f"/v1/surveys/{survey_id}")["level_id"]
    other = api.ok("POST", "/v1/surveys", json={"level_id": level_id, "name": "other"})["id"]
    report(api, other, plain_csv(), format="csv")
    archive = b"".join(survey_archive({}, [("one", WALK), ("two", moved)], radio=False))
    report(api, survey_id, archive, format="archive")
    path = f"/v1/levels/{level_id}/waypoints"
    assert len(api.ok("GET", path)["items"]) == 3
    first = api.ok("GET", path, params={"survey_id": survey_id, "limit": 1})
    second = api.ok("GET", path, params={"survey_id": survey_id, "cursor": first["next_cursor"]})
    (one,), (two,) = first["items"], second["items"]
    assert (one["name"], two["name"], second["next_cursor"]) == ("one", "two", None)
    np.testing.assert_allclose(np.subtract(two["y"], one["y"]), 1.0, atol=2e-3)
    assert api.get(path, params={"survey_id": "srv_none"}).status_code == 404


def test_a_phones_export_is_read_with_the_markers_of_the_level(api: Api) -> None:
    level = api.level()
    survey_id = str(api.ok("POST", "/v1/surveys", json={"level_id": level.id, "name": "phones"})["id"])
    places = [(float(x), float(y)) for x, y in zip(WALK.waypoints.x, WALK.waypoints.y, strict=True)]
    names = [f"M{i}" for i in range(len(places))]
    markers = [{"name": name, "x": x, "y": y} for name, (x, y) in zip(names, places, strict=True)]
    api.ok("PUT", f"/v1/levels/{level.id}/markers", json={"markers": markers})
    export = sensor_logger_zip(WALK.samples, WALK.waypoints, labels=[name.lower() for name in names])
    (walk,) = report(api, survey_id, export, format="sensor-logger", name="phone")["walks"]
    assert (walk["fate"], walk["n_waypoints"], walk["reasons"]) == ("new", len(places), [])
    np.testing.assert_allclose(walk["x"], WALK.waypoints.x)
    unnamed = sensor_logger_zip(WALK.samples, WALK.waypoints, labels=["?"] * len(places))
    told = report(api, survey_id, unnamed, format="sensor-logger", dry_run="true")
    assert told["walks"] == []
    assert any("neither x,y nor a marker" in words for words in told["skipped"])
