"""The operations page: tables and charts, filters, CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from app.cli.uploads import open_level
from tests.dashboard.browsing import Dashboard
from tests.dashboard.conftest import SAMPLE
from tests.dashboard.floors import Floor
from tests.dashboard.traffic import walk_sessions
from tests.e2e.service import Service
from tests.workers.polling import eventually

CHARTS_FIT = (
    "[...document.querySelectorAll('.main-svg')].every((one) => one.getBoundingClientRect().right <= innerWidth)"
)
EXTENT = {"x_min": 0, "y_min": 0, "x_max": 20, "y_max": 10}
SECTIONS = (
    "Alarms", "Latency", "Throughput", "Backlog", "Errors", "Fixes by what they claim", "Error budget", "Levels",
    "Storage",
)  # fmt: skip


@pytest.fixture(scope="module")
def session_id(service: Service, floor: Floor) -> str:
    return walk_sessions(service, floor, open_level(SAMPLE), 1)[0]


@pytest.fixture
def operations(dashboard: Dashboard, session_id: str) -> Page:
    return dashboard.open("/operations")


def section(page: Page, name: str) -> Locator:
    return page.get_by_role("region", name=name, exact=True).first


def test_every_section_shows_something(dashboard: Dashboard, operations: Page) -> None:
    for name in SECTIONS:
        expect(section(operations, name).locator("[aria-busy]")).to_have_count(0)
        expect(section(operations, name).get_by_role("alert")).to_have_count(0)
    expect(section(operations, "Latency").locator(".scatterlayer .trace")).to_have_count(4)
    expect(section(operations, "Throughput").locator(".scatterlayer .trace")).to_have_count(1)
    expect(section(operations, "Throughput").locator(".barlayer .trace")).to_have_count(1)
    expect(section(operations, "Backlog").get_by_role("cell", name="Map builds")).to_be_visible()
    expect(section(operations, "Fixes by what they claim").get_by_role("cell", name="site1 · F2")).to_be_visible()
    expect(section(operations, "Levels").get_by_role("link", name="site1 · F2")).to_be_visible()
    expect(section(operations, "Latency").locator(".ytitle")).to_have_text("time, ms")
    expect(section(operations, "Error budget").get_by_role("cell", name="sure", exact=True)).to_be_visible()
    expect(section(operations, "Levels").get_by_role("cell", name="version 2")).to_be_visible()
    expect(section(operations, "Storage").get_by_role("cell", name="Free on the disk")).to_be_visible()
    assert dashboard.fits()
    dashboard.screenshots("operations")
    dashboard.resize(375)
    # asked from outside: the page's policy lets no text be run in it
    eventually(lambda: bool(operations.evaluate(CHARTS_FIT)))
    assert dashboard.fits()


def test_latency_of_other_jobs_and_spans(operations: Page, service: Service) -> None:
    latency = section(operations, "Latency")
    latency.get_by_text("Figures").click()
    rows = latency.locator("tbody tr")
    expect(rows.first).to_be_visible()
    segments = rows.all_inner_texts()
    latency.get_by_label("Waiting", exact=True).check()
    assert rows.all_inner_texts() != segments
    latency.get_by_label("Map builds").check()
    # other tests of the folder build maps too
    jobs = [row for row in service.get("/v1/stats/latency", bucket="hour")["items"] if row["kind"] == "build_map"]
    assert [row.split("\t")[1] for row in rows.all_inner_texts()] == [str(row["n"]) for row in jobs]


def test_filters_narrow_and_stay_in_the_address(operations: Page, service: Service, floor: Floor) -> None:
    other = service.post(f"/v1/venues/{floor.venue_id}/levels", {"name": "Cellar", "ordinal": -1, "extent": EXTENT})
    operations.reload()
    operations.get_by_label("Level", exact=True).select_option(other["id"])
    expect(section(operations, "Fixes by what they claim").get_by_text("No fixes.")).to_be_visible()
    expect(section(operations, "Throughput").get_by_text("0 segments, 0 samples, 0 fixes")).to_be_visible()
    operations.get_by_label("Time", exact=True).first.select_option("Last 7 days")
    assert f"level_id={other['id']}" in operations.url
    assert "span=week" in operations.url
    operations.reload()
    expect(operations.get_by_label("Level", exact=True)).to_have_value(other["id"])
    expect(section(operations, "Fixes by what they claim").get_by_text("No fixes.")).to_be_visible()


def test_fixes_and_errors_are_told_apart_by_device(operations: Page) -> None:
    operations.get_by_label("Fixes and errors by").select_option("Device")
    for name in ("Fixes by what they claim", "Error budget"):
        expect(section(operations, name).get_by_role("columnheader", name="Device")).to_be_visible()
        expect(section(operations, name).get_by_role("cell", name="trolley").first).to_be_visible()
    assert "by=device" in operations.url


def test_every_table_can_be_taken_home(operations: Page, tmp_path: Path) -> None:
    for name, column in (("Throughput", "fixes_per_s"), ("Error budget", "inside_share"), ("Storage", "part")):
        with operations.expect_download() as started:
            operations.get_by_role("button", name=f"{name} as CSV").click()
        file = tmp_path / started.value.suggested_filename
        started.value.save_as(file)
        with file.open(newline="") as lines:
            rows = list(csv.DictReader(lines))
        assert rows, name
        assert column in rows[0]


def test_errors_show_their_newest_example(dashboard: Dashboard, service: Service, session_id: str) -> None:
    """No job fails by itself here, so the answer is made up; that the service gives it is tested there."""
    row = {
        "kind": "locate_segment", "text": "no cell (…, …)", "n": 12, "share": 0.031,
        "first_at": "2026-11-22T09:00:00Z", "last_at": "2026-11-22T10:00:00Z",
        "example_job_id": "job_1", "example_subject_id": session_id, "example_seq": 7,
        "example_error": "no cell (12, 7) <b>",
    }  # fmt: skip
    answer = {"items": [row], "complete_since": row["first_at"]}
    dashboard.page.route("**/v1/stats/errors?*", lambda route: route.fulfill(json=answer))
    page = dashboard.open("/operations")
    errors = section(page, "Errors")
    expect(errors.get_by_text("no cell (…, …)")).to_be_visible()
    expect(errors.get_by_text("3.1")).to_be_visible()
    expect(errors.get_by_text("Complete only since")).to_be_visible()
    errors.get_by_text("segment 7").click()
    expect(errors.get_by_text("no cell (12, 7) <b>")).to_be_visible()


def test_the_page_is_for_operators(dashboard: Dashboard, service: Service) -> None:
    key = service.post("/v1/keys", {"name": "app", "scopes": ["locate", "survey"]})["secret"]
    page = dashboard.open("/operations", key=key)
    expect(page.get_by_text("This key may not see that")).to_be_visible()
    expect(page.get_by_role("link", name="Operations")).to_have_count(0)
