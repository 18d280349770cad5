"""Signing in and out, navigation, and what every page is held to."""

from __future__ import annotations

import re
from typing import Literal

import pytest
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


PAIRS = [
    (text, ground)
    for ground in ("ground", "card", "side", "raised")
    for text in ("text", "soft", "accent")
] + [
    ("accent", "accent-ground"), ("on-accent", "accent"), ("good", "good-ground"), ("warn", "warn-ground"),
    ("bad", "bad-ground"), ("bad", "card"), ("text", "bad-ground"), ("text", "plan-ground"), ("second", "plan-ground"),
]  # fmt: skip
LEAST_CONTRAST = 4.5
"""WCAG 2.2, 1.4.3, level AA, for text of ordinary size."""


def luminance(colour: str) -> float:
    """Relative luminance of ``rgb(r, g, b)`` by the definition of WCAG 2."""
    shares = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shares)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(dashboard: Dashboard, scheme: Literal["light", "dark"]) -> None:
    page = dashboard.open("/nowhere")
    dashboard.colours(scheme)
    names = sorted({name for pair in PAIRS for name in pair})
    asked = "async (names) => { const m = await import('/static/theming.js'); return names.map(m.colour); }"
    shown = dict(zip(names, page.evaluate(asked, names), strict=True))
    poor = {}
    for text, ground in PAIRS:
        bright, dim = sorted((luminance(shown[text]), luminance(shown[ground])), reverse=True)
        contrast = (bright + 0.05) / (dim + 0.05)
        if contrast < LEAST_CONTRAST:
            poor[text, ground] = round(contrast, 2)
    assert not poor


def test_a_revoked_key_leads_back_to_the_door(dashboard: Dashboard, service: Service) -> None:
    dashboard.expect(401, "/v1/.*")
    made = service.post("/v1/keys", {"name": "short-lived", "scopes": ["survey"]})
    page = dashboard.open("/nowhere", key=made["secret"])
    assert service.request("DELETE", f"/v1/keys/{made['id']}").status_code == 204
    page.get_by_role("link", name="To the overview").click()
    expect(page.get_by_label("API key")).to_be_visible()
    expect(page.get_by_role("alert")).to_contain_text("A valid API key is needed")


def test_a_service_that_is_away_is_said_so(dashboard: Dashboard) -> None:
    page = dashboard.open("/venues")
    page.route("**/v1/venues?*", lambda route: route.abort())
    dashboard.watch.may_lose_requests = True
    page.get_by_label("Find venues by name").fill("x")
    expect(page.get_by_role("alert")).to_contain_text("The service cannot be reached")
