"""Contributions: the queue, its filters, and what a reviewer may do."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import isodyn_client as isodyn
import pytest
from playwright.sync_api import Page, Route, expect

from app.cli.convert import samples_of
from app.cli.transport import ServiceTransport
from app.cli.uploads import level_upload, open_level
from tests.dashboard.browsing import Dashboard
from tests.dashboard.conftest import SAMPLE
from tests.dashboard.floors import SETTINGS, WALKS_EACH, Floor
from tests.e2e.service import Service

N_SESSIONS = 3


@pytest.fixture(scope="module")
def level_id(service: Service) -> str:
    """A mapped level of its own: contributions make new versions of its map."""
    data = open_level(SAMPLE)
    with isodyn.Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        transport = ServiceTransport(client)
        made = transport.add_level(replace(level_upload(data), site="Reviewed hall"))
        walks = [walk.survey_walk() for walk in data.walks("train")[:WALKS_EACH]]
        transport.add_walks(made, walks, lambda *_: None)
        transport.build_map(made, SETTINGS, lambda *_: None)
    return made


@pytest.fixture(scope="module")
def offered(service: Service, level_id: str) -> list[dict[str, Any]]:
    """What sessions of surveyed walks offered, newest first, once all of it is weighed."""
    walks = open_level(SAMPLE).walks("train")[:N_SESSIONS]
    with isodyn.Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        for walk in walks:
            start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]), radius_m=1.0)
            with client.open_session(level_id, prior=start, contribute=True) as session:
                for _ in session.send_all(samples_of(walk.samples), wait=20):
                    pass
    for _ in range(3):
        service.await_all_jobs()
    items: list[dict[str, Any]] = service.get("/v1/contributions", level_id=level_id)["items"]
    assert len(items) == N_SESSIONS
    return items


@pytest.fixture
def queue(dashboard: Dashboard, offered: list[dict[str, Any]]) -> Page:
    page = dashboard.open(f"/contributions?level_id={offered[0]['level_id']}")
    expect(rows(page)).to_have_count(len(offered))
    return page


def rows(page: Page) -> Any:
    return page.get_by_role("region", name="Contributions").locator("tbody tr")


def test_the_queue_tells_state_and_verdict(dashboard: Dashboard, queue: Page, offered: list[dict[str, Any]]) -> None:
    for row, one in zip(rows(queue).all(), offered, strict=True):
        expect(row.locator(".badge")).to_have_text(one["state"])
        expect(row).to_contain_text(f"{one['n_kept']} of {one['n_steps']}")
        expect(row).to_contain_text(
            one["verdict"] or ("nothing was sure enough" if one["state"] == "empty" else "not yet weighed")
        )
        for reason in one["reasons"]:
            expect(row).to_contain_text(reason)
    dashboard.screenshots("contributions")
    assert dashboard.fits()
    level, state = (queue.get_by_label(name).bounding_box() for name in ("Level", "State"))
    assert level is not None
    assert state is not None
    assert level["y"] == state["y"], "the filters stand one below the other"


def test_filters_are_kept_in_the_address(queue: Page, offered: list[dict[str, Any]]) -> None:
    state = offered[0]["state"]
    same = sum(one["state"] == state for one in offered)
    queue.get_by_label("State").select_option(state)
    expect(rows(queue)).to_have_count(same)
    queue.reload()
    expect(rows(queue)).to_have_count(same)
    unused = next(one for one in ("rejected", "offered", "waiting") if one not in {x["state"] for x in offered})
    queue.get_by_label("State").select_option(unused)
    expect(queue.get_by_text("None of this kind")).to_be_visible()
    queue.get_by_label("State").select_option("")
    rows(queue).first.get_by_role("button", name="key …").click()
    taken = queue.get_by_role("button", name="No longer only of key")
    expect(taken).to_be_visible()
    taken.click()
    expect(taken).to_have_count(0)


def test_a_contribution_is_rejected_and_restored(queue: Page, service: Service, offered: list[dict[str, Any]]) -> None:
    one = offered[0]
    row = rows(queue).first
    row.get_by_role("button", name="Reject").click()
    expect(row.locator(".badge")).to_have_text("rejected")
    assert service.get(f"/v1/contributions/{one['id']}")["state"] == "rejected"
    expect(row.get_by_role("button", name="Restore")).to_be_focused()
    row.get_by_role("button", name="Restore").click()
    expect(row.locator(".badge")).not_to_have_text("rejected")
    assert service.get(f"/v1/contributions/{one['id']}")["state"] != "rejected"
    for _ in range(3):
        service.await_all_jobs()


def test_where_it_was_is_shown(dashboard: Dashboard, queue: Page, offered: list[dict[str, Any]]) -> None:
    number = next(i for i, one in enumerate(offered) if one["box"])
    x_min = offered[number]["box"][0]
    rows(queue).nth(number).get_by_role("button", name="Where").click()
    dialog = queue.get_by_role("dialog")
    expect(dialog).to_contain_text(f"x {x_min:.1f} to")
    expect(dialog.locator("canvas")).to_be_visible()
    dashboard.screenshot("contribution-box-light", full=False)
    queue.keyboard.press("Escape")
    expect(dialog).to_have_count(0)


@pytest.fixture
def changed(dashboard: Dashboard, floor: Floor) -> Iterator[None]:
    """One lasting change, as the API tells it: to make one takes days of traffic."""
    change = {
        "id": "chg_1", "level_id": floor.level_id, "map_id": floor.map_ids[1], "box": [20.0, 8.0, 25.0, 13.0],
        "area_m2": 24.0, "delta": [1.1, -3.9, 14.2], "after": None, "before": "2026-11-21T08:11:00.000Z",
        "created_at": "2026-11-22T09:42:12.000Z",
    }  # fmt: skip

    def answer(route: Route) -> None:
        route.fulfill(content_type="application/json", body=json.dumps({"items": [change], "next_cursor": None}))

    dashboard.page.route("**/v1/changes?*", answer)
    yield
    dashboard.page.unroute("**/v1/changes?*")


def test_lasting_changes_are_listed(dashboard: Dashboard, changed: None) -> None:
    page = dashboard.open("/contributions")
    table = page.get_by_role("region", name="Lasting changes of the field")
    expect(table).to_contain_text("1.1, -3.9, 14.2")
    table.get_by_role("button", name="Where").click()
    expect(page.get_by_role("dialog")).to_contain_text("x 20.0 to 25.0 m")


def test_only_admins_decide(dashboard: Dashboard, service: Service, offered: list[dict[str, Any]]) -> None:
    key = service.post("/v1/keys", {"name": "surveyor", "scopes": ["survey"]})["secret"]
    page = dashboard.open(f"/contributions?level_id={offered[0]['level_id']}", key=key)
    expect(rows(page)).to_have_count(len(offered))
    expect(page.get_by_role("button", name="Reject")).to_have_count(0)
    expect(page.get_by_role("button", name="Delete")).to_have_count(0)


def test_one_is_deleted_after_a_question(queue: Page, service: Service, offered: list[dict[str, Any]]) -> None:
    last = offered[-1]
    rows(queue).last.get_by_role("button", name="Delete").click()
    dialog = queue.get_by_role("dialog")
    expect(dialog).to_contain_text("forgotten for good")
    dialog.get_by_role("button", name="Cancel").click()
    expect(rows(queue)).to_have_count(len(offered))
    rows(queue).last.get_by_role("button", name="Delete").click()
    dialog.get_by_role("button", name="Delete").click()
    expect(rows(queue)).to_have_count(len(offered) - 1)
    left = [one["id"] for one in service.get("/v1/contributions", level_id=last["level_id"])["items"]]
    assert left == [one["id"] for one in offered[:-1]]
