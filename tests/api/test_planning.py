from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.api.schemas.planning import LAYER_WORDS, MAX_CORNERS
from app.engine.geodesy import TangentPlane
from app.services.maps import MapService
from app.services.planning import QualityLayer
from app.services.records import Scope
from tests.api.harness import ANCHOR, Api
from tests.support.builders import grid_map

GEO_JSON = {"Accept": "application/geo+json"}
ROUTE = {"x": [0.0, 20.0, 20.0], "y": [5.0, 5.0, 40.0]}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """One application for all: nothing here is stored."""
    made = Api(tmp_path_factory.mktemp("planning"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def path(api: Api) -> str:
    return f"/v1/maps/{api.mapped_level().current_map_id}"


def test_quality(api: Api, path: str) -> None:
    response = api.get(f"{path}/quality", key=Scope.LOCATE)
    found = response.json()
    grid = grid_map()
    rows, columns = grid.shape
    assert found["coverage"]["mapped_m2"] == pytest.approx((rows - 1) * columns * grid.cell_m**2)
    assert found["mean_error"]["p50_m"] < found["worst_error"]["p90_m"]
    assert found["conflict"] == {"shared_cells": 0, "conflict_cells": 0}
    unchanged = api.get(f"{path}/quality", headers={"If-None-Match": response.headers["ETag"]})
    assert (unchanged.status_code, unchanged.content) == (304, b"")


def test_rasters(api: Api, path: str) -> None:
    raw = api.get(f"{path}/quality/raster?layer=along&heading_deg=90&format=f32")
    rows, columns = (int(raw.headers[f"X-Isodyn-{name}"]) for name in ("Rows", "Columns"))
    values = np.frombuffer(raw.content, "<f4").reshape(rows, columns)
    assert (rows, columns) == (69, 130)
    assert (values > 0).all()
    assert float(raw.headers["X-Isodyn-X0"]) == grid_map().x0
    image = api.get(f"{path}/quality/raster?layer=along&heading_deg=90&high=5")
    assert Image.open(io.BytesIO(image.content)).size == (columns, rows)
    assert image.headers["X-Isodyn-High"] == "5"
    again = api.get(
        f"{path}/quality/raster?layer=along&heading_deg=90&high=5", headers={"If-None-Match": image.headers["ETag"]}
    )
    assert again.status_code == 304


def test_every_layer_is_described() -> None:
    assert set(LAYER_WORDS) == set(QualityLayer)


def test_a_map_without_evidence_tells_no_conflicts(api: Api, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MapService, "evidence", lambda self, map_id: None)
    refused = api.get(f"{path}/quality/raster?layer=conflict")
    assert refused.status_code == 409
    (error,) = refused.json()["errors"]
    assert error["field"] == "map_id"


@pytest.mark.parametrize(
    ("query", "status", "field"),
    [
        ("layer=along", 422, "heading_deg"),
        ("layer=mean_error&heading_deg=90", 422, "heading_deg"),
        ("layer=depth", 422, "layer"),
    ],
)
def test_refused_rasters(api: Api, path: str, query: str, status: int, field: str) -> None:
    refused = api.get(f"{path}/quality/raster?{query}")
    assert refused.status_code == status
    (error,) = refused.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]


def test_suggestions(api: Api, path: str) -> None:
    found = api.ok("GET", f"{path}/suggestions?count=3")
    assert len(found["suggestions"]) == 3
    first = found["suggestions"][0]
    length = np.hypot(*np.subtract(first["end"], first["start"]))
    assert first["length_m"] == pytest.approx(length, abs=0.02)
    assert first["reasons"]
    assert first["words"]
    assert found["unknown_after"] < found["unknown_before"]
    assert api.get(f"{path}/suggestions?count=51").status_code == 422


def test_suggestions_in_wgs84(api: Api) -> None:
    path = f"/v1/maps/{api.anchored_level().current_map_id}/suggestions?count=2"
    collection = api.get(path, headers=GEO_JSON)
    assert collection.headers["Content-Type"] == "application/geo+json"
    plain = api.ok("GET", path)["suggestions"]
    plane: TangentPlane = ANCHOR.plane()
    for feature, line in zip(collection.json()["features"], plain, strict=True):
        assert feature["properties"] | line == feature["properties"]
        longitude, latitude = np.array(feature["geometry"]["coordinates"]).T
        x, y = plane.from_wgs84(latitude, longitude)
        np.testing.assert_allclose(np.stack([x, y], axis=1), [line["start"], line["end"]], atol=5e-3)


def test_wgs84_needs_an_anchor(api: Api, path: str) -> None:
    refused = api.get(f"{path}/suggestions", headers=GEO_JSON)
    assert (refused.status_code, refused.json()["type"].rpartition("/")[2]) == (409, "no-anchor")


def test_a_forecast(api: Api, path: str) -> None:
    found = api.ok("POST", f"{path}/forecast", key=Scope.LOCATE, json={"route": ROUTE})
    columns = [found[name] for name in ("way_m", "x", "y", "mapped", "along_m", "across_m", "error_m")]
    assert len({len(column) for column in columns}) == 1
    assert len(columns[0]) == 56
    assert (found["way_m"][0], found["way_m"][-1], found["length_m"]) == (0.0, 55.0, 55.0)
    assert (found["x"][-1], found["y"][-1]) == (20.0, 40.0)
    # the last mapped row lies at y = 36.25 m
    (gap,) = [one for one in found["stretches"] if one["trouble"] == "unmapped"]
    assert (gap["from_m"], gap["to_m"]) == (pytest.approx(52.0), pytest.approx(55.0))
    assert found["mapped"][-1] is False
    np.testing.assert_allclose(np.hypot(found["along_m"], found["across_m"]), found["error_m"], atol=2e-3)


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({}, "route"),
        ({"route": [[0, 0], [1, 1]]}, "route"),
        ({"route": {"x": [0], "y": [0]}}, "route.x"),
        ({"route": {"x": [0, 0], "y": [0, 0]}}, "route"),
        ({"route": {"x": [0, 0], "y": [0, 3000]}}, "route"),
        ({"route": {"x": [0, 1], "y": [0, 1, 2]}}, "route.y"),
        ({"route": {"x": [0, 1], "y": [0, 1e9]}}, "route.y.1"),
        ({"route": {"x": [0] * (MAX_CORNERS + 1), "y": [0, 1]}}, "route.x"),
        ({"route": ROUTE, "known_m": 0}, "known_m"),
        ({"route": ROUTE, "speed": 1}, "speed"),
    ],
)
def test_refused_forecasts(api: Api, path: str, body: dict[str, Any], field: str) -> None:
    refused = api.post(f"{path}/forecast", json=body)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == field
