"""The keys page: making, rotating, revoking; a secret is shown once."""

from __future__ import annotations

import httpx
from playwright.sync_api import Locator, Page, expect

from tests.dashboard.browsing import Dashboard
from tests.e2e.service import Service


def works(service: Service, secret: str) -> bool:
    url = f"http://127.0.0.1:{service.port}/v1/keys/current"
    return httpx.get(url, headers={"X-API-Key": secret}, trust_env=False).status_code == 200


def row_of(page: Page, name: str, state: str = "works") -> Locator:
    return page.get_by_role("row").filter(has_text=name).filter(has_text=state)


def create(page: Page, name: str, *scopes: str) -> str:
    page.get_by_role("button", name="New key").click()
    page.get_by_label("Name").fill(name)
    for scope in scopes:
        page.get_by_label(f"{scope}:").check()
    page.get_by_role("button", name="Create").click()
    secret = page.get_by_label("Secret").input_value()
    page.get_by_role("button", name="I have it").click()
    return secret


def test_a_key_is_made_and_its_secret_shown_once(dashboard: Dashboard, service: Service) -> None:
    page = dashboard.open("/keys")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="New key").click()
    page.get_by_role("button", name="Create").click()
    expect(page.get_by_text("Please fill out this field")).to_be_visible()
    page.get_by_label("Name").fill("phone app")
    page.get_by_label("survey:").check()
    dashboard.screenshot("keys-new")
    page.get_by_role("button", name="Create").click()
    secret = page.get_by_label("Secret").input_value()
    page.get_by_role("button", name="Copy").click()
    expect(page.get_by_text("Copied.")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == secret
    dashboard.screenshot("keys-secret")
    page.get_by_role("button", name="I have it").click()
    expect(row_of(page, "phone app")).to_contain_text("survey")
    expect(row_of(page, "phone app")).to_contain_text("never")
    assert works(service, secret)
    assert secret not in page.content()
    page.reload()
    expect(row_of(page, "phone app")).not_to_contain_text("never")
    assert dashboard.fits()
    dashboard.screenshots("keys")
    assert dashboard.fits()


def test_no_scope_is_no_key(dashboard: Dashboard) -> None:
    page = dashboard.open("/keys")
    page.get_by_role("button", name="New key").click()
    page.get_by_label("Name").fill("nobody")
    page.get_by_label("locate:").uncheck()
    page.get_by_role("button", name="Create").click()
    expect(page.get_by_text("Choose at least one.")).to_be_visible()


def test_revoking_asks_first(dashboard: Dashboard, service: Service) -> None:
    page = dashboard.open("/keys")
    secret = create(page, "short-lived")
    page.get_by_role("button", name="Revoke short-lived").click()
    page.get_by_role("button", name="Cancel").click()
    assert works(service, secret)
    page.get_by_role("button", name="Revoke short-lived").click()
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    expect(row_of(page, "short-lived", "revoked")).to_be_visible()
    expect(page.get_by_role("button", name="Revoke short-lived")).to_have_count(0)
    assert not works(service, secret)


def test_rotating_is_a_new_key_before_the_old_one_goes(dashboard: Dashboard, service: Service) -> None:
    page = dashboard.open("/keys")
    old = create(page, "gateway", "survey")
    page.get_by_role("button", name="Rotate gateway").click()
    page.get_by_role("button", name="Make a new key").click()
    new = page.get_by_label("Secret").input_value()
    assert new != old
    assert works(service, old)
    assert works(service, new)
    page.get_by_role("button", name="Revoke the old key").click()
    expect(row_of(page, "gateway")).to_contain_text("survey")
    expect(row_of(page, "gateway", "revoked")).to_be_visible()
    assert not works(service, old)
    assert works(service, new)


def test_the_tab_goes_on_with_its_rotated_key(dashboard: Dashboard, service: Service) -> None:
    own = service.post("/v1/keys", {"name": "operator", "scopes": ["admin"]})["secret"]
    page = dashboard.page
    dashboard.expect(401, "/v1/keys/current")
    page.goto("/#/keys")
    page.get_by_label("API key").fill(own)
    page.get_by_role("button", name="Sign in").click()
    expect(row_of(page, "operator")).to_contain_text("this tab’s")
    page.get_by_role("button", name="Rotate operator").click()
    page.get_by_role("button", name="Make a new key").click()
    page.get_by_role("button", name="Revoke the old key").click()
    expect(row_of(page, "operator", "revoked")).to_be_visible()
    expect(row_of(page, "operator")).to_contain_text("this tab’s")
    assert not works(service, own)
