"""docs/tutorial-survey.md, done in the browser on an empty service: from a picture of the floor to a position.

The phone is played by ``tests.support.phones``: the messages of Sensor Logger, as they come, with the markers' names as
annotations. ``ISODYN_TUTORIAL=docs/pictures`` draws the tutorial's pictures anew.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw
from playwright.sync_api import Browser, Page, expect

from tests.dashboard.browsing import Dashboard, Watch
from tests.dashboard.test_level import drawn
from tests.e2e.service import Service
from tests.e2e.synthetic import HEIGHT, WIDTH, Point, Walk, trip, walk
from tests.support.phones import Phone, sensor_logger_messages

pytestmark = pytest.mark.timeout(300)

EDGE = 2.0
"""The picture begins so many metres left of and below the hall's own origin."""
PX_PER_M = 30
ROWS = np.arange(0.0, HEIGHT + 0.1, 1.5)
COLUMNS = np.arange(0.0, WIDTH + 0.1, 3.0)
MOST_BYTES = 150_000


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[Service]:
    service = Service(tmp_path / "data", environment={"ISODYN_WORKERS": "1", "ISODYN_POOL": "threads"})
    try:
        service.start()
        yield service
    finally:
        service.clean_up()


@pytest.fixture
def page(empty: Service, browser: Browser) -> Iterator[Page]:
    context = browser.new_context(
        base_url=f"http://127.0.0.1:{empty.port}",
        viewport={"width": 1100, "height": 760},
        locale="en-GB",
        timezone_id="UTC",
        reduced_motion="reduce",
    )
    context.set_default_timeout(30_000)
    watch = Watch(f"127.0.0.1:{empty.port}")
    made = context.new_page()
    watch.follow(made)
    yield Dashboard(made, empty, watch).page
    context.close()
    watch.verify()


def floor_plan() -> bytes:
    """Shelves between the aisles that the walks go along."""
    size = (round((WIDTH + 2 * EDGE) * PX_PER_M), round((HEIGHT + 2 * EDGE) * PX_PER_M))
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    draw.rectangle((8, 8, size[0] - 9, size[1] - 9), outline="#444", width=6)
    for y in (ROWS[:-1] + ROWS[1:]) / 2:
        for x in (COLUMNS[:-1] + COLUMNS[1:]) / 2:
            left, top = (x - 1.0 + EDGE) * PX_PER_M, size[1] - (y + 0.3 + EDGE) * PX_PER_M
            draw.rectangle((left, top, left + 2.0 * PX_PER_M, top + 0.6 * PX_PER_M), fill="#d9e2e0", outline="#9aa8a5")
    out = io.BytesIO()
    picture.save(out, "PNG")
    return out.getvalue()


@dataclass(frozen=True)
class Marked:
    """A walk past markers: what the surveyor calls each."""

    walk: Walk
    names: Sequence[str]


def marked(corners: Sequence[tuple[str, Point]], *, t0: float, seed: int) -> Marked:
    return Marked(walk([point for _, point in corners], t0=t0, seed=seed), [name for name, _ in corners])


def aisles(first: int, last: int) -> list[tuple[str, Point]]:
    """There and back: west end, east end of each aisle."""
    rows = enumerate(ROWS[first:last], start=first + 1)
    return [one for i, row in rows for one in ((f"W{i}", (0.0, float(row))), (f"E{i}", (WIDTH, float(row))))]


def gaps() -> list[tuple[str, Point]]:
    """Across the aisles: south end, north end of each gap between shelves."""
    columns = enumerate(COLUMNS, start=1)
    return [one for i, at in columns for one in ((f"S{i}", (float(at), 0.0)), (f"N{i}", (float(at), HEIGHT)))]


