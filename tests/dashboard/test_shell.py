"""Signing in and out, navigation, and what every page is held to."""

from __future__ import annotations

from playwright.sync_api import Page, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.e2e.service import Service


def test_signing_in_and_out(dashboard: Dashboard, page: Page, floor: Floor) -> None:
    dashboard.expect(401, "/v1/keys/current")
    page.goto("/")
    entry = page.get_by_label("API key")
    expect(entry).to_be_focused()
    dashboard.screenshots("sign-in")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text("Please fill out this field")).to_be_visible()
    entry.fill("isk_wrong")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_contain_text("A valid API key is needed")
    entry.fill(dashboard.service.key)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Overview", level=1)).to_be_visible()
    page.reload()
    expect(page.get_by_role("heading", name="Overview", level=1)).to_be_visible()
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_label("API key")).to_be_visible()
    assert page.evaluate("sessionStorage.length") == 0


def test_the_navigation_shows_what_the_key_may_do(dashboard: Dashboard, service: Service) -> None:
    key = service.post("/v1/keys", {"name": "reader", "scopes": ["locate"]})["secret"]
    page = dashboard.open("/venues", key=key)
    expect(page.get_by_role("link", name="Venues")).to_have_attribute("aria-current", "page")
    expect(page.get_by_text("reader")).to_be_visible()
    expect(page.get_by_role("button", name="New venue")).to_have_count(0)


def test_colours_are_the_readers_choice(dashboard: Dashboard) -> None:
    page = dashboard.open("/venues")
    ground = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(ground)
    page.get_by_role("button", name="Colours: system").click()
    assert page.evaluate(ground) == light
    page.get_by_role("button", name="Colours: light").click()
    dark = page.evaluate(ground)
    assert dark != light
    page.reload()
    page.get_by_role("heading", name="Venues").wait_for()
    assert page.evaluate(ground) == dark


def test_an_unknown_address_leads_back(dashboard: Dashboard) -> None:
    page = dashboard.open("/nowhere")
    page.get_by_role("link", name="To the overview").click()
    expect(page.get_by_role("heading", name="Overview", level=1)).to_be_visible()
