from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from app.engine.types import FeatureSet, MapBuildSettings
from app.services.records import Scope
from tests.api.harness import Api
from tests.support.builders import grid_map


def test_a_build_is_a_job(api: Api) -> None:
    api.worker.idle = True
    level = api.surveyed_level()
    response = api.post("/v1/maps", key=Scope.SURVEY, json={"level_id": level.id})
    assert response.status_code == 202
    job = response.json()
    assert (job["kind"], job["state"], job["subject"]) == ("build_map", "queued", {"level_id": level.id})
    assert "order_key" not in job
    api.worker.work()
    done = api.get(response.headers["Location"]).json()
    assert done["state"] == "done"
    assert api.ok("GET", f"/v1/levels/{level.id}")["current_map_id"] == done["result"]["map_id"]


def test_waiting_for_a_build(api: Api) -> None:
    level = api.surveyed_level()
    response = api.post("/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
    assert (response.status_code, response.json()["state"]) == (200, "done")
    assert response.headers["Preference-Applied"] == "wait=5"


def test_waiting_too_shortly_gives_the_job(api: Api) -> None:
    api.worker.idle = True
    level = api.surveyed_level()
    response = api.post("/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=0.01"})
    assert (response.status_code, response.json()["state"]) == (202, "queued")
    assert "Preference-Applied" not in response.headers


def test_a_failed_build_says_why(api: Api) -> None:
    api.worker.error = "no walk has two waypoints"
    level = api.surveyed_level()
    response = api.post("/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
    assert (response.status_code, response.json()["state"]) == (200, "failed")
    assert response.json()["error"] == "no walk has two waypoints"


def test_settings_reach_the_build(api: Api) -> None:
    level = api.mapped_level(features="hv", cell_m=0.25, mapped_m=2.0)
    info = api.ok("GET", f"/v1/maps/{level.current_map_id}")
    assert info["features"] == "hv"
    assert len(info["noise_sd"]) == 2


@pytest.mark.parametrize(("sent", "align"), [({}, True), ({"align": True}, True), ({"align": False}, False)])
def test_walks_are_aligned_unless_told_not_to(api: Api, sent: dict[str, bool], align: bool) -> None:
    level = api.surveyed_level()
    job = api.post("/v1/maps", json={"level_id": level.id, **sent}).json()
    with api.database() as uow:
        assert uow.maps.get_build(job["id"]).settings == MapBuildSettings(align=align)


def test_align_is_a_boolean(api: Api) -> None:
    refused = api.post("/v1/maps", json={"level_id": api.surveyed_level().id, "align": "no"})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "align")


def test_an_unknown_mode_is_told_in_plain_words(api: Api) -> None:
    response = api.post("/v1/maps", json={"level_id": "lvl_1", "mode": "bogus"})
    (error,) = response.json()["errors"]
    assert (response.status_code, error["field"], error["remedy"]) == (422, "mode", "send 'build' or 'update'")
    assert error["message"] == "input should be 'build' or 'update'"


def test_an_update_takes_no_settings(api: Api) -> None:
    response = api.post("/v1/maps", json={"level_id": "lvl_1", "mode": "update", "cell_m": 0.25})
    (error,) = response.json()["errors"]
    assert (response.status_code, error["field"]) == (422, "cell_m")


def test_surveys_can_be_chosen(api: Api) -> None:
    level, other = api.surveyed_level(), api.surveyed_level()
    chosen = api.ok("GET", f"/v1/surveys?level_id={level.id}")["items"][0]["id"]
    foreign = api.ok("GET", f"/v1/surveys?level_id={other.id}")["items"][0]["id"]
    assert api.post("/v1/maps", json={"level_id": level.id, "survey_ids": [chosen]}).status_code == 202
    refused = api.post("/v1/maps", json={"level_id": level.id, "survey_ids": [chosen, foreign]})
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "survey_ids.1"


def test_a_level_without_walks_cannot_be_mapped(api: Api) -> None:
    refused = api.post("/v1/maps", json={"level_id": api.level().id})
    assert refused.status_code == 409
    assert "upload walks" in refused.json()["detail"]


