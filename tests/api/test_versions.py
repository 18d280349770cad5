"""Publishing, sources and differences of map versions over HTTP."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.engine.types import FeatureSet
from app.services.records import JobKind, Level, NewBuild, Scope
from app.services.tasks import BuildResult
from tests.api.harness import Api
from tests.support.builders import grid_map, map_build


def draft(api: Api, level: Level, **changes: Any) -> str:
    """A version beside the current one, 15 uT apart in one corner of it."""
    api.worker.idle = True
    job_id = api.services.maps.request_build(NewBuild(level.id, publish=False)).id
    (job,) = api.services.processing.claim(1, JobKind.BUILD_MAP)
    assert job.id == job_id
    grid = grid_map(level.id, features=FeatureSet.VECTOR)
    mean = grid.mean.copy()
    mean[2, :10, :10] += 15.0
    grid = replace(grid, **{"mean": mean, **changes})
    build = replace(map_build(level.id, features=FeatureSet.VECTOR), grid_map=grid)
    done = api.services.processing.complete_build(job, BuildResult(build, cpu_s=0.1), 0.2)
    api.worker.idle = False
    return str(done.result["map_id"])


def test_a_draft_is_built_and_published_later(api: Api) -> None:
    level = api.mapped_level()
    job = api.ok(
        "POST",
        "/v1/maps",
        json={"level_id": level.id, "publish": False},
        headers={"Prefer": "wait=5"},
        key=Scope.SURVEY,
    )
    map_id = job["result"]["map_id"]
    path = f"/v1/levels/{level.id}"
    assert api.ok("GET", path)["current_map_id"] == level.current_map_id
    published = api.ok("PUT", f"{path}/map", json={"map_id": map_id, "note": "checked"}, key=Scope.SURVEY)
    assert (published["map_id"], published["from_map_id"], published["note"]) == (
        map_id,
        level.current_map_id,
        "checked",
    )
    assert api.ok("GET", path)["current_map_id"] == map_id
    back = api.ok("PUT", f"{path}/map", json={"map_id": level.current_map_id})
    assert api.ok("GET", path)["current_map_id"] == level.current_map_id
    page = api.get(f"{path}/publications?limit=2")
    assert page.json()["items"] == [back, published]
    assert 'rel="next"' in page.headers["Link"]
    (first,) = api.ok("GET", f"{path}/publications?cursor={page.json()['next_cursor']}")["items"]
    keys = {key["id"]: key["name"] for key in api.ok("GET", "/v1/keys")["items"]}
    assert [keys[one["key_id"]] for one in (back, published, first)] == ["admin", "survey", "admin"]
    assert first["note"] == "built"


@pytest.mark.parametrize(
    ("body", "status", "field"),
    [
        ({}, 422, "map_id"),
        ({"map_id": "map_none"}, 404, None),
        ({"map_id": "OTHER"}, 422, "map_id"),
        ({"map_id": "OWN", "note": "two\nlines"}, 422, "note"),
        ({"map_id": "OWN", "note": "x" * 501}, 422, "note"),
        ({"map_id": "OWN", "reason": "x"}, 422, "reason"),
    ],
)
def test_publications_that_are_refused(api: Api, body: dict[str, str], status: int, field: str | None) -> None:
    level, other = api.mapped_level(), api.mapped_level()
    known = {"OTHER": other.current_map_id, "OWN": level.current_map_id}
    body = {name: known.get(value, value) for name, value in body.items()}
    response = api.call("PUT", f"/v1/levels/{level.id}/map", json=body)
    assert response.status_code == status
    if field is not None:
        (error,) = response.json()["errors"]
        assert (error["field"], bool(error["remedy"])) == (field, True)
    assert len(api.ok("GET", f"/v1/levels/{level.id}/publications")["items"]) == 1


def test_the_difference_in_numbers(api: Api) -> None:
    level = api.mapped_level()
    map_id = draft(api, level)
    response = api.get(f"/v1/maps/{map_id}/diff", key=Scope.LOCATE)
    found = response.json()
    assert (found["map_id"], found["against"], found["identical"]) == (map_id, level.current_map_id, False)
    assert found["changed"] == found["significant"] | {"nodes": 100, "area_m2": 25.0}
    assert found["compared"]["nodes"] == 69 * 130
    assert found["box"] == {"x_min": -3.5, "y_min": 2.25, "x_max": 1.0, "y_max": 6.75}
    assert {one["component"]: one["largest"] for one in found["change"]}["z"] == pytest.approx(15.0)
    assert (found["tiles"]["shared"], found["tiles"]["new"]) == (5, 1)
    assert found["sources"]["added"] == ["wlk_1"]
    assert found["settings"] == []
    assert api.ok("GET", f"/v1/maps/{map_id}/diff?least_ut=15.5")["changed"]["nodes"] == 0
    again = api.get(f"/v1/maps/{map_id}/diff", headers={"If-None-Match": response.headers["ETag"]})
    assert again.status_code == 304
    back = api.ok("GET", f"/v1/maps/{level.current_map_id}/diff?against={map_id}")
    assert {one["component"]: one["mean"] for one in back["change"]}["z"] < 0.0


def test_the_difference_as_rasters(api: Api) -> None:
    level = api.mapped_level()
    path = f"/v1/maps/{draft(api, level)}/diff"
    raw = api.get(f"{path}?format=f32&component=z")
    shape = tuple(int(raw.headers[f"X-Isodyn-{name}"]) for name in ("Rows", "Columns"))
    values = np.frombuffer(raw.content, "<f4").reshape(shape)
    assert shape == (70, 130)
    np.testing.assert_allclose(values[:10, :10], 15.0, rtol=1e-5)
    assert np.abs(values[10:69]).max() == 0.0
    assert np.isnan(values[69]).all()
    sure = np.frombuffer(api.get(f"{path}?format=f32&component=z&statistic=significance").content, "<f4")
    combined = np.hypot(*2 * [grid_map(level.id, features=FeatureSet.VECTOR).sd[2, 0, 0]])
    assert sure[0] == pytest.approx(15.0 / combined, rel=1e-4)
    image = api.get(f"{path}?format=png&component=z&high=20")
    low, high = (float(image.headers[f"X-Isodyn-{name}"]) for name in ("Low", "High"))
    assert (low < 0.0, high) == (True, 20.0)
    with Image.open(io.BytesIO(image.content)) as shown:
        assert shown.size == (130, 70)
        assert shown.getpixel((0, 0))[3] == 0, "the last row is not mapped, and north is up"
    tags = {api.get(f"{path}{query}").headers["ETag"] for query in ("", "?format=png", "?format=f32", "?least_ut=2")}
    assert len(tags) == 4


def test_what_cannot_be_compared_says_what_can(api: Api) -> None:
    level, other = api.mapped_level(), api.mapped_level()
    first = level.current_map_id
    finer = draft(api, level, cell_m=0.25)
    for path, field, word in (
        (f"{first}/diff", "against", "parent"),
        (f"{first}/diff?against={other.current_map_id}", "against", "level"),
        (f"{finer}/diff", "against", "cell_m"),
        (f"{finer}/diff?against={finer}&format=png&component=v", None, None),
        (f"{first}/diff?against={first}&format=png&low=x", "low", "number"),
    ):
        response = api.get(f"/v1/maps/{path}")
        if field is None:
            assert response.status_code == 200
            continue
        assert response.status_code == 422, path
        (error,) = response.json()["errors"]
        assert error["field"] == field
        assert word is not None
        assert word in error["message"] + error["remedy"]
    assert api.get(f"/v1/maps/{first}/diff?against=map_none").status_code == 404


def test_sources_are_listed_in_pages(api: Api) -> None:
    level = api.mapped_level()
    map_id = draft(api, level)
    page = api.ok("GET", f"/v1/maps/{map_id}/sources?limit=1", key=Scope.SURVEY)
    rest = api.ok("GET", f"/v1/maps/{map_id}/sources?cursor={page['next_cursor']}")
    used, left_out = page["items"] + rest["items"]
    assert (used["id"], used["kind"], used["n_samples"], used["rejected"]) == ("wlk_1", "survey", 3, None)
    assert (left_out["id"], left_out["rejected"], rest["next_cursor"]) == ("wlk_2", "moved", None)
    assert api.get(f"/v1/maps/{map_id}/sources?cursor=map_1").status_code == 422
    assert api.get("/v1/maps/map_none/sources").status_code == 404


def test_a_session_names_its_versions(api: Api) -> None:
    venue_id, (ground, upper) = api.mapped_venue()
    named = draft(api, upper)
    body = {"venue_id": venue_id, "map_ids": [named]}
    session = api.ok("POST", "/v1/sessions", json=body, key=Scope.LOCATE)
    assert [one["map_id"] for one in session["maps"]] == [ground.current_map_id, named]
    refused = api.post("/v1/sessions", json={"level_id": ground.id, "map_ids": [named]})
    assert refused.status_code == 422
    (error,) = refused.json()["errors"]
    assert (error["field"], ground.id in error["remedy"]) == ("map_ids.0", True)
    assert api.post("/v1/sessions", json=body | {"map_ids": ["map_1"] * 65}).status_code == 422
