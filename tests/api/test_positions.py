from __future__ import annotations

import pytest

from app.api.schemas.positions import PositionCollection, PositionPage
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body

ANCHOR = {"latitude_deg": 48.15, "longitude_deg": 11.57, "bearing_deg": 0.0}
GEO_JSON = {"Accept": "application/geo+json"}


def walked(api: Api, *, n: int = 3) -> str:
    session_id = api.session_id()
    for seq in range(n):
        api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(seq)))
    return f"/v1/sessions/{session_id}/positions"


def test_columns(api: Api) -> None:
    path = walked(api)
    page = api.ok("GET", path, key=Scope.LOCATE)
    PositionPage.model_validate(page)
    assert page["seq"] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert page["number"] == sorted(page["number"])
    assert page["fixes"]["t_ms"] == sorted(page["fixes"]["t_ms"])
    assert api.ok("GET", f"{path}?seq=1")["seq"] == [1, 1, 1]


def test_pages(api: Api) -> None:
    path = walked(api)
    whole = api.ok("GET", path)
    first = api.get(f"{path}?limit=4")
    assert first.json()["seq"] == whole["seq"][:4]
    following = first.headers["Link"].split(";")[0].strip("<>")
    assert api.ok("GET", following)["number"] == whole["number"][4:8]


def test_kinds(api: Api) -> None:
    path = walked(api)
    told = api.ok("GET", path)
    assert api.ok("GET", f"{path}?kind=filtered") == told
    page = api.ok("GET", f"{path}?kind=fixed_lag")
    PositionPage.model_validate(page)
    assert (page["seq"], page["number"]) == ([1, 1, 2, 2], [0, 1, 2, 3])
    assert page["fixes"]["t_ms"] == [*told["fixes"]["t_ms"][:2], *told["fixes"]["t_ms"][3:5]]
    assert set(page["fixes"]["kind"]) == {"fixed_lag"}
    assert set(told["fixes"]["kind"]) == {"filtered"}
    assert api.ok("GET", f"{path}?kind=fixed_lag&seq=2")["number"] == [2, 3]
    first = api.get(f"{path}?kind=fixed_lag&limit=3")
    following = first.headers["Link"].split(";")[0].strip("<>")
    assert api.ok("GET", following)["number"] == [3]


@pytest.mark.parametrize("kind", ["smoothed", "causal", ""])
def test_other_kinds_are_not_kept(api: Api, kind: str) -> None:
    response = api.get(f"{walked(api, n=1)}?kind={kind}")
    assert response.status_code == 422
    (error,) = response.json()["errors"]
    assert error["field"] == "kind"
    assert "fixed_lag" in error["message"] + error["remedy"]


def test_geo_json(api: Api) -> None:
    path = walked(api, n=1)
    session = api.ok("GET", path.rpartition("/")[0])
    api.ok("PATCH", f"/v1/venues/{session['venue_id']}", json={"anchor": ANCHOR})
    response = api.get(path, headers=GEO_JSON)
    assert response.headers["Content-Type"] == "application/geo+json"
    collection = response.json()
    PositionCollection.model_validate(collection)
    plain_page = api.ok("GET", path)
    for i, feature in enumerate(collection["features"]):
        properties, (longitude, latitude) = feature["properties"], feature["geometry"]["coordinates"]
        assert properties["x"] == pytest.approx(plain_page["fixes"]["x"][i], abs=1e-3)
        assert latitude > ANCHOR["latitude_deg"]
        assert longitude != ANCHOR["longitude_deg"]
        assert properties["ellipse95"]["semi_major_m"] > 0
        assert properties["kind"] == "filtered"
    api.ok("POST", f"{path.rpartition('/')[0]}/segments", json=plain(segment_body(1)))
    later = api.get(f"{path}?kind=fixed_lag", headers=GEO_JSON).json()
    PositionCollection.model_validate(later)
    assert [feature["properties"]["kind"] for feature in later["features"]] == ["fixed_lag"] * 2


def test_geo_json_needs_an_anchor(api: Api) -> None:
    path = walked(api, n=1)
    response = api.get(path, headers=GEO_JSON)
    assert response.status_code == 409
    assert response.json()["type"].endswith("/no-anchor")
    assert "PATCH /v1/venues/" in response.json()["detail"]


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        ("application/json", "application/json"),
        ("*/*", "application/json"),
        ("application/geo+json;q=0.5, application/json", "application/json"),
        ("application/geo+json;q=0", "application/json"),
        ("application/json;q=0.5, application/geo+json", "application/geo+json"),
        ("text/html, Application/Geo+JSON ; q=0.9", "application/geo+json"),
    ],
)
def test_the_preferred_form_is_answered(api: Api, accept: str, kind: str) -> None:
    path = walked(api, n=1)
    session = api.ok("GET", path.rpartition("/")[0])
    api.ok("PATCH", f"/v1/venues/{session['venue_id']}", json={"anchor": ANCHOR})
    response = api.get(path, headers={"Accept": accept})
    assert response.headers["Content-Type"] == kind
    assert response.headers["Vary"] == "Accept"
