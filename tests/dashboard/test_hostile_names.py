"""Whatever others name things, pages show it as text."""

from __future__ import annotations

import json
import time

import pytest
from playwright.sync_api import Page, expect

from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.e2e.service import Service

NAME = '<img src="x" onerror="document.title=1"><script>document.title=2</script>{{7*7}}'
URL = "https://hooks.example.org/?<img/src=x/onerror=document.title=3>"
RING = [[120, 60], [200, 60], [200, 160], [120, 160]]
PAGES = (
    "/overview", "/sessions", "/sessions/{session}", "/devices", "/devices/{device}", "/venues?q=<img src=x>",
    "/venues/{venue}", "/surveys", "/surveys/{survey}", "/contributions", "/levels/{level}", "/levels/{mapped}",
    "/geofences", "/webhooks", "/operations", "/keys",
)  # fmt: skip
FOLLOWING = {"/overview", "/sessions", "/sessions/{session}"}
"""Pages that keep a stream open: their network is never idle."""


@pytest.fixture(scope="module")
def planted(service: Service, floor: Floor) -> dict[str, str]:
    """Things of every sort with a name that would run if it were HTML."""
    venue = service.post("/v1/venues", {"name": NAME, "kind": "indoor"})["id"]
    extent = {"x_min": 0, "y_min": 0, "x_max": 300, "y_max": 300}
    level = service.post(f"/v1/venues/{venue}/levels", {"name": NAME, "extent": extent})["id"]
    device = service.post("/v1/devices", {"name": NAME, "model": NAME[:100]})["id"]
    survey = service.post("/v1/surveys", {"level_id": level, "name": NAME})["id"]
    session = service.post("/v1/sessions", {"level_id": floor.level_id, "device_id": device})["id"]
    service.post("/v1/geofences", {"name": NAME, "level_id": level, "polygon": RING})
    service.post("/v1/geofences", {"name": NAME, "level_id": floor.level_id, "polygon": RING})
    service.post("/v1/webhooks", {"url": URL, "events": ["session.closed"]})
    service.post("/v1/keys", {"name": NAME, "scopes": ["locate"]})
    markers = {"markers": [{"name": NAME[:100], "x": 10, "y": 10}]}
    assert service.request("PUT", f"/v1/levels/{level}/markers", json=markers).is_success
    for purpose in ("survey", "locate"):
        place = level if purpose == "survey" else floor.level_id
        asked = {"name": NAME, "app": "sensor-logger", "device_id": device, "level_id": place, "purpose": purpose}
        token = service.post("/v1/ingest-tokens", asked)
        note = {"name": "annotation", "time": int(time.time() * 1e9), "values": {"text": f"{NAME}?"}}
        body = {"messageId": 0, "sessionId": NAME, "deviceId": NAME, "payload": [note]}
        pushed = service.request("POST", f"/v1/ingest/sensor-logger/{token['token']}", content=json.dumps(body))
        assert pushed.is_success
    (waiting, *_) = service.get("/v1/recordings", purpose="survey")["items"]
    assert NAME in service.post(f"/v1/recordings/{waiting['id']}/close", {})["problem"]
    ids = {"venue": venue, "level": level, "device": device, "survey": survey, "session": session}
    return {**ids, "mapped": floor.level_id}


@pytest.mark.parametrize("path", PAGES)
def test_no_name_runs_or_loads(dashboard: Dashboard, page: Page, planted: dict[str, str], path: str) -> None:
    dashboard.open(path.format(**planted))
    if path not in FOLLOWING:
        page.wait_for_load_state("networkidle")
    page.evaluate("new Promise(requestAnimationFrame)")
    for button in page.get_by_role("tab").all():
        button.click()
    assert page.locator('img[src="x"], script:not([src])').count() == 0
    assert page.title() not in {"1", "2", "3"}


def test_names_are_shown_as_they_are(dashboard: Dashboard, page: Page, planted: dict[str, str]) -> None:
    for path in ("/devices/{device}", "/venues/{venue}", "/levels/{level}", "/surveys/{survey}"):
        dashboard.open(path.format(**planted))
        expect(page.get_by_role("heading", name=NAME).first).to_be_visible()


def test_an_address_that_names_nothing_is_told_as_text(dashboard: Dashboard, page: Page) -> None:
    dashboard.expect(404, "/v1/.*")
    dashboard.open("/venues/<img src=x onerror=document.title=1>")
    assert page.locator('img[src="x"]').count() == 0
    assert page.title() != "1"
