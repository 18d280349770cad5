"""Surveys: made, filled with files by drag and drop, seen on the plan, mapped."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.api.harness import plain, walk_body
from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.e2e.service import Service
from tests.exchange.recordings import plain_csv

DROP = """(zone, files) => {
  const data = new DataTransfer();
  for (const {name, text} of files) {
    data.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));
  }
  for (const kind of ["dragenter", "dragover", "drop"]) {
    zone.dispatchEvent(new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}));
  }
}"""


@pytest.fixture
def level_id(service: Service, floor: Floor) -> str:
    """A level of its own, without a plan; beside the floor, which is surveyed already."""
    venue = service.post("/v1/venues", {"name": "Survey hall", "kind": "indoor"})
    extent = {"x_min": -5, "y_min": -5, "x_max": 60, "y_max": 40}
    asked = {"name": "hall", "ordinal": 9, "extent": extent}
    level = service.post(f"/v1/venues/{venue['id']}/levels", asked)
    return str(level["id"])


@pytest.fixture
def survey(service: Service, level_id: str) -> dict[str, Any]:
    return service.post("/v1/surveys", {"level_id": level_id, "name": "spring"})


def drop(page: Page, *files: tuple[str, bytes]) -> None:
    """Drop files onto the page, as from a folder."""
    given = [{"name": name, "text": base64.b64encode(content).decode()} for name, content in files]
    page.locator(".drop").evaluate(DROP, given)


def test_surveys_are_listed_by_level(dashboard: Dashboard, floor: Floor, survey: dict[str, Any]) -> None:
    page = dashboard.open("/surveys")
    expect(page.get_by_role("link", name="spring").first).to_be_visible()
    assert page.locator("tbody tr").count() >= 3
    page.get_by_label("Level").select_option(survey["level_id"])
    expect(page.locator("tbody tr")).to_have_count(1)
    dashboard.screenshots("surveys")
    assert dashboard.fits()
    page.reload()
    expect(page.locator("tbody tr")).to_have_count(1)


def test_a_survey_is_made(dashboard: Dashboard, level_id: str) -> None:
    page = dashboard.open("/surveys")
    page.get_by_role("button", name="New survey").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Level").select_option(level_id)
    dialog.get_by_role("button", name="Create").click()
    expect(dialog.get_by_text("Please fill out this field")).to_be_visible()
    dialog.get_by_label("Name").fill("autumn")
    dialog.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="autumn", level=1)).to_be_visible()
    expect(page.get_by_text("No walks yet")).to_be_visible()


def test_files_are_dropped_checked_and_stored(dashboard: Dashboard, service: Service, survey: dict[str, Any]) -> None:
    page = dashboard.open(f"/surveys/{survey['id']}")
    page.get_by_label("Check only, store nothing").check()
    drop(page, ("hall.csv", plain_csv()))
    expect(page.get_by_text("1 walks read, 1 would be stored.")).to_be_visible()
    assert service.get(f"/v1/surveys/{survey['id']}")["n_walks"] == 0
    page.get_by_label("Check only, store nothing").uncheck()
    drop(page, ("hall.csv", plain_csv()), ("again.csv", plain_csv()))
    expect(page.get_by_text("1 walks read, 1 stored.")).to_be_visible()
    expect(page.get_by_text("there already")).to_be_visible()
    expect(page.get_by_text("1 walks, ")).to_be_visible()
    expect(page.get_by_role("button", name="hall", exact=True)).to_be_visible()
    assert service.get(f"/v1/surveys/{survey['id']}")["n_walks"] == 1


def test_what_cannot_be_read_is_told_with_its_remedy(dashboard: Dashboard, survey: dict[str, Any]) -> None:
    dashboard.expect(422, f"/v1/surveys/{survey['id']}/import")
    page = dashboard.open(f"/surveys/{survey['id']}")
    drop(page, ("broken.zip", b"no zip"), ("what.xyz", b"1"))
    alerts = page.get_by_role("alert")
    expect(alerts).to_have_count(2)
    expect(page.get_by_text("export the survey again")).to_be_visible()
    expect(page.get_by_text("does not tell its format")).to_be_visible()
    dashboard.screenshots("survey-problems")
    assert dashboard.fits()


def test_a_walk_is_sent_chosen_and_deleted(
    dashboard: Dashboard, service: Service, survey: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "corridor.json"
    file.write_bytes(httpx.Request("POST", "http://x", json=plain(walk_body("corridor"))).content)
    page = dashboard.open(f"/surveys/{survey['id']}")
    page.locator("input[type=file]").set_input_files(file)
    walk = page.get_by_role("button", name="corridor", exact=True)
    walk.click()
    expect(page.locator("tr.chosen")).to_have_count(1)
    page.get_by_role("button", name="Delete corridor").click()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    assert service.get(f"/v1/surveys/{survey['id']}")["n_walks"] == 1
    page.get_by_role("button", name="Delete corridor").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_text("No walks yet")).to_be_visible()
    assert service.get(f"/v1/surveys/{survey['id']}")["n_walks"] == 0


def test_walks_lie_on_the_plan(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    survey = service.get("/v1/surveys", level_id=floor.level_id)["items"][0]
    page = dashboard.open(f"/surveys/{survey['id']}")
    rows = page.locator("tr[data-walk]")
    expect(rows).to_have_count(survey["n_walks"])
    rows.nth(2).get_by_role("button").first.click()
    expect(page.locator("tr.chosen")).to_have_count(1)
    dashboard.screenshots("survey")
    assert dashboard.fits()
    canvas = page.locator("canvas")
    before = canvas.screenshot()
    rows.nth(4).get_by_role("button").first.click()
    expect(rows.nth(4)).to_have_class("chosen")
    assert canvas.screenshot() != before


def test_a_map_is_built_from_a_survey(dashboard: Dashboard, service: Service, survey: dict[str, Any]) -> None:
    service.request(
        "POST", f"/v1/surveys/{survey['id']}/import", params={"format": "csv"}, content=plain_csv(),
        headers={"Content-Type": "text/csv"},
    )  # fmt: skip
    page = dashboard.open(f"/surveys/{survey['id']}")
    page.get_by_role("button", name="Make a map").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Distance of nodes, m").fill("20")
    dialog.get_by_role("button", name="Start").click()
    expect(dialog.get_by_text("Value must be less than or equal to 10")).to_be_visible()
    dialog.get_by_label("Distance of nodes, m").fill("1")
    dialog.get_by_role("button", name="Start").click()
    page.wait_for_url(f"**/#/levels/{survey['level_id']}?map_id=*", timeout=60_000)
    level = service.get(f"/v1/levels/{survey['level_id']}")
    assert service.get(f"/v1/maps/{level['current_map_id']}")["cell_m"] == 1.0


def test_surveys_need_their_scope(dashboard: Dashboard, service: Service) -> None:
    key = service.post("/v1/keys", {"name": "reader", "scopes": ["locate"]})["secret"]
    page = dashboard.open("/surveys", key=key)
    expect(page.get_by_text("This key may not see that")).to_be_visible()
    expect(page.get_by_role("link", name="Contributions")).to_have_count(0)
