"""How long a reader waits: the first paint, and a large map. ``-rP`` shows the figures."""

from __future__ import annotations

import io
import sys

import numpy as np
from playwright.sync_api import Page

from tests.dashboard.browsing import Dashboard
from tests.dashboard.test_level import drawn
from tests.e2e.service import Service

N = 400
FIRST_PAINT_MS = 1000.0
MAP_MS = 500.0
TRIES = 3
"""Other work on the machine is not the page's doing: the best of so many counts."""


def large_level(service: Service) -> str:
    """A level with a map of N x N nodes, imported."""
    venue = service.post("/v1/venues", {"name": "Large", "kind": "area"})
    extent = {"x_min": 0, "y_min": 0, "x_max": N, "y_max": N}
    level = service.post(f"/v1/venues/{venue['id']}/levels", {"name": "0", "ordinal": 0, "extent": extent})
    axis = np.arange(N)
    field = 45.0 + 8.0 * np.sin(axis[None, :] / 17.0) * np.cos(axis[:, None] / 23.0)
    text = io.StringIO()
    text.write(f"ncols {N}\nnrows {N}\nxllcenter 0\nyllcenter 0\ncellsize 1\nnodata_value -9999\n")
    np.savetxt(text, field, fmt="%.2f")
    answer = service.request(
        "POST",
        f"/v1/levels/{level['id']}/maps/import",
        params={"format": "esri-ascii", "channel": "total", "unit": "uT"},
        content=text.getvalue().encode(),
        headers={"Content-Type": "application/octet-stream"},
    )
    assert answer.is_success, answer.text
    return str(level["id"])


def measured(page: Page, name: str) -> list[float]:
    return [float(v) for v in page.evaluate(f"performance.getEntriesByName('{name}').map((one) => one.duration)")]


def test_the_first_paint_comes_at_once(dashboard: Dashboard) -> None:
    page = dashboard.page
    times = []
    for _ in range(TRIES):
        page.goto("/")
        page.get_by_label("API key").wait_for()
        paint = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        times.append(float(paint))
    sys.stdout.write(f"first contentful paint: {', '.join(f'{t:.0f}' for t in times)} ms\n")
    assert min(times) < FIRST_PAINT_MS


def test_a_large_map_is_drawn_at_once(dashboard: Dashboard, service: Service) -> None:
    """From the request to the picture on the plan: N x N values asked for, received, coloured, put up."""
    level_id = large_level(service)
    page = dashboard.open(f"/levels/{level_id}")
    drawn(page)
    page.get_by_label("Show", exact=True).select_option("sd")
    drawn(page, 2)
    page.get_by_label("Show", exact=True).select_option("support")
    drawn(page, 3)
    times_ms = measured(page, "isodyn.map")
    opened = page.evaluate("(([one]) => one.startTime + one.duration)(performance.getEntriesByName('isodyn.map'))")
    nodes = page.evaluate("performance.getEntriesByName('isodyn.map')[0].detail.nodes")
    listed = ", ".join(f"{t:.0f}" for t in times_ms)
    sys.stdout.write(f"{N} x {N} map drawn: {listed} ms; {opened:.0f} ms after the page was asked for\n")
    assert nodes >= N * N
    assert min(times_ms) < MAP_MS