def test_versions(api: Api) -> None:
    level = api.mapped_level()
    api.ok("POST", "/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
    versions = api.ok("GET", f"/v1/maps?level_id={level.id}")["items"]
    assert [info["version"] for info in versions] == [2, 1]
    assert versions[0]["parent_id"] == versions[1]["id"] == level.current_map_id
    assert versions[0]["walks"][0]["offset"] == [0.5, -1.0, 2.0]


def test_a_version_never_changes(api: Api) -> None:
    path = f"/v1/maps/{api.mapped_level().current_map_id}"
    response = api.get(path)
    assert response.headers["ETag"] == f'"{response.json()["hash"]}"'
    assert "immutable" in response.headers["Cache-Control"]
    assert "private" in response.headers["Cache-Control"]
    unchanged = api.get(path, headers={"If-None-Match": response.headers["ETag"]})
    assert (unchanged.status_code, unchanged.content) == (304, b"")


def test_raw_field(api: Api) -> None:
    level = api.mapped_level()
    response = api.get(f"/v1/maps/{level.current_map_id}/field?channel=z&format=f32", key=Scope.LOCATE)
    grid = grid_map(features=FeatureSet.VECTOR)
    rows, columns = (int(response.headers[f"X-Isodyn-{name}"]) for name in ("Rows", "Columns"))
    place = [float(response.headers[f"X-Isodyn-{name}"]) for name in ("X0", "Y0", "Cell-M")]
    assert place == [grid.x0, grid.y0, grid.cell_m]
    values = np.frombuffer(response.content, dtype="<f4").reshape(rows, columns)
    assert np.isnan(values[~grid.mapped]).all()
    np.testing.assert_array_equal(values[grid.mapped], grid.mean[2][grid.mapped])


def test_image_of_the_field(api: Api) -> None:
    level = api.mapped_level()
    response = api.get(f"/v1/maps/{level.current_map_id}/field")
    assert response.headers["Content-Type"] == "image/png"
    image = np.asarray(Image.open(io.BytesIO(response.content)))
    assert image.shape == (70, 130, 4)
    # the last row of the map is unmapped; north is up, so it is the first of the image
    assert (image[0, :, 3] == 0).all()
    assert (image[1:, :, 3] == 255).all()
    assert float(response.headers["X-Isodyn-Low"]) < float(response.headers["X-Isodyn-High"])


def test_each_choice_has_its_own_tag(api: Api) -> None:
    path = f"/v1/maps/{api.mapped_level().current_map_id}/field"
    queries = ["", "?channel=x", "?channel=x&statistic=sd", "?format=f32", "?low=20", "?low=20&high=60"]
    tags = [api.get(path + query).headers["ETag"] for query in queries]
    assert len(set(tags)) == len(queries)
    assert api.get(path + "?channel=x", headers={"If-None-Match": tags[1]}).status_code == 304
    assert api.get(path + "?channel=y", headers={"If-None-Match": tags[1]}).status_code == 200


def test_a_channel_the_map_lacks(api: Api) -> None:
    level = api.mapped_level(features="hv")
    refused = api.get(f"/v1/maps/{level.current_map_id}/field?channel=x")
    assert refused.status_code == 422
    assert refused.json()["errors"] == [
        {"field": "channel", "message": "a map of features hv has no x", "remedy": "choose one of: h, v, total"}
    ]


def test_coverage(api: Api) -> None:
    path = f"/v1/maps/{api.mapped_level().current_map_id}/coverage"
    coverage = api.ok("GET", path)
    grid = grid_map()
    rows, columns = grid.shape
    assert coverage["runs"] == [0, (rows - 1) * columns, columns]
    assert coverage["mapped_share"] == pytest.approx((rows - 1) / rows)
    image = np.asarray(Image.open(io.BytesIO(api.get(path + "?format=png").content)))
    np.testing.assert_array_equal(image[::-1, :, 3] == 255, grid.mapped)
