"""Devices: made, known, forgotten; phones' addresses made, scanned, revoked; recordings mended."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from app.cli.uploads import open_level
from tests.dashboard.browsing import Dashboard
from tests.dashboard.conftest import SAMPLE
from tests.dashboard.floors import Floor
from tests.dashboard.traffic import walk_sessions
from tests.e2e.service import Service
from tests.e2e.synthetic import EXTENT, trip
from tests.support.phones import sensor_logger_messages


@pytest.fixture
def device(service: Service) -> dict[str, Any]:
    return service.post("/v1/devices", {"name": "Ada's phone", "model": "Pixel 9"})


@pytest.fixture(scope="module")
def hall(service: Service, floor: Floor) -> str:
    """A level without a map or a plan."""
    venue = service.post("/v1/venues", {"name": "Hall of phones", "kind": "indoor"})
    extent = dict(zip(("x_min", "y_min", "x_max", "y_max"), EXTENT, strict=True))
    return str(service.post(f"/v1/venues/{venue['id']}/levels", {"name": "0", "ordinal": 0, "extent": extent})["id"])


def push(service: Service, url: str, *bodies: bytes) -> None:
    for body in bodies:
        answer = service.request("POST", url, content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 200, answer.text


def connect(page: Page, level: str, *, purpose: str = "locate", app: str = "sensor-logger") -> None:
    page.get_by_role("button", name="Connect a phone").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("What for").select_option(purpose)
    if purpose == "locate":
        dialog.get_by_label("Application").select_option(app)
    dialog.get_by_label("Where").select_option(level)
    dialog.get_by_role("button", name="Make the address").click()
    expect(dialog.get_by_role("img", name="QR code of the address")).to_be_visible()


def test_a_device_is_registered(dashboard: Dashboard, floor: Floor) -> None:
    page = dashboard.open("/devices")
    page.get_by_role("button", name="New device").first.click()
    expect(page.get_by_label("Name")).to_be_focused()
    page.get_by_role("button", name="Create").click()
    expect(page.get_by_text("Please fill out this field")).to_be_visible()
    page.get_by_label("Name").fill("trolley 7")
    page.get_by_label("Model").fill("Pixel 9")
    page.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="trolley 7", level=1)).to_be_visible()
    expect(page.get_by_text("No phone sends as this device")).to_be_visible()
    dashboard.page.goto("/#/devices")
    expect(page.get_by_role("link", name="trolley 7")).to_be_visible()
    assert dashboard.fits()
    dashboard.screenshots("devices")
    assert dashboard.fits()


def test_a_phone_is_connected_and_revoked(
    dashboard: Dashboard, service: Service, floor: Floor, device: dict[str, Any]
) -> None:
    page = dashboard.open(f"/devices/{device['id']}")
    connect(page, floor.level_id)
    url = page.get_by_label("Address").input_value()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_text("Push URL")).to_be_visible()
    expect(dialog.get_by_text("names this very machine")).to_be_visible()
    assert scanned(page) == url
    dashboard.screenshots("device-qr")
    dialog.get_by_role("button", name="I have it").click()
    row = page.get_by_role("region", name="Phones").get_by_role("row").filter(has_text="Ada's phone")
    expect(row).to_contain_text("to be located, site1 · F2")
    expect(row).to_contain_text("never")
    expect(page.locator("dialog")).to_have_count(0)
    assert url.rpartition("/")[2] not in page.content()
    page.get_by_role("button", name="Revoke Ada's phone").click()
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    expect(row).to_contain_text("revoked")
    walk = trip(3, t0=1.76e9)
    assert service.request("POST", url, content=sensor_logger_messages(walk.samples)[0]).status_code != 200


def test_phyphox_opens_its_code_by_itself(dashboard: Dashboard, floor: Floor, device: dict[str, Any]) -> None:
    page = dashboard.open(f"/devices/{device['id']}")
    connect(page, floor.venue_id, app="phyphox")
    url = page.get_by_label("Address").input_value()
    assert url.endswith("experiment.phyphox")
    assert scanned(page) == "phyphox" + url.removeprefix("http")


def scanned(page: Page) -> str:
    """What the code on the page says: compared with codes made of the candidates, module by module."""
    from app.api.qr_codes import qr_svg

    shown = page.evaluate("decodeURIComponent(document.querySelector('.qr img').src.split(',').slice(1).join(','))")
    url = page.get_by_label("Address").input_value()
    (found,) = [text for text in (url, "phyphox" + url.removeprefix("http")) if qr_svg(text) == shown]
    return found


def test_what_is_known_is_shown_and_forgotten(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    for session_id in walk_sessions(service, floor, open_level(SAMPLE), 3):
        closed = service.post(f"/v1/sessions/{session_id}/close", {})
    known = service.get(f"/v1/devices/{closed['device_id']}")["calibrations"]
    assert known, "the sessions taught nothing"
    page = dashboard.open(f"/devices/{closed['device_id']}")
    card = page.get_by_role("region", name="Calibration")
    expect(card.get_by_text(f"{known[0]['offset'][0]:.1f} ± {known[0]['offset_sd'][0]:.1f}")).to_be_visible()
    expect(page.get_by_role("region", name="Sessions").get_by_title(session_id)).to_be_visible()
    assert dashboard.fits()
    dashboard.screenshots("device")
    assert dashboard.fits()
    card.get_by_role("button", name="Forget").click()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    assert service.get(f"/v1/devices/{closed['device_id']}")["calibrations"] == known
    card.get_by_role("button", name="Forget").click()
    page.get_by_role("dialog").get_by_role("button", name="Forget").click()
    expect(card.get_by_text("as a new device")).to_be_visible()
    assert service.get(f"/v1/devices/{closed['device_id']}")["calibrations"] == []


def test_a_walk_without_waypoints_is_mended_on_the_plan(
    dashboard: Dashboard, service: Service, hall: str, device: dict[str, Any]
) -> None:
    page = dashboard.open(f"/devices/{device['id']}")
    connect(page, hall, purpose="survey")
    url = page.get_by_label("Address").input_value()
    page.get_by_role("button", name="I have it").click()
    walk = trip(5, t0=1.76e9)
    texts = [f"corner {i}" for i in range(len(walk.waypoints.t))]
    push(service, url, *sensor_logger_messages(walk.samples, walk.waypoints, labels=texts))
    recordings = page.get_by_role("region", name="Recordings")
    expect(recordings.get_by_text("open", exact=True)).to_be_visible()
    expect(recordings.get_by_text(re.compile(r"^[1-9]\d* messages$"))).to_be_visible()
    recordings.get_by_role("button", name="End now").click()
    expect(recordings.get_by_text("waiting", exact=True)).to_be_visible()
    expect(recordings.get_by_role("button", name="End now")).to_have_count(0)
    give = recordings.get_by_role("button", name="Give waypoints")
    (cell, table) = (give.bounding_box(), recordings.get_by_role("region", name="Recordings").bounding_box())
    assert cell is not None
    assert table is not None
    assert cell["x"] + cell["width"] <= table["x"] + table["width"], "what to do is out of sight"
    give.click()
    dialog = page.get_by_role("dialog")
    send = dialog.get_by_role("button", name="Make a walk of it")
    expect(send).to_be_disabled()
    canvas = dialog.locator("canvas")
    box = canvas.bounding_box()
    assert box is not None
    for i, (dx, dy) in enumerate(((0.3, 0.7), (0.7, 0.7))):
        dialog.get_by_role("button", name=f"corner {i}", exact=False).first.click()
        canvas.click(position={"x": dx * box["width"], "y": dy * box["height"]})
    dashboard.screenshot("device-waypoints")
    send.click()
    expect(page.get_by_text("A walk was made of it.")).to_be_visible()
    expect(recordings.get_by_role("link", name="1 walk")).to_be_visible()
    (recording,) = service.get("/v1/recordings", device_id=device["id"])["items"]
    assert (recording["state"], len(recording["walk_ids"])) == ("closed", 1)


def test_a_pushed_walk_becomes_a_session(
    dashboard: Dashboard, service: Service, floor: Floor, device: dict[str, Any]
) -> None:
    made = service.post(
        "/v1/ingest-tokens",
        {"name": "phone", "app": "sensor-logger", "device_id": device["id"], "level_id": floor.level_id},
    )
    push(service, made["url"], *sensor_logger_messages(trip(6, t0=1.76e9).samples)[:10])
    page = dashboard.open(f"/devices/{device['id']}")
    link = page.get_by_role("region", name="Recordings").get_by_role("link", name="session ses_")
    expect(link).to_be_visible()
    link.click()
    expect(page.get_by_role("heading", name="Session ses_")).to_be_visible()
    expect(page.get_by_role("region", name="About the session").get_by_role("link", name="Ada's phone")).to_be_visible()
