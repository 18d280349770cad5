"""Sessions: the list with its filters, one session live and again, its field profile, its files."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isodyn_client import Client, Prior
from playwright.sync_api import Page, expect

from app.cli.convert import samples_of
from app.cli.uploads import open_level
from tests.dashboard.browsing import Dashboard
from tests.dashboard.conftest import SAMPLE
from tests.dashboard.floors import Floor
from tests.dashboard.test_overview import CROWD, LEAST_FRAMES, LONG_SHARE, MEASURE, N_LIVE, SECONDS
from tests.dashboard.traffic import walk_sessions
from tests.e2e.service import Service
from tests.workers.polling import eventually


@pytest.fixture(scope="module")
def sessions(service: Service, floor: Floor) -> list[str]:
    """Three walks, the last one closed."""
    ids = walk_sessions(service, floor, open_level(SAMPLE), 3)
    service.post(f"/v1/sessions/{ids[-1]}/close", {})
    return ids


def opened(dashboard: Dashboard, session_id: str) -> Page:
    page = dashboard.open(f"/sessions/{session_id}")
    expect(page.get_by_role("application", name="Track on F2")).to_be_visible()
    return page


def test_sessions_are_listed_by_what_is_chosen(
    dashboard: Dashboard, service: Service, floor: Floor, sessions: list[str]
) -> None:
    page = dashboard.open("/sessions")
    live = page.get_by_role("region", name="Open sessions")
    past = page.get_by_role("region", name="Closed sessions")
    for session_id in sessions[:2]:
        expect(live.get_by_title(session_id)).to_be_visible()
    expect(past.get_by_title(sessions[2])).to_be_visible()
    assert dashboard.fits()
    dashboard.screenshots("sessions")
    assert dashboard.fits()
    page.get_by_label("Show", exact=True).select_option("closed")
    expect(live).to_be_hidden()
    page.get_by_label("Show", exact=True).select_option("open")
    expect(past).to_be_hidden()
    other = service.post("/v1/venues", {"name": "Elsewhere", "kind": "indoor"})
    page.reload()
    expect(live.get_by_title(sessions[0])).to_be_visible()
    page.get_by_label("Venue").select_option(other["id"])
    expect(page.get_by_text("No session is open")).to_be_visible()
    page.get_by_label("Venue").select_option(floor.venue_id)
    live.get_by_title(sessions[0]).click()
    expect(page.get_by_role("heading", name="Session ses_")).to_be_visible()
    service.request("DELETE", f"/v1/venues/{other['id']}")


def test_a_closed_session_is_played_again(dashboard: Dashboard, sessions: list[str]) -> None:
    page = opened(dashboard, sessions[2])
    reading = page.locator(".readout")
    expect(reading).to_contain_text("x ")
    last = reading.inner_text()
    slider = page.get_by_label("Time", exact=True)
    # it opens at its end, and so does the slider
    assert float(slider.input_value()) == pytest.approx(float(str(slider.get_attribute("max"))), abs=0.1)
    slider.focus()
    page.keyboard.press("Home")
    expect(reading).not_to_have_text(last)
    first = reading.inner_text()
    page.get_by_label("Speed").select_option("100")
    page.get_by_role("button", name="Play").click()
    expect(reading).not_to_have_text(first)
    expect(reading).to_have_text(last)
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    expect(page.get_by_role("img", name="Status over time")).to_be_visible()
    # a click on the middle of the strip is the middle of the time
    page.locator(".strip").click()
    total = float(str(slider.get_attribute("max")))
    assert float(slider.input_value()) == pytest.approx(total / 2, abs=0.02 * total)
    assert dashboard.fits()
    dashboard.screenshots("session")
    assert dashboard.fits()


def test_known_positions_stand_beside_what_was_told(
    dashboard: Dashboard, service: Service, sessions: list[str]
) -> None:
    page = opened(dashboard, sessions[2])
    points = service.get(f"/v1/sessions/{sessions[2]}/ground-truth")["items"]
    card = page.get_by_role("region", name="Known positions").first
    expect(card.locator("tbody tr")).to_have_count(len(points))
    inside = sum(point["fix"]["inside"] for point in points if point["fix"])
    assert card.locator(".badge.good").count() == inside
    expect(card.get_by_role("columnheader", name="x, y, m")).to_be_visible()
    page.get_by_label("Smoothed").check()
    expect(page.get_by_label("Smoothed")).to_be_enabled()
    expect(page.get_by_label("Smoothed")).to_be_checked()


def test_the_profile_is_what_the_service_says(dashboard: Dashboard, service: Service, sessions: list[str]) -> None:
    page = opened(dashboard, sessions[2])
    card = page.get_by_role("region", name="Field along the track")
    expect(card.locator(".scatterlayer .trace")).to_have_count(3)
    expect(card.locator(".xtitle")).to_have_text("time since the start, s")
    expect(card.locator(".ytitle")).to_have_text("field, µT")
    profile = service.get(f"/v1/sessions/{sessions[2]}/profile")
    for name, channel in (("Total", "total"), ("Vertical", "v")):
        card.get_by_label(name).check(force=True)
        told, mapped, sd = (profile[part][channel] for part in ("measured", "mapped", "sd"))
        apart = [(abs(a - b), c) for a, b, c in zip(told, mapped, sd, strict=True) if a is not None and b is not None]
        share = sum(one <= 2 * spread for one, spread in apart) / len(apart)
        expect(card.get_by_text(f"{100 * share:.0f}\u202f% within two deviations")).to_be_visible()


def test_files_are_taken_home(dashboard: Dashboard, sessions: list[str]) -> None:
    page = opened(dashboard, sessions[2])
    card = page.get_by_role("region", name="Files")
    expect(card.get_by_role("button", name="GPX")).to_be_disabled()
    expect(card.get_by_role("link", name="latitude and longitude")).to_be_visible()
    with page.expect_download() as caught:
        card.get_by_role("button", name="CSV").last.click()
    rows = list(csv.DictReader(io.StringIO(Path(caught.value.path()).read_text())))
    assert caught.value.suggested_filename == f"{sessions[2]}-samples.csv"
    assert len(rows) > 1000
    with page.expect_download() as caught:
        card.get_by_role("button", name="CSV").first.click()
    assert next(csv.reader(io.StringIO(Path(caught.value.path()).read_text())))[0] == "number"


def test_a_session_is_seen_as_it_goes(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    walk = open_level(SAMPLE).walks("train")[1]
    samples = samples_of(walk.samples)
    prior = Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]), radius_m=3.0)
    with Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        session = client.open_session(floor.level_id, prior=prior)
        page = opened(dashboard, session.id)
        reading = page.locator(".readout")
        expect(page.get_by_text("live", exact=True)).to_be_visible()
        parts = list(samples.split(5.0))
        for part in parts[:3]:
            session.send(part, wait=30.0)
        expect(reading).to_contain_text("x ")
        newest = session.positions()
        expect(reading).to_contain_text(f"x {newest.x[-1]:.1f} m, y {newest.y[-1]:.1f} m")
        # the longest half axis of the ellipse, not the larger side of its box
        longest = np.sqrt(5.991 * np.linalg.eigvalsh(newest.covariance[-1])[-1])
        told = re.search(r"± (\S+)\u202fm \(95\u202f%\)", reading.inner_text())
        assert told, reading.inner_text()
        assert float(told[1]) == pytest.approx(longest, rel=0.01)
        # a known position that is told meanwhile needs no reload
        client.add_ground_truth(session.id, newest.t_ms[-1:], newest.x[-1:], newest.y[-1:], sd_m=np.array([0.5]))
        # looking back: what comes does not take the reader away from where he looks
        slider = page.get_by_label("Time", exact=True)
        slider.focus()
        page.keyboard.press("Home")
        seen = reading.inner_text()
        before = float(str(slider.get_attribute("max")))
        session.send(parts[3], wait=30.0)
        eventually(lambda: float(str(slider.get_attribute("max"))) > before)
        assert reading.inner_text() == seen
        expect(page.get_by_role("region", name="Known positions").first.locator("tbody tr")).to_have_count(
            1, timeout=15_000
        )
        page.get_by_role("button", name="Live").click()
        newest = session.positions()
        expect(reading).to_contain_text(f"x {newest.x[-1]:.1f} m")
        page.get_by_role("button", name="Close session").click()
        page.get_by_role("dialog").get_by_role("button", name="Close", exact=True).last.click()
        expect(page.get_by_text("closed", exact=True)).to_be_visible()
        assert client.session_info(session.id).status == "closed"
        expect(page.get_by_role("button", name="Live")).to_be_hidden()


def test_places_that_fit_have_their_weights(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    """Without a start several places fit; the page lists those of the newest fix that names any."""
    walk = open_level(SAMPLE).walks("train")[0]
    with Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        session = client.open_session(floor.level_id)
        for part in samples_of(walk.samples).split(5.0):
            result = session.send(part, wait=60.0)
            if result.position is not None and result.position.hypotheses:
                break
        told = result.position
        assert told is not None
        assert told.hypotheses, "this walk is found at once: take another one"
        page = opened(dashboard, session.id)
        rows = page.locator(".hypotheses li")
        expect(rows).to_have_count(len(told.hypotheses))
        expect(rows.first).to_contain_text(f"x {told.hypotheses[0].x:.1f} m")
        expect(rows.first).to_contain_text(f"{100 * told.hypotheses[0].weight:.0f}\u202f%")
        dashboard.screenshot("session-ambiguous")
        session.close()


def test_two_hundred_open_sessions_stay_smooth(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    extent = service.get(f"/v1/levels/{floor.level_id}")["extent"]
    given = {
        "n": N_LIVE,
        "venue_id": floor.venue_id,
        "level_id": floor.level_id,
        "width": extent["x_max"],
        "height": extent["y_max"],
    }
    dashboard.page.add_init_script(f"({CROWD})({json.dumps(given)})")
    page = dashboard.open("/sessions")
    live = page.get_by_role("region", name="Open sessions")
    expect(live.get_by_text(str(N_LIVE), exact=True)).to_be_visible()
    cells = live.locator("tbody tr td:nth-child(4)")
    expect(live.get_by_text(f"and {N_LIVE - 100} more")).to_be_visible()
    live.get_by_role("button", name="Show all").click()
    expect(cells).to_have_count(N_LIVE)
    expect(live.get_by_text("more")).to_be_hidden()
    before = cells.all_inner_texts()
    measured: dict[str, Any] = page.evaluate(MEASURE, SECONDS)
    assert cells.all_inner_texts() != before, "the list stands still"
    assert sum(measured["long"]) < LONG_SHARE * 1000 * SECONDS, measured
    assert measured["rate"] > LEAST_FRAMES, measured


def test_known_positions_that_come_anew_replace_those_on_the_plan(dashboard: Dashboard) -> None:
    page = dashboard.open("/nowhere")
    layers = page.evaluate(
        """async () => {
          const { SessionStage } = await import("/static/session/stage.js");
          const { FixLog } = await import("/static/session/fixes.js");
          const stage = new SessionStage({ api: {} }, { level_id: "a", maps: [] }, new FixLog());
          stage.view = { layers: [], add(one) { this.layers.push(one); }, redraw() {}, remove(one) {
            this.layers = this.layers.filter((other) => other !== one);
          } };
          stage.setTruth([]);
          stage.truth.visible = false;
          stage.setTruth([]);
          return [stage.view.layers.length, stage.truth.visible];
        }"""
    )
    assert layers == [1, False]
