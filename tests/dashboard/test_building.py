"""Building a map from the page of a level: ordered, followed, shown."""

from __future__ import annotations

import re
from typing import Any

from playwright.sync_api import Page, Route, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.test_level import drawn
from tests.e2e.service import Service, upload_survey


def _held(page: Page) -> set[str]:
    """Jobs are told to run still, for as long as the set is not empty: a small build may be over before it is seen."""
    held = {"build_map"}

    def answer(route: Route) -> None:
        told = route.fetch()
        body = told.json()
        items = body.get("items", [body])
        if held and "queued" not in route.request.url:
            running = {"state": "running", "progress": 0.4, "progress_text": "placing walks", "finished_at": None}
            mine = [job for job in items if job["kind"] in held] or _builds(route)
            items[:] = [{**job, **running} for job in mine]
            body = body | ({"items": items} if "items" in body else items[0])
        route.fulfill(response=told, json=body)

    page.route(re.compile("/v1/jobs"), answer)
    return held


def _builds(route: Route) -> list[dict[str, Any]]:
    """The newest build, whatever its state."""
    address = route.request.url.partition("?")[0]
    found = route.fetch(url=f"{address}?kind=build_map&limit=1").json()
    items: list[dict[str, Any]] = found["items"]
    return items


def test_a_map_is_built_and_brought_up_to_date(dashboard: Dashboard, service: Service) -> None:
    level_id = upload_survey(service)
    page = dashboard.open(f"/levels/{level_id}")
    under_way = _held(page)
    expect(page.get_by_text("There is no map yet")).to_be_visible()
    page.get_by_role("button", name="Build the map").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Distance of nodes").fill("0.01")
    dialog.get_by_role("button", name="Start").click()
    expect(dialog.get_by_label("Distance of nodes")).to_have_attribute("aria-invalid", "true")
    dialog.get_by_label("Distance of nodes").fill("1")
    dialog.get_by_role("button", name="Start").click()
    expect(page.get_by_role("progressbar", name="Progress of the map")).to_be_visible()
    page.reload()
    expect(page.get_by_role("progressbar", name="Progress of the map")).to_be_visible()
    expect(page.get_by_role("button", name=re.compile("(Build|Update) the map"))).to_be_disabled()
    under_way.clear()
    expect(page.get_by_text("The map was built.")).to_be_visible(timeout=60_000)
    drawn(page)
    (first,) = service.get("/v1/maps", level_id=level_id)["items"]
    assert (first["features"], first["cell_m"]) == ("vector", 1.0)

    (survey,) = service.get("/v1/surveys", level_id=level_id)["items"]
    walk = service.get(f"/v1/surveys/{survey['id']}/walks")["items"][-1]
    assert service.request("DELETE", f"/v1/surveys/{survey['id']}/walks/{walk['id']}").status_code == 204
    page.get_by_role("button", name="Update the map").click()
    expect(dialog.get_by_label("Distance of nodes")).to_be_hidden()
    dialog.get_by_label("Use it for new sessions").uncheck()
    dialog.get_by_role("button", name="Start").click()
    expect(page.get_by_role("button", name="Publish 2")).to_be_visible(timeout=60_000)
    level = service.get(f"/v1/levels/{level_id}")
    assert level["current_map_id"] == first["id"]
    (update, _) = service.get("/v1/maps", level_id=level_id)["items"]
    assert (update["kind"], update["removed"]) == ("update", [walk["id"]])
