"""Maps and surveys as files over HTTP."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest

from app.exchange.maps import MapFormat
from app.exchange.maps.classic import read_classic
from app.services.records import NewBuild, Scope
from app.services.tasks import BuildResult
from tests.api.harness import Api, as_msgpack, walk_body
from tests.exchange.documents import esri
from tests.support.builders import map_build, new_walk, radio_map, scans, vector_plan

BYTES = {"Content-Type": "application/octet-stream"}
ADDRESSES = tuple(f"a4:2b:8c:91:{i:02x}:f7" for i in range(5))


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """One application for all of this: each test makes levels of its own."""
    made = Api(tmp_path_factory.mktemp("exchange"))
    yield made
    made.close()


def imported(api: Api, level_id: str, content: bytes, kind: str, **query: Any) -> Any:
    return api.ok(
        "POST", f"/v1/levels/{level_id}/maps/import", content=content, params={"format": kind, **query}, headers=BYTES
    )


def exported(api: Api, map_id: str, kind: str, **query: Any) -> bytes:
    response = api.get(f"/v1/maps/{map_id}/export", params={"format": kind, **query})
    assert response.status_code == 200, response.text
    assert int(response.headers["content-length"]) == len(response.content)
    return response.content


@pytest.mark.parametrize("kind", MapFormat)
def test_a_map_goes_out_and_comes_in_unchanged(api: Api, kind: MapFormat) -> None:
    level = api.anchored_level()
    content = exported(api, str(level.current_map_id), kind.value, licence="ODbL 1.0")
    made = imported(api, level.id, content, kind.value)
    old, new = (api.services.maps.grid(str(one)) for one in (level.current_map_id, made["id"]))
    assert np.array_equal(old.mean, new.mean)
    assert np.array_equal(old.sd, new.sd)
    assert (made["version"], made["parent_id"]) == (2, level.current_map_id)
    assert api.services.venues.get_level(level.id).current_map_id == made["id"]
    published = api.ok("GET", f"/v1/levels/{level.id}/publications")["items"][0]
    assert (published["map_id"], published["note"]) == (made["id"], "imported")
    origin = made["origin"]
    assert (origin["source"], origin["format"], origin["licence"]) == ("import", kind.value, "ODbL 1.0")
    assert origin["assumed"] == []
    assert api.get(f"/v1/maps/{made['id']}").json()["origin"] == origin
    # a third copy names the licence that came with the second
    assert b"ODbL 1.0" in exported(api, made["id"], "netcdf")


def test_equal_maps_have_equal_hashes(api: Api) -> None:
    level = api.mapped_level()
    content = exported(api, str(level.current_map_id), "netcdf")
    first, second = (imported(api, level.id, content, "netcdf") for _ in range(2))
    assert first["hash"] == second["hash"]
    assert first["id"] != second["id"]


def test_an_imported_map_takes_no_updates_and_says_why(api: Api) -> None:
    level = api.mapped_level()
    imported(api, level.id, exported(api, str(level.current_map_id), "netcdf"), "netcdf")
    response = api.post("/v1/maps", json={"level_id": level.id, "mode": "update"})
    assert response.status_code == 409
    assert "it was imported" in response.json()["detail"]


def test_a_damaged_image_is_refused_without_a_word_of_the_library(api: Api) -> None:
    level = api.mapped_level()
    response = api.post(
        f"/v1/levels/{level.id}/maps/import", content=b"junk", params={"format": "geotiff"}, headers=BYTES
    )
    assert response.status_code == 422
    assert "is no readable TIFF" in response.text
    assert "0x" not in response.text


def test_a_draft_is_stored_but_not_used(api: Api) -> None:
    level = api.mapped_level()
    content = exported(api, str(level.current_map_id), "netcdf")
    made = imported(api, level.id, content, "netcdf", publish="false")
    assert made["version"] == 2
    assert api.services.venues.get_level(level.id).current_map_id == level.current_map_id


def test_sessions_open_on_an_imported_map(api: Api) -> None:
    level = api.level()
    made = imported(api, level.id, esri(np.full((8, 9), 48.0), y=3.0), "esri-ascii", channel="total", sd=2)
    assert (made["n_walks"], made["features"], made["noise_sd"]) == (0, "total", [2.0])
    session = api.ok("POST", "/v1/sessions", json={"level_id": level.id})
    assert session["map_id"] == made["id"]


def test_a_map_without_walls_takes_the_levels(api: Api) -> None:
    level = api.level()
    api.services.venues.set_vector_plan(level.id, vector_plan())
    made = imported(api, level.id, esri(np.full((30, 40), 48.0), y=3.0), "esri-ascii", channel="total")
    assert "obstacle" in read_classic(exported(api, made["id"], "netcdf")).variables


def test_gzip_and_texts(api: Api) -> None:
    level = api.mapped_level()
    content = gzip.compress(exported(api, str(level.current_map_id), "xyz"))
    response = api.post(
        f"/v1/levels/{level.id}/maps/import",
        content=content,
        headers={"Content-Encoding": "gzip", "Content-Type": "text/plain"},
        params={"format": "xyz", "title": "mine", "licence": "CC0", "attribution": "A. Walker"},
    )
    origin = response.json()["origin"]
    assert (origin["title"], origin["licence"], origin["attribution"]) == ("mine", "CC0", "A. Walker")


@pytest.mark.parametrize(
    ("content", "query", "field"),
    [
        (b"garbage", {"format": "netcdf"}, "file"),
        (esri(np.full((8, 9), 48.0), x=9000.0), {"format": "esri-ascii", "channel": "total"}, "file"),
        (esri(np.full((8, 9), 48.0)), {"format": "esri-ascii"}, "file"),
        (esri(np.full((8, 9), 48.0)), {"format": "shapefile"}, "format"),
        (esri(np.full((8, 9), 48.0)), {}, "format"),
        (esri(np.full((8, 9), 48.0)), {"format": "esri-ascii", "sd": "-1"}, "sd"),
        (esri(np.full((8, 9), 48.0)), {"format": "esri-ascii", "licence": "a\nb"}, "licence"),
    ],
)
def test_what_cannot_be_taken_is_named_and_nothing_is_stored(
    api: Api, content: bytes, query: dict[str, str], field: str
) -> None:
    level = api.level()
    before = api.stored()
    response = api.post(f"/v1/levels/{level.id}/maps/import", content=content, params=query, headers=BYTES)
    assert response.status_code == 422, response.text
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]
    assert api.stored() == before


def test_a_file_that_is_too_large_is_not_read(api: Api) -> None:
    level = api.level()
    path = f"/v1/levels/{level.id}/maps/import?format=netcdf"
    assert api.post(path, content=bytes(9 * 2**20), headers=BYTES).status_code == 413
    assert api.post(path, content=b"{}", headers={"Content-Type": "application/json"}).status_code == 415
    assert api.post("/v1/levels/lvl_0/maps/import?format=netcdf", content=b"CDF", headers=BYTES).status_code == 404


def test_an_export_is_asked_for_once(api: Api) -> None:
    level = api.anchored_level()
    path = f"/v1/maps/{level.current_map_id}/export"
    first = api.get(path)
    assert first.headers["content-disposition"].endswith('-netcdf.nc"')
    tag = first.headers["etag"]
    assert api.get(path, headers={"If-None-Match": tag}).status_code == 304
    assert api.get(path, params={"licence": "CC0"}, headers={"If-None-Match": tag}).status_code == 200
    venue = api.services.venues.get(level.venue_id)
    api.services.venues.update(venue.id, venue.name, None)
    assert api.get(path, headers={"If-None-Match": tag}).status_code == 200


def secret_map(api: Api) -> tuple[str, list[bytes]]:
    """A map of walks with offsets, with a radio layer; and what of it must not go out, in every spelling."""
    level = api.level()
    survey = api.services.surveys.create(level.id, "survey")
    walk, _ = api.services.surveys.add_walk(survey.id, new_walk())
    api.worker.idle = True
    api.services.maps.request_build(NewBuild(level.id))
    (job,) = api.services.processing.claim(1)
    api.worker.idle = False
    build = map_build(level.id, walk_ids=[walk.id, "wlk_2"], radio=replace(radio_map(), addresses=ADDRESSES))
    offset = (7.3471, -4.2193, 2.9871)
    build = replace(build, walks=tuple(replace(one, offset=offset, rejected=None) for one in build.walks))
    api.services.processing.complete_build(job, BuildResult(build, cpu_s=0.1), 0.2)
    secrets = [part.encode() for one in ADDRESSES for part in (one, one.upper(), one.replace(":", ""))]
    secrets += [bytes.fromhex(one.replace(":", "")) for one in ADDRESSES]
    for value in offset:
        secrets.append(repr(value).encode())
        secrets += [np.array(value, kind).tobytes() for kind in ("<f4", ">f4", "<f8", ">f8")]
    return str(api.services.venues.get_level(level.id).current_map_id), [*secrets, walk.id.encode()]


def unpacked(content: bytes) -> bytes:
    if not content.startswith(b"PK"):
        return content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return content + b"".join(archive.read(name) for name in archive.namelist())


@pytest.mark.parametrize("kind", MapFormat)
def test_maps_carry_no_offsets_and_no_addresses(api: Api, kind: MapFormat) -> None:
    map_id, secrets = secret_map(api)
    assert api.get(f"/v1/maps/{map_id}").json()["n_transmitters"] == len(ADDRESSES)
    content = unpacked(exported(api, map_id, kind.value))
    assert len(content) > 10_000
    assert not [secret for secret in secrets if secret in content]


def survey_zip(api: Api, survey_id: str, **query: Any) -> dict[str, bytes]:
    response = api.get(f"/v1/surveys/{survey_id}/export", params=query)
    assert response.status_code == 200, response.text
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def test_a_survey_goes_out_as_it_is_taken(api: Api) -> None:
    level = api.level()
    survey = api.services.surveys.create(level.id, "spring")
    device = api.ok("POST", "/v1/devices", json={"name": "phone"})["id"]
    wifi = {
        "t_ms": list(walk_body()["samples"]["t_ms"][:5]), "bssid": list(ADDRESSES), "rssi": [-50.0, -60, -70, -80, -90],
    }  # fmt: skip
    for i in range(3):
        body = walk_body(f"walk {i}", seed=i) | {"wifi": wifi, "device_id": device}
        api.ok("POST", f"/v1/surveys/{survey.id}/walks", **as_msgpack(body))
    files = survey_zip(api, survey.id)
    head = json.loads(files.pop("survey.json"))
    assert (head["survey"], head["radio"], head["format"]) == ("spring", False, "isodyn-survey")
    assert len(files) == 3
    everything = b"".join(files.values())
    assert not [one for one in (*ADDRESSES, device) if one.encode() in everything]
    # the same walks, with their addresses: known as they are sent again
    with_radio = survey_zip(api, survey.id, radio="true")
    assert json.loads(with_radio.pop("survey.json"))["radio"] is True
    for content in with_radio.values():
        assert msgpack.unpackb(content)["wifi"]["bssid"] == list(ADDRESSES)
        sent = {"content": content, "headers": {"Content-Type": "application/msgpack"}}
        assert api.post(f"/v1/surveys/{survey.id}/walks", **sent).status_code == 200
    # without addresses they are walks of their own, for another survey
    other = api.services.surveys.create(level.id, "copy")
    for content in files.values():
        sent = {"content": content, "headers": {"Content-Type": "application/msgpack"}}
        assert api.post(f"/v1/surveys/{other.id}/walks", **sent).status_code == 201


def test_only_surveyors_get_surveys(api: Api) -> None:
    level = api.surveyed_level()
    survey_id = api.services.surveys.list(level.id).items[0].id
    assert api.get(f"/v1/surveys/{survey_id}/export", key=Scope.LOCATE).status_code == 403
    assert api.get("/v1/surveys/srv_0/export").status_code == 404


def test_an_export_holds_one_walk_at_a_time(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    level = api.level()
    survey = api.services.surveys.create(level.id, "long")
    for i in range(4):
        api.services.surveys.add_walk(survey.id, new_walk(f"walk {i}", seed=i, wifi=scans()))
    _, pieces = api.services.exchange.survey_export(survey.id)
    next(pieces)
    # what is deleted while the archive is written is left out, and the archive is whole
    walks = api.services.surveys.list_walks(survey.id).items
    first = next(pieces)
    api.services.surveys.delete_walk(survey.id, walks[2].id)
    rest = list(pieces)
    assert len(rest) == 3
    assert len(first) > 1000
