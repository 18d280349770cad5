"""A plan picture put in place by two known points."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw
from playwright.sync_api import Page, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.test_parts import blank, run
from tests.e2e.service import Service

__all__ = ["blank"]


@pytest.mark.parametrize(
    ("places", "scale", "angle_deg"),
    [([(0, 0), (10, 0)], 0.1, 0.0), ([(5, 5), (5, 25)], 0.2, 90.0), ([(3, -2), (-4, -9)], 0.09899, -135.0)],
)
def test_two_points_fix_a_similarity(
    blank: Page, places: list[tuple[float, float]], scale: float, angle_deg: float
) -> None:
    points = [{"u": 20, "v": 30}, {"u": 120, "v": 30}]
    given = {"points": points, "places": [{"x": x, "y": y} for x, y in places]}
    found: Any = run(blank, "pages/level/placing.js", "return m.similarity(given.points, given.places);", given)
    assert found["scale"] == pytest.approx(scale, rel=1e-3)
    assert np.degrees(found["angle"]) == pytest.approx(angle_deg, abs=1e-6)
    a, b = complex(found["a"]["re"], found["a"]["im"]), complex(found["b"]["x"], found["b"]["y"])
    for point, place in zip(points, places, strict=True):
        assert a * complex(point["u"], point["v"]) + b == pytest.approx(complex(*place))


def test_a_picture_is_placed_by_two_points(dashboard: Dashboard, service: Service) -> None:
    """A picture of 200 x 100 pixels, turned by 90 degrees and 0.2 m a pixel: its dot comes to lie where it belongs."""
    venue = service.post("/v1/venues", {"name": "Turned", "kind": "indoor"})
    extent = {"x_min": 0, "y_min": 0, "x_max": 60, "y_max": 50}
    level = service.post(f"/v1/venues/{venue['id']}/levels", {"name": "0", "ordinal": 0, "extent": extent})
    picture = Image.new("RGB", (200, 100), "white")
    ImageDraw.Draw(picture).ellipse((145, 15, 155, 25), fill="red")  # at u 150, v 80 from the lower edge
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")

    page = dashboard.open(f"/levels/{level['id']}")
    page.get_by_role("button", name="Plan picture").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Picture (PNG)").set_input_files(
        {"name": "plan.png", "mimeType": "image/png", "buffer": buffer.getvalue()}
    )
    dialog.get_by_label("Where it lies").select_option("points")
    dialog.get_by_role("button", name="Save the plan").click()
    expect(dialog.get_by_role("alert")).to_contain_text("Click two points")
    canvas = dialog.locator("canvas")
    box = canvas.bounding_box()
    assert box is not None
    scale = 0.92 * min(box["width"] / 200, box["height"] / 100)
    for u, v in ((50, 50), (150, 50)):
        x, y = box["width"] / 2 + scale * (u - 100), box["height"] / 2 - scale * (v - 50)
        canvas.click(position={"x": x, "y": y})
    # u runs along +y: (50, 50) -> (30, 10), (150, 50) -> (30, 30)
    for name, values in {"First point": (30, 10), "Second point": (30, 30)}.items():
        point = dialog.get_by_role("group", name=name)
        point.get_by_label("x, m").fill(str(values[0]))
        point.get_by_label("y, m").fill(str(values[1]))
    dashboard.screenshots("plan-dialog")
    dialog.get_by_role("button", name="Save the plan").click()
    expect(page.get_by_text("The plan was saved.")).to_be_visible()
    sent = Image.open(io.BytesIO(service.request("GET", f"/v1/levels/{level['id']}/plan.png").content)).convert("RGB")
    pixels = np.asarray(sent).astype(int)
    red = (pixels[..., 0] > 200) & (pixels[..., 1] < 80)
    rows, columns = np.nonzero(red)
    per_m = sent.width / 60
    assert sent.width / sent.height == pytest.approx(60 / 50, rel=0.01)
    # 30 pixels above the points' line is 6 m to the left of it
    assert (columns.mean() + 0.5) / per_m == pytest.approx(24.0, abs=0.5)
    assert 50 - (rows.mean() + 0.5) / per_m == pytest.approx(30.0, abs=0.5)


def test_a_level_grows_to_its_picture(blank: Page) -> None:
    """200 x 100 pixels of 0.5 m, turned by a right angle."""
    given = {"image": {"width": 200, "height": 100}, "where": {"a": {"re": 0, "im": 0.5}, "b": {"x": 3.5, "y": -1}}}
    extent: Any = run(blank, "pages/level/placing.js", "return m.reach(given.image, given.where);", given)
    assert extent == {"x_min": -47, "x_max": 4, "y_min": -1, "y_max": 99}


def test_a_level_is_edited(dashboard: Dashboard, service: Service) -> None:
    dashboard.expect(422, "/v1/levels/lvl_.*")
    venue = service.post("/v1/venues", {"name": "Edited", "kind": "indoor"})
    extent = {"x_min": 0, "y_min": 0, "x_max": 60, "y_max": 50}
    level = service.post(f"/v1/venues/{venue['id']}/levels", {"name": "0", "ordinal": 0, "extent": extent})
    page = dashboard.open(f"/levels/{level['id']}")
    page.get_by_role("button", name="Edit", exact=True).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Name").fill("Ground")
    dialog.get_by_label("x max").fill("-1")
    dialog.get_by_role("button", name="Save").click()
    expect(dialog.get_by_role("alert")).to_contain_text("x_max")
    dialog.get_by_label("x max").fill("80")
    plan = {"type": "Polygon", "coordinates": [[[0, 0], [80, 0], [80, 50], [0, 0]]]}
    collection = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": plan}]}
    dialog.get_by_label("Vector plan").set_input_files(
        {"name": "plan.geojson", "mimeType": "application/geo+json", "buffer": json.dumps(collection).encode()}
    )
    dashboard.screenshots("edit-level")
    dialog.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Ground")).to_be_visible()
    expect(page.get_by_label("Vector plan")).to_be_checked()
    changed = service.get(f"/v1/levels/{level['id']}")
    assert changed["extent"]["x_max"] == 80.0
    assert changed["has_vector_plan"]