def push(service: Service, url: str, recorded: Walk, labels: Sequence[str] | None, name: str) -> None:
    """What Sensor Logger sends of a walk, a message a second."""
    waypoints = None if labels is None else recorded.waypoints
    messages = sensor_logger_messages(recorded.samples, waypoints, phone=Phone(session_id=name), labels=labels or ())
    for body in messages:
        answer = service.request("POST", url, content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 200, answer.text


class Album:
    """The tutorial's pictures, drawn if they are asked for."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.folder = os.environ.get("ISODYN_TUTORIAL")

    def take(self, name: str) -> None:
        if self.folder is None:
            return
        self.page.evaluate("document.querySelectorAll('.toast').forEach((one) => one.remove()); scrollTo(0, 0)")
        shot = Image.open(io.BytesIO(self.page.screenshot()))
        path = Path(self.folder) / f"survey-{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        # a palette is enough for flat colours, and a third of the size
        shot.convert("RGB").quantize(colors=128).save(path, optimize=True)
        assert path.stat().st_size < MOST_BYTES, path


def sign_in(page: Page, service: Service, album: Album) -> None:
    page.goto("/")
    page.get_by_label("API key").fill(service.key)
    album.take("sign-in")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("heading", name="Overview")).to_be_visible()


def make_level(page: Page, album: Album) -> str:
    page.get_by_role("link", name="Venues").click()
    page.get_by_role("button", name="New venue").first.click()
    page.get_by_label("Name", exact=False).last.fill("Warehouse")
    page.get_by_role("button", name="Create").click()
    page.get_by_role("button", name="New level").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Name").fill("Ground floor")
    dialog.get_by_label("Width of the plan").fill(str(WIDTH + 2 * EDGE))
    plan = {"name": "plan.png", "mimeType": "image/png", "buffer": floor_plan()}
    dialog.get_by_label("Plan picture").set_input_files(plan)  # type: ignore[arg-type]
    album.take("level")
    dialog.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="Ground floor", level=1)).to_be_visible()
    return page.url.rpartition("/")[2].partition("?")[0]


def set_markers(page: Page, named: Sequence[tuple[str, Point]], album: Album) -> None:
    card = page.get_by_role("region", name="Markers")
    card.get_by_role("button", name="Edit markers").click()
    plan = page.get_by_role("application").first
    for i, (name, (x, y)) in enumerate(named):
        plan.click(position={"x": 120 + 8 * (i % 30), "y": 120})
        row = card.locator("li").last
        row.get_by_label("Name").fill(name)
        row.get_by_label(f"x of {'P'}{i + 1}, m").fill(f"{x + EDGE:.1f}")
        row.get_by_label(f"y of {'P'}{i + 1}, m").fill(f"{y + EDGE:.1f}")
        row.get_by_label(f"y of {'P'}{i + 1}, m").press("Tab")
    album.take("markers")
    card.get_by_role("button", name="Save markers").click()
    expect(page.get_by_text("The markers were saved.")).to_be_visible()


def connect(page: Page, place: str, *, survey: bool, album: Album | None = None) -> str:
    """Make an address for a phone; returns it."""
    page.get_by_role("button", name="Connect a phone").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("What for").select_option("survey" if survey else "locate")
    dialog.get_by_label("Where").select_option(place)
    if survey:
        dialog.get_by_label("When a walk has come in").select_option("draft")
    dialog.get_by_role("button", name="Make the address").click()
    expect(dialog.get_by_role("img", name="QR code of the address")).to_be_visible()
    url = dialog.get_by_label("Address").input_value()
    if album:
        album.take("phone")
    dialog.get_by_role("button", name="I have it").click()
    return url


def end_recording(page: Page) -> None:
    recordings = page.get_by_role("region", name="Recordings")
    recordings.get_by_role("button", name="End now").click()
    expect(page.get_by_text("The recording is ended.")).to_be_visible()
    expect(recordings.get_by_role("button", name="End now")).to_have_count(0)


def shown_area(page: Page) -> float:
    text = page.locator(".figure").filter(has_text="mapped").locator("b").last.inner_text()
    return float(text.partition("\u202f")[0].replace(",", ""))


def test_a_floor_is_surveyed_in_an_afternoon(page: Page, empty: Service) -> None:
    album = Album(page)
    sign_in(page, empty, album)
    level_id = make_level(page, album)
    corners = [*aisles(0, len(ROWS)), *gaps()]
    set_markers(page, corners, album)
    page.get_by_role("link", name="Devices").click()
    page.get_by_role("button", name="New device").first.click()
    page.get_by_label("Name").fill("Ada’s phone")
    page.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="Ada’s phone", level=1)).to_be_visible()
    device_url = page.url
    url = connect(page, level_id, survey=True, album=album)
    walks = [
        marked(aisles(0, 4), t0=1.76e9, seed=1),
        marked(aisles(4, len(ROWS)), t0=1.76e9 + 1000.0, seed=2),
        marked(gaps(), t0=1.76e9 + 2000.0, seed=3),
    ]
    areas = []
    for i, one in enumerate(walks):
        page.goto(device_url)
        expect(page.get_by_role("heading", name="Ada’s phone", level=1)).to_be_visible()
        push(empty, url, one.walk, one.names, f"walk-{i}")
        end_recording(page)
        expect(page.get_by_role("link", name="1 walk").first).to_be_visible()
        if i == 0:
            album.take("recording")
        empty.await_all_jobs()
        page.goto(f"/#/levels/{level_id}")
        page.reload()
        expect(page.locator(".figure").filter(has_text="mapped").first).to_be_visible()
        drawn(page)
        areas.append(shown_area(page))
        album.take(f"map-{i + 1}")
    assert areas == sorted(set(areas)), "the map did not grow"
    assert areas[-1] > 0.8 * WIDTH * HEIGHT
    assert empty.get(f"/v1/levels/{level_id}")["current_map_id"] is None
    publish(page, album)
    current = empty.get(f"/v1/levels/{level_id}")["current_map_id"]
    assert empty.get(f"/v1/maps/{current}")["n_walks"] == len(walks)
    locate(page, empty, device_url, level_id, album)


def publish(page: Page, album: Album) -> None:
    page.get_by_role("button", name="Publish").first.click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Why, for the log").fill("First survey")
    album.take("publish")
    dialog.get_by_role("button", name="Publish").click()
    expect(page.get_by_text("version, current")).to_be_visible()


def locate(page: Page, service: Service, device_url: str, level_id: str, album: Album) -> None:
    """A walk that is in no map, its start unknown: the phone is found and followed."""
    page.goto(device_url)
    url = connect(page, level_id, survey=False)
    recorded = trip(41, t0=1.76e9 + 9000.0)
    push(service, url, recorded, None, "trip")
    page.get_by_role("region", name="Recordings").get_by_role("link", name="session ses_").click()
    expect(page.get_by_role("application", name="Track on Ground floor")).to_be_visible()
    service.await_all_jobs()
    session_id = page.url.rpartition("/")[2]
    fixes = service.get(f"/v1/sessions/{session_id}/positions", limit=500)["fixes"]
    t = np.array(fixes["t_ms"]) / 1000.0
    error = np.hypot(
        np.array(fixes["x"]) - EDGE - np.interp(t, recorded.samples.t, recorded.x),
        np.array(fixes["y"]) - EDGE - np.interp(t, recorded.samples.t, recorded.y),
    )
    sure = np.array(fixes["sure"])
    assert sure.mean() > 0.5
    assert np.median(error[sure]) < 1.0
    expect(page.locator(".readout")).to_contain_text("sure")
    album.take("located")
