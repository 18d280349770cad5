"""Pages of venues and of one venue."""

from __future__ import annotations

from playwright.sync_api import expect

from tests.api.test_levels import png
from tests.dashboard.browsing import Dashboard
from tests.dashboard.floors import Floor
from tests.e2e.service import Service


def test_venues_are_listed_and_found(dashboard: Dashboard, service: Service, floor: Floor) -> None:
    for n in range(60):
        service.post("/v1/venues", {"name": f"Depot {n}", "kind": "indoor"})
    page = dashboard.open("/venues")
    rows = page.locator("tbody tr")
    expect(rows).to_have_count(50)
    page.get_by_role("button", name="Show more").click()
    expect(page.get_by_role("link", name="Depot 0", exact=True)).to_be_visible()
    dashboard.screenshots("venues")
    assert dashboard.fits()
    page.get_by_label("Find venues by name").fill("dep 59")
    expect(rows).to_have_count(1)
    assert "q=dep" in page.url
    page.reload()
    expect(rows).to_have_count(1)
    page.get_by_label("Find venues by name").fill("nothing like it")
    expect(page.get_by_text("No venue of this name")).to_be_visible()


def test_a_venue_is_made_edited_and_deleted(dashboard: Dashboard, service: Service) -> None:
    dashboard.expect(422, "/v1/venues")
    page = dashboard.open("/venues")
    page.get_by_role("button", name="New venue").first.click()
    dialog = page.get_by_role("dialog", name="New venue")
    dialog.get_by_label("Name").fill("Harbour hall")
    dialog.get_by_label("Latitude").fill("48.15")
    dialog.get_by_role("button", name="Create").click()
    expect(dialog.get_by_label("Longitude")).to_have_attribute("aria-invalid", "true")
    dialog.get_by_label("Longitude").fill("11.57")
    dialog.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="Harbour hall")).to_be_visible()
    expect(page.get_by_text("48.1500° N, 11.5700° E")).to_be_visible()
    page.get_by_role("button", name="Edit").click()
    page.get_by_role("dialog").get_by_label("Name").fill("Harbour hall, west")
    page.get_by_role("dialog").get_by_label("Latitude").fill("")
    page.get_by_role("dialog").get_by_label("Longitude").fill("")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Harbour hall, west")).to_be_visible()
    expect(page.get_by_text("no anchor")).to_be_visible()
    venue_id = page.url.rpartition("/")[2]
    assert service.get(f"/v1/venues/{venue_id}")["anchor"] is None
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("heading", name="Venues", level=1)).to_be_visible()
    assert service.request("GET", f"/v1/venues/{venue_id}").status_code == 404


def test_a_level_is_made_with_its_picture(dashboard: Dashboard, service: Service) -> None:
    venue = service.post("/v1/venues", {"name": "Tower", "kind": "indoor"})
    page = dashboard.open(f"/venues/{venue['id']}")
    page.get_by_role("button", name="New level").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Name").fill("G")
    dialog.get_by_label("Width of the plan").fill("40")
    dialog.get_by_label("Plan picture").set_input_files(
        {"name": "plan.png", "mimeType": "image/png", "buffer": png((80, 60))}
    )
    dialog.get_by_role("button", name="Create").click()
    expect(page.get_by_role("heading", name="G", exact=True)).to_be_visible()
    level = service.get(f"/v1/levels/{page.url.rpartition('/')[2]}")
    assert level["extent"] == {"x_min": 0.0, "y_min": 0.0, "x_max": 40.0, "y_max": 30.0}
    assert level["has_plan_image"]
    expect(page.get_by_text("There is no map yet")).to_be_visible()


def test_names_are_text(dashboard: Dashboard, service: Service) -> None:
    name = '<img src="x" onerror="document.title=1">'
    venue = service.post("/v1/venues", {"name": name, "kind": "indoor"})
    page = dashboard.open(f"/venues/{venue['id']}")
    expect(page.get_by_role("heading", level=1)).to_have_text(name)
    assert page.locator("main img").count() == 0
