"""A real service with a real floor, and a browser that notices everything that goes wrong on a page.

Fixtures for the tests of pages:

* ``service``: the running ``Service``: ``service.post("/v1/...", {...})`` makes what a test needs.
* ``floor``: the sample floor in it: venue, level with plans, surveys, and two map versions of 1 m cells.
* ``dashboard``: a browser page on that service; ``dashboard.open("/venues")`` is signed in as admin.
* ``page``: the Playwright page itself. A console error, an exception, a request to another host or an answer of 400 or
  more fails the test, unless it said before ``dashboard.expect(404, "/v1/markers")``.

``ISODYN_SCREENSHOTS=folder`` keeps what ``dashboard.screenshot(name)`` takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from app.cli.uploads import open_level
from tests.dashboard.browsing import Dashboard, Watch
from tests.dashboard.floors import Floor, survey_floor
from tests.e2e.service import Service
from tests.support.programs import program

ARGUMENTS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
SAMPLE = Path(__file__).resolve().parents[2] / "maps" / "samples" / "ilc20" / "site1-F2"


WIDTH, HEIGHT = 1280, 800


@pytest.fixture(scope="package")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("dashboard")
    service = Service(folder / "data", environment={"ISODYN_WORKERS": "1", "ISODYN_POOL": "threads"})
    try:
        service.start()
        yield service
    finally:
        service.clean_up()


@pytest.fixture(scope="package")
def floor(service: Service) -> Floor:
    """The sample floor, surveyed twice; made once for all tests: what a test changes it must change back."""
    return survey_floor(service, open_level(SAMPLE))


# Not of the whole session: while Playwright runs, nothing else in this process can have an event loop.
@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    executable = program("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture
def dashboard(browser: Browser, service: Service) -> Iterator[Dashboard]:
    context = browser.new_context(
        base_url=f"http://127.0.0.1:{service.port}",
        viewport={"width": WIDTH, "height": HEIGHT},
        locale="en-GB",
        timezone_id="UTC",
        reduced_motion="reduce",
        accept_downloads=True,
    )
    context.set_default_timeout(10_000)
    watch = Watch(f"127.0.0.1:{service.port}")
    page = context.new_page()
    watch.follow(page)
    yield Dashboard(page, service, watch)
    context.close()
    watch.verify()


@pytest.fixture
def page(dashboard: Dashboard) -> Page:
    return dashboard.page
