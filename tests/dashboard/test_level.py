"""The page of a level: what is shown of its map, versions, comparison, building."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.e2e.service import Service
from tests.workers.polling import eventually

READOUT = ".readout"


@pytest.fixture
def level_page(dashboard: Dashboard, floor: Floor) -> Page:
    page = dashboard.open(f"/levels/{floor.level_id}")
    drawn(page)
    return page


def drawn(page: Page, times: int = 1) -> None:
    """Wait until so many maps were drawn on this page."""
    eventually(lambda: page.evaluate("performance.getEntriesByName('isodyn.map').length") >= times)


@contextmanager
def map_drawn(page: Page) -> Iterator[None]:
    """Wait until what the block does has drawn a map."""
    before = page.evaluate("performance.getEntriesByName('isodyn.map').length")
    yield
    drawn(page, before + 1)


def raster(service: Service, path: str, **query: str) -> tuple[np.ndarray, float, float, float]:
    """Values (rows, columns), place of the first node, and cell."""
    answer = service.request("GET", path, params={**query, "format": "f32"})
    assert answer.is_success, answer.text
    head = answer.headers
    shape = int(head["X-Isodyn-Rows"]), int(head["X-Isodyn-Columns"])
    values = np.frombuffer(answer.content, dtype="<f4").reshape(shape)
    return values, float(head["X-Isodyn-X0"]), float(head["X-Isodyn-Y0"]), float(head["X-Isodyn-Cell-M"])


def mapped_place(values: np.ndarray, x0: float, y0: float, cell: float) -> tuple[float, float, float]:
    """x, y and value of a node well inside what is mapped."""
    known = np.isfinite(values)
    inner = known[1:-1, 1:-1] & known[2:, 1:-1] & known[:-2, 1:-1] & known[1:-1, 2:] & known[1:-1, :-2]
    row, column = np.argwhere(inner)[len(np.argwhere(inner)) // 2] + 1
    return x0 + cell * column, y0 + cell * row, float(values[row, column])


def point_at(page: Page, service: Service, floor: Floor, x: float, y: float) -> None:
    """Move the mouse over a place of the level; the plan shows the whole extent with a margin of 4 %."""
    extent = service.get(f"/v1/levels/{floor.level_id}")["extent"]
    canvas = page.locator(".level .plan canvas").first
    box = canvas.bounding_box()
    assert box is not None
    width, height = extent["x_max"] - extent["x_min"], extent["y_max"] - extent["y_min"]
    scale = 0.92 * min(box["width"] / width, box["height"] / height)
    px = box["width"] / 2 + scale * (x - extent["x_min"] - width / 2)
    py = box["height"] / 2 - scale * (y - extent["y_min"] - height / 2)
    canvas.hover(position={"x": px, "y": py})


def test_the_value_under_the_pointer_is_the_maps(
    level_page: Page, dashboard: Dashboard, service: Service, floor: Floor
) -> None:
    where = raster(service, f"/v1/maps/{floor.map_ids[1]}/field", channel="total", statistic="mean")
    x, y, value = mapped_place(*where)
    point_at(level_page, service, floor, x, y)
    shown = level_page.locator(READOUT)
    expect(shown).to_have_text(re.compile(rf"^ ?{value:.3g}\W*µT at x {x:.0f}\.\d m, y {y:.0f}\.\d m|µT"))
    number, unit = re.match(r"\s*([\d.]+)\s(µT)", shown.inner_text()).groups()  # type: ignore[union-attr]
    # a pixel is half a metre here, so the nearest node may be the next one
    near = np.abs(where[0] - float(number)) < 0.06
    rows, columns = np.nonzero(near)
    assert np.hypot(where[1] + where[3] * columns - x, where[2] + where[3] * rows - y).min() <= 1.5
    assert unit == "µT"
    dashboard.screenshots("level")
    assert dashboard.fits()


def test_other_components_and_layers(level_page: Page, dashboard: Dashboard, service: Service, floor: Floor) -> None:
    page = level_page
    legend = page.locator(".legend figcaption")
    with map_drawn(page):
        page.get_by_label("Component").select_option("z")
    expect(legend).to_have_text("Field, z, µT")
    assert "channel=z" in page.url
    with map_drawn(page):
        page.get_by_label("Show", exact=True).select_option("sd")
    expect(legend).to_have_text("Uncertainty of the field, z, µT")
    for name, words in {
        "support": "Distance to the nearest survey sample, m",
        "mean_error": "Expected position error, m",
        "coverage": "Coverage of the walkable space",
        "conflict": "Conflict between walks, variance over noise",
        "sources": "Number of walks",
    }.items():
        with map_drawn(page):
            page.get_by_label("Show", exact=True).select_option(name)
        expect(legend).to_have_text(words)
        expect(page.get_by_label("Component")).to_be_hidden()
    page.reload()
    drawn(page)
    expect(legend).to_have_text("Number of walks")
    with map_drawn(page):
        page.get_by_label("Show", exact=True).select_option("along")
    with map_drawn(page):
        page.get_by_label("Heading", exact=True).select_option("90")
    expect(legend).to_have_text("Expected error along the way, heading 90°, m")
    page.get_by_label("Show", exact=True).select_option("none")
    expect(legend).to_have_count(0)


def test_contours_walks_and_suggestions_are_drawn(level_page: Page, dashboard: Dashboard) -> None:
    page = level_page
    pixels = "document.querySelector('.level .plan canvas').toDataURL()"

    def changes_by(name: str) -> None:
        before = page.evaluate(pixels)
        page.get_by_label(name).check()
        eventually(lambda: page.evaluate(pixels) != before)

    page.get_by_label("Plan picture").uncheck()
    changes_by("Contours")
    changes_by("Survey walks")
    page.get_by_text("Walk here next").click()
    expect(page.locator(".suggestions li")).not_to_have_count(0)
    before = page.evaluate(pixels)
    page.locator(".suggestions button").first.focus()
    eventually(lambda: page.evaluate(pixels) != before)
    dashboard.screenshots("level-layers")


def test_versions_are_compared(level_page: Page, dashboard: Dashboard, service: Service, floor: Floor) -> None:
    page = level_page
    first, second = floor.map_ids
    page.get_by_role("button", name="Compare version 1").click()
    panel = page.get_by_role("region", name="Compare versions")
    diff = service.get(f"/v1/maps/{second}/diff", against=first)
    expect(panel).to_contain_text(f"{diff['compared']['area_m2']:,.0f}")
    expect(page.locator(".legend figcaption")).to_have_text("Field, total, µT")
    picture = page.locator(".level .plan canvas").first
    middle = picture.screenshot()
    panel.get_by_label("Where the older version ends").fill("0.9")
    assert picture.screenshot() != middle
    dashboard.screenshots("level-compare")
    page.get_by_role("radio", name="Difference").check()
    expect(page.locator(".legend figcaption")).to_have_text("Change of the total field, µT")
    values, *place = raster(service, f"/v1/maps/{second}/diff", against=first, component="total")
    x, y, _ = mapped_place(values, *place)
    point_at(page, service, floor, x, y)
    expect(page.locator(READOUT)).to_contain_text(re.compile(r"Change\s+[-\d.]+\W*µT"))
    dashboard.screenshots("level-difference")
    page.get_by_role("button", name="End comparison").click()
    expect(panel).to_be_hidden()
    expect(page.locator(".legend figcaption")).to_have_text("Field, total, µT")


def test_rolling_back_and_forth(level_page: Page, service: Service, floor: Floor) -> None:
    page = level_page
    first, second = floor.map_ids
    page.get_by_role("button", name="Roll back to 1").click()
    dialog = page.get_by_role("dialog", name="Roll back to version 1")
    expect(dialog).to_contain_text("instead of 2")
    dialog.get_by_role("button", name="Cancel").click()
    assert service.get(f"/v1/levels/{floor.level_id}")["current_map_id"] == second
    page.get_by_role("button", name="Roll back to 1").click()
    dialog.get_by_label("Why").fill("a test")
    dialog.get_by_role("button", name="Roll back").click()
    expect(page.get_by_text("Version 1 is current now.")).to_be_visible()
    assert service.get(f"/v1/levels/{floor.level_id}")["current_map_id"] == first
    page.get_by_text("What was published when").click()
    expect(page.locator(".log li").first).to_contain_text("version 1 in place of 2 – a test")
    page.get_by_role("button", name="Publish 2").click()
    page.get_by_role("dialog").get_by_role("button", name="Publish").click()
    expect(page.get_by_text("Version 2 is current now.")).to_be_visible()
    assert service.get(f"/v1/levels/{floor.level_id}")["current_map_id"] == second


def test_many_versions_come_in_pages(dashboard: Dashboard, service: Service) -> None:
    venue = service.post("/v1/venues", {"name": "Versions", "kind": "area"})
    extent = {"x_min": 0, "y_min": 0, "x_max": 4, "y_max": 4}
    level = service.post(f"/v1/venues/{venue['id']}/levels", {"name": "0", "ordinal": 0, "extent": extent})
    grid = "ncols 3\nnrows 3\nxllcenter 0\nyllcenter 0\ncellsize 1\n" + "45 46 47\n" * 3
    maps = [
        service.request(
            "POST",
            f"/v1/levels/{level['id']}/maps/import",
            params={"format": "esri-ascii", "channel": "total", "unit": "uT", "publish": str(n == 0).lower()},
            content=grid.replace("45", str(30 + n)).encode(),
            headers={"Content-Type": "application/octet-stream"},
        ).json()["id"]
        for n in range(23)
    ]
    assert service.get(f"/v1/levels/{level['id']}")["current_map_id"] == maps[0]
    page = dashboard.open(f"/levels/{level['id']}")
    rows = page.locator(".versions li")
    expect(rows).to_have_count(21)
    expect(rows.last).to_contain_text("Version 1 current")
    page.get_by_role("button", name="Show older versions").click()
    expect(rows).to_have_count(23)
    expect(rows.nth(21)).to_contain_text("Version 2")
    expect(page.get_by_role("button", name="Show older versions")).to_have_count(0)


def test_readers_may_look_only(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    key = service.post("/v1/keys", {"name": "reader", "scopes": ["locate"]})["secret"]
    page = dashboard.open(f"/levels/{floor.level_id}", key=key)
    drawn(page)
    expect(page.get_by_role("button", name="Compare version 1")).to_be_visible()
    for name in ("Update the map", "Plan picture", "Roll back to 1", "Edit markers"):
        expect(page.get_by_role("button", name=name)).to_have_count(0)
