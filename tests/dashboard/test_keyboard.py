"""Every page by keyboard, and what a screen reader is told of each control."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.dashboard.test_level import drawn
from tests.workers.polling import eventually

FOCUSED = """
() => {
  const one = document.activeElement;
  if (!one || one === document.body) return null;
  const box = one.getBoundingClientRect();
  const labels = [...(one.labels ?? [])].map((label) => label.textContent);
  const ids = (one.getAttribute("aria-labelledby") ?? "").split(" ");
  const by = ids.map((id) => document.getElementById(id)?.textContent);
  const own = one.tagName === "INPUT" ? "" : one.textContent;
  const names = [one.getAttribute("aria-label"), ...by, ...labels, own, one.title];
  const style = getComputedStyle(one);
  const beside = one.nextElementSibling && getComputedStyle(one.nextElementSibling);
  return {
    tag: one.tagName, name: names.find((text) => text?.trim())?.trim() ?? "",
    visible: box.width > 0 && box.height > 0, outline: style.outlineStyle, beside: beside?.outlineStyle ?? "none",
    opacity: style.opacity,
  };
}
"""


def stops(page: Page, most: int = 80) -> list[dict[str, Any]]:
    """What the Tab key comes to, from the top of the page until it leaves it."""
    page.evaluate("document.activeElement?.blur()")
    found: list[dict[str, Any]] = []
    for _ in range(most):
        page.keyboard.press("Tab")
        one = page.evaluate(FOCUSED)
        if one is None:
            break
        found.append(one)
    return found


@pytest.mark.parametrize("place", ["venues", "venue", "level"])
def test_every_stop_has_a_name_and_is_seen(dashboard: Dashboard, floor: Floor, place: str) -> None:
    paths = {"venues": "/venues", "venue": f"/venues/{floor.venue_id}", "level": f"/levels/{floor.level_id}"}
    page = dashboard.open(paths[place])
    page.wait_for_load_state("networkidle")
    found = stops(page)
    assert found[0]["name"] == "Skip to the content"
    assert len(found) > 8
    for one in found:
        assert one["name"], one
        assert one["visible"], one
        assert one["outline"] != "none" or (one["opacity"] == "0" and one["beside"] != "none"), one
    # nothing that can be clicked is out of reach
    reachable = {(one["tag"], one["name"]) for one in found}
    for name in page.locator("main button:visible").all_inner_texts():
        if name:
            assert ("BUTTON", name) in reachable or any(
                name in one["name"] or one["name"].startswith(name) for one in found
            )


def test_the_page_has_landmarks_and_one_heading(dashboard: Dashboard, floor: Floor) -> None:
    page = dashboard.open(f"/levels/{floor.level_id}")
    for role in ("main", "navigation", "banner"):
        expect(page.get_by_role(role)).to_have_count(1)  # type: ignore[arg-type]
    expect(page.get_by_role("heading", level=1)).to_have_count(1)
    assert page.title().startswith("F2, site1")
    assert page.evaluate("document.documentElement.lang") == "en"


def test_the_plan_is_read_by_keyboard(dashboard: Dashboard, floor: Floor) -> None:
    page = dashboard.open(f"/levels/{floor.level_id}")
    drawn(page)
    plan = page.get_by_role("application")
    plan.focus()
    readout = page.locator(".readout")
    page.keyboard.press("ArrowRight")
    expect(readout).to_contain_text("at x")
    first = readout.inner_text()
    page.keyboard.press("ArrowUp")
    expect(readout).not_to_have_text(first)
    spoken = page.locator("body > [aria-live=polite].visually-hidden")
    expect(spoken).to_have_text(readout.inner_text())
    pixels = "document.querySelector('.level .plan canvas').toDataURL()"
    before = page.evaluate(pixels)
    page.keyboard.press("+")
    expect(plan).to_be_focused()
    eventually(lambda: page.evaluate(pixels) != before)


def test_skipping_leads_to_the_content(dashboard: Dashboard, floor: Floor) -> None:
    page = dashboard.open("/venues")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    assert page.url.endswith("#/venues")


def test_dialogs_keep_and_give_back_the_focus(dashboard: Dashboard, floor: Floor) -> None:
    page = dashboard.open("/venues")
    opener = page.get_by_role("button", name="New venue").first
    opener.focus()
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="New venue")
    expect(dialog).to_be_visible()
    for _ in range(12):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement === document.body || !!document.activeElement.closest('dialog')")
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    expect(opener).to_be_focused()


def test_a_phone_opens_the_menu(dashboard: Dashboard, floor: Floor) -> None:
    dashboard.resize(375, 812)
    page = dashboard.open(f"/levels/{floor.level_id}")
    assert dashboard.fits()
    expect(page.get_by_role("link", name="Venues").nth(0)).to_be_visible()
    menu = page.get_by_role("button", name="Menu")
    menu.click()
    expect(menu).to_have_attribute("aria-expanded", "true")
    dashboard.screenshot("menu-phone", full=False)
    page.get_by_role("navigation").get_by_role("link", name="Venues").click()
    expect(page.get_by_role("heading", name="Venues", level=1)).to_be_visible()
    expect(page.get_by_role("navigation")).to_be_hidden()
