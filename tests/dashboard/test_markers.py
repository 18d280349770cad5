"""Markers and geofences of a level, with answers of the API made up here: what the page does with them."""

from __future__ import annotations

import json
from typing import Any

from playwright.sync_api import Route, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.dashboard.test_level import drawn
from tests.workers.polling import eventually


def test_markers_are_moved_added_and_saved(dashboard: Dashboard, floor: Floor) -> None:
    saved: list[Any] = []

    def markers(route: Route) -> None:
        if route.request.method == "PUT":
            saved.append(route.request.post_data_json)
        body = saved[-1] if saved else {"markers": [{"name": "Lift", "x": 120.0, "y": 80.0}]}
        route.fulfill(content_type="application/json", body=json.dumps(body))

    dashboard.page.route("**/v1/levels/*/markers", markers)
    page = dashboard.open(f"/levels/{floor.level_id}")
    drawn(page)
    card = page.get_by_role("region", name="Markers")
    expect(card).to_contain_text("Lift")
    card.get_by_role("button", name="Edit markers").click()
    card.get_by_label("x of Lift").fill("130.5")
    card.get_by_label("x of Lift").press("Tab")
    plan = page.get_by_role("application")
    plan.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    expect(card.locator("li")).to_have_count(2)
    page.keyboard.type("Stairs")
    dashboard.screenshots("markers")
    card.get_by_role("button", name="Save markers").click()
    expect(page.get_by_text("The markers were saved.")).to_be_visible()
    (sent,) = saved
    assert sent["markers"][0] == {"name": "Lift", "x": 130.5, "y": 80.0}
    assert sent["markers"][1]["name"] == "Stairs"
    card.get_by_role("button", name="Edit markers").click()
    card.get_by_role("button", name="Delete Stairs").click()
    card.get_by_role("button", name="Cancel").click()
    expect(card).to_contain_text("Stairs")


def test_geofences_are_drawn(dashboard: Dashboard, floor: Floor) -> None:
    fences = {
        "items": [
            {"id": "gfn_1", "name": "Shop", "polygon": [[100, 60], [140, 60], [140, 90]]},
            {"id": "gfn_2", "name": "Lift", "circle": {"x": 60, "y": 100, "radius_m": 15}},
        ],
        "next_cursor": None,
    }
    dashboard.page.route(
        "**/v1/geofences?*", lambda route: route.fulfill(content_type="application/json", body=json.dumps(fences))
    )
    page = dashboard.open(f"/levels/{floor.level_id}")
    drawn(page)
    pixels = "document.querySelector('.level .plan canvas').toDataURL()"
    shown = page.get_by_label("Geofences")
    expect(shown).to_be_checked()
    before = page.evaluate(pixels)
    shown.uncheck()
    eventually(lambda: page.evaluate(pixels) != before)
