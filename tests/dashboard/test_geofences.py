"""Geofences drawn on the plan, and webhooks with what became of their messages."""

from __future__ import annotations

import json
import re

import pytest
from playwright.sync_api import expect

from app.cli.uploads import open_level
from tests.dashboard.browsing import Dashboard
from tests.dashboard.conftest import SAMPLE
from tests.dashboard.floors import Floor
from tests.dashboard.traffic import walk_sessions
from tests.e2e.service import Service


def test_a_geofence_is_drawn_and_deleted(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    page = dashboard.open("/geofences")
    page.get_by_label("Level").select_option(floor.level_id)
    page.get_by_role("button", name="New geofence").click()
    dialog = page.get_by_role("dialog")
    canvas = dialog.locator("canvas")
    box = canvas.bounding_box()
    assert box is not None
    # the middle of the canvas is the middle of the level; y is up on the plan
    for dx, dy in ((0.4, 0.6), (0.6, 0.6), (0.6, 0.4), (0.4, 0.4)):
        canvas.click(position={"x": dx * box["width"], "y": dy * box["height"]})
    dialog.get_by_label("Name").fill("Middle")
    dialog.get_by_label("Tell who leaves").uncheck()
    dashboard.screenshot("geofence-new")
    dialog.get_by_role("button", name="Create").click()
    expect(page.get_by_role("cell", name="Middle", exact=True)).to_be_visible()
    (fence,) = [one for one in service.get("/v1/geofences")["items"] if one["name"] == "Middle"]
    assert fence["events"] == ["enter"]
    extent = service.get(f"/v1/levels/{floor.level_id}")["extent"]
    ring = fence["polygon"]
    assert len(ring) == 4
    for axis, name in enumerate("xy"):
        middle = (extent[f"{name}_min"] + extent[f"{name}_max"]) / 2
        assert sum(point[axis] for point in ring) / 4 == pytest.approx(middle, abs=0.5)
    page.get_by_role("button", name="Delete Middle").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("cell", name="Middle", exact=True)).to_have_count(0)
    # the button is gone: the focus stays in its card
    expect(page.locator("section[aria-label=Geofences]")).to_be_focused()


def test_who_entered_is_listed_with_its_session(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    extent = service.get(f"/v1/levels/{floor.level_id}")["extent"]
    x0, x1, y0, y1 = (extent[name] for name in ("x_min", "x_max", "y_min", "y_max"))
    ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    fence = service.post(
        "/v1/geofences", {"name": "All of it", "level_id": floor.level_id, "polygon": ring, "events": ["enter"]}
    )
    (session_id,) = walk_sessions(service, floor, open_level(SAMPLE), 1)
    page = dashboard.open("/geofences")
    events = page.get_by_role("region", name="Events", exact=True)
    expect(events.get_by_role("row").filter(has_text="All of it").first).to_contain_text("enters")
    # to the second: a walk enters and leaves within a minute
    expect(events.get_by_role("row").filter(has_text="All of it").first).to_contain_text(re.compile(r"\d\d:\d\d:\d\d"))
    assert dashboard.fits()
    dashboard.screenshots("geofences")
    assert dashboard.fits()
    events.get_by_title(session_id).first.click()
    expect(page.get_by_role("heading", name="Session ses_")).to_be_visible()
    card = page.get_by_role("region", name="Geofences", exact=True)
    expect(card.get_by_text("All of it").first).to_be_visible()
    service.post(f"/v1/sessions/{session_id}/close", {})
    service.request("DELETE", f"/v1/geofences/{fence['id']}")


def test_a_webhook_is_made_tried_and_paused(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    dashboard.expect(422, "/v1/webhooks")
    page = dashboard.open("/webhooks")
    page.get_by_role("button", name="New webhook").first.click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Address").fill("http://127.0.0.1/hook")
    dialog.get_by_role("button", name="Create").click()
    expect(dialog.get_by_label("Address")).to_have_attribute("aria-invalid", "true")
    # a name that the rules of names promise nobody has
    dialog.get_by_label("Address").fill("https://hook.invalid/isodyn")
    dialog.get_by_label("A map is published").check()
    dialog.get_by_role("button", name="Create").click()
    secret = page.get_by_role("textbox", name="Secret").input_value()
    assert secret.startswith("whsec_")
    page.get_by_role("button", name="I have it").click()
    expect(page.locator("dialog")).to_have_count(0)
    (hook,) = service.get("/v1/webhooks")["items"]
    assert hook["events"] == ["geofence.enter", "map.published"]
    assert secret not in page.content()
    page.get_by_role("button", name="Test", exact=True).click()
    row = page.get_by_role("region", name="Deliveries").first.get_by_role("row").filter(has_text="test")
    expect(row).to_be_visible()
    dashboard.screenshots("webhooks")
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_text("paused", exact=True)).to_be_visible()
    assert not service.get(f"/v1/webhooks/{hook['id']}")["active"]
    page.get_by_role("button", name=f"Delete {hook['url']}").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_text("No webhooks")).to_be_visible()


@pytest.mark.parametrize("place", ["/geofences", "/surveys"])
def test_without_a_level_the_way_on_is_shown(dashboard: Dashboard, service: Service, place: str) -> None:
    nothing = json.dumps({"items": [], "next_cursor": None})
    for path in ("levels", "surveys", "geofences"):
        dashboard.page.route(f"**/v1/{path}?*", lambda route: route.fulfill(json=json.loads(nothing)))
        dashboard.page.route(f"**/v1/{path}", lambda route: route.fulfill(json=json.loads(nothing)))
    page = dashboard.open(place)
    page.get_by_role("link", name="make a venue and a level first").click()
    expect(page.get_by_role("heading", name="Venues")).to_be_visible()
