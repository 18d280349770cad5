"""The modules that pages share, run in the browser they are made for."""

from __future__ import annotations

import json
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from playwright.sync_api import Page, Route

from tests.dashboard.browsing import Dashboard


@pytest.fixture
def blank(dashboard: Dashboard) -> Page:
    """A page of the dashboard with nothing of interest on it."""
    return dashboard.open("/nowhere")


def run(page: Page, module: str, body: str, argument: Any = None) -> Any:
    """Run ``body`` with ``m`` (a module of the dashboard) and ``given`` (the argument)."""
    return page.evaluate(f"async (given) => {{ const m = await import('/static/{module}'); {body} }}", argument)


def test_charts_draw_under_the_policy(blank: Page) -> None:
    drawn = run(
        blank,
        "charts.js",
        """
        const traces = [{x: [1, 2, 3], y: [2, 1, 3], name: "a"}];
        const one = m.chart({label: "Errors", traces, layout: {xaxis: {title: {text: "m"}}}});
        document.querySelector("main").append(one.element);
        await one.ready;
        const lines = one.element.querySelectorAll(".scatterlayer .trace").length;
        const sized = one.element.querySelector(".main-svg").getBoundingClientRect().width;
        await one.update({traces: [{x: [1], y: [1], type: "bar"}, {x: [1], y: [2], type: "bar"}]});
        const bars = one.element.querySelectorAll(".barlayer .trace").length;
        one.destroy();
        return [lines, sized > 200, bars];
        """,
    )
    assert drawn == [1, True, 2]


EVENTS = (
    'id: 4\r\nevent: fixes\r\ndata: {"number": [3,\r\ndata: 4]}\r\n\r\n: ping\n\ndata: 1\n\nretry: 5\n\n'
    "event: nothing\n\nid\ndata:x\n\ndata: cut off"
)


def test_server_sent_events_in_any_pieces(blank: Page) -> None:
    found = run(
        blank,
        "api.js",
        """
        const bytes = new TextEncoder().encode(given.text);
        const cut = (size) => new ReadableStream({start(c) {
          for (let i = 0; i < bytes.length; i += size) c.enqueue(bytes.slice(i, i + size));
          c.close();
        }});
        const out = [];
        for (const size of given.sizes) {
          const events = [];
          for await (const event of m.serverSentEvents(cut(size))) events.push(event);
          out.push(events);
        }
        return out;
        """,
        {"text": EVENTS, "sizes": [1, 2, 3, 7, 1000]},
    )
    assert len(found) == 5
    for events in found:
        assert [(one["name"], one["data"], one["id"], one["retry"]) for one in events] == [
            ("fixes", '{"number": [3,\n4]}', "4", None),
            ("message", "1", None, None),
            ("message", None, None, 5),
            ("message", "x", "", None),
        ]


def test_contours_lie_where_the_value_is(blank: Page) -> None:
    """On a plane the contours are straight: every end of every segment has the level's value."""
    rows, columns, cell = 7, 9, 0.5
    x = 10.0 + cell * np.arange(columns)
    y = -3.0 + cell * np.arange(rows)
    values = (2.0 * x[None, :] - y[:, None]).astype(float)
    values[3, 4] = np.nan
    raster = {
        "values": [None if np.isnan(v) else v for v in values.ravel().tolist()],
        "rows": rows, "columns": columns, "x0": 10.0, "y0": -3.0, "cell_m": cell,
    }  # fmt: skip
    ends = np.array(
        run(
            blank,
            "contours.js",
            "given.values = Float32Array.from(given.values, (v) => v ?? NaN);"
            "return [...m.contourSegments(given, 24.3)];",
            raster,
        )
    ).reshape(-1, 2)
    assert len(ends) > 8
    np.testing.assert_allclose(2.0 * ends[:, 0] - ends[:, 1], 24.3, atol=1e-4)
    touched = (np.abs(ends[:, 0] - x[4]) < cell) & (np.abs(ends[:, 1] - y[3]) < cell)
    assert not touched.any()


def test_contours_close_around_a_hill(blank: Page) -> None:
    """Every point where a segment ends is the end of exactly one other: the line is closed."""
    rows = columns = 21
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    rng = np.random.default_rng(7)
    values = np.exp(-((grid - 10) ** 2).sum(axis=-1) / 30) + 0.05 * rng.standard_normal((rows, columns))
    values[[0, -1], :] = values[:, [0, -1]] = -1.0
    raster = {"rows": rows, "columns": columns, "x0": 0, "y0": 0, "cell_m": 1, "values": values.ravel().tolist()}
    ends = np.array(run(blank, "contours.js", "return [...m.contourSegments(given, 0.3)];", raster)).reshape(-1, 2)
    _, counts = np.unique(ends.round(4), axis=0, return_counts=True)
    assert len(counts) > 20
    assert (counts == 2).all()


def test_heat_maps_are_the_services_colours(blank: Page) -> None:
    from app.api.colours import COLOURS

    shown = np.array(run(blank, "heat.js", "return m.TABLES.even;"))
    assert np.abs(shown - COLOURS.astype(int)).max() <= 1


def test_heat_maps_are_north_up_and_clear_where_nothing_is(blank: Page) -> None:
    pixels = run(
        blank,
        "heat.js",
        """
        const raster = {values: Float32Array.from([0, 1, NaN, 5]), rows: 2, columns: 2};
        const image = m.heatImage(raster, {low: 0, high: 1});
        return [...image.getContext("2d").getImageData(0, 0, 2, 2).data];
        """,
    )
    even = np.array(run(blank, "heat.js", "return m.TABLES.even;"))
    top_left, top_right, low_left, low_right = np.array(pixels).reshape(4, 4)
    assert top_left[3] == 0
    assert top_right.tolist() == [*even[-1], 255]
    assert low_left.tolist() == [*even[0], 255]
    assert low_right.tolist() == [*even[-1], 255]


def test_a_raster_tells_the_value_at_a_place(blank: Page) -> None:
    values = run(
        blank,
        "heat.js",
        """
        const raster = {values: Float32Array.from([0, 1, 2, 3, 4, 5]), rows: 2, columns: 3, x0: 10, y0: 20, cell_m: 2};
        const places = [[10, 20], [10.9, 20], [11.1, 20], [14, 22], [15.1, 22], [9, 25]];
        return places.map(([x, y]) => m.valueAt(raster, {x, y})).map((v) => Number.isNaN(v) ? null : v);
        """,
    )
    assert values == [0, 0, 1, 5, None, None]


def test_text_never_becomes_markup(blank: Page) -> None:
    html = run(
        blank, "ui.js", "return m.h('p', {title: '<i>'}, '<img src=x onerror=alert(1)>', 3, null, false).outerHTML;"
    )
    assert html == '<p title="&lt;i&gt;">&lt;img src=x onerror=alert(1)&gt;3</p>'


def test_csv_is_quoted_and_runs_nothing(blank: Page) -> None:
    text = run(
        blank,
        "ui.js",
        """
        const columns = [{head: "name", cell: (r) => r.name}, {head: "n", cell: () => "shown", csv: (r) => r.n}];
        return m.csvText(columns, [{name: 'say "a, b"', n: -1.5}, {name: "=HYPERLINK(1)", n: null}]);
        """,
    )
    assert text == 'name,n\r\n"say ""a, b""",-1.5\r\n\'=HYPERLINK(1),\r\n'


def test_steps_are_round(blank: Page) -> None:
    ranges = {(0, 10): [0, 2, 4, 6, 8, 10], (31.2, 58.7): [35, 40, 45, 50, 55], (-1, 1): [-1, -0.5, 0, 0.5, 1]}
    found = run(blank, "heat.js", "return given.map(([low, high]) => m.roundSteps(low, high));", list(ranges))
    for steps, expected in zip(found, ranges.values(), strict=True):
        assert steps == pytest.approx(expected)


def test_events_go_on_after_a_lost_connection(blank: Page, dashboard: Dashboard) -> None:
    """The stream ends twice: it is taken up after the last id each time; an answer of 404 ends it for good."""
    dashboard.expect(404, "/v1/stream")
    seen: list[str | None] = []
    bodies = ["retry: 5\n\nid: 3\nevent: fix\ndata: [1]\n\n", ": nothing\n\nid: 4\nevent: fix\ndata: [2]\n\n"]

    def answer(route: Route) -> None:
        seen.append(route.request.headers.get("last-event-id"))
        if len(seen) > len(bodies):
            route.fulfill(status=404, content_type="application/problem+json", body='{"title": "gone", "status": 404}')
        else:
            route.fulfill(content_type="text/event-stream", body=bodies[len(seen) - 1])

    blank.route("**/v1/stream", answer)
    got = run(
        blank,
        "api.js",
        """
        const found = [];
        const states = [];
        const on = {fix: (data, id) => found.push([...data, id])};
        const error = await new m.Api("x").events("/v1/stream", on, {onstate: (s) => states.push(s)}).catch((e) => e);
        return [found, states, error.status];
        """,
    )
    assert seen == [None, "3", "4"]
    assert got == [[[1, "3"], [2, "4"]], ["open", "waiting", "open", "waiting"], 404]


def test_leaving_ends_a_stream_and_its_calls(blank: Page) -> None:
    blank.route("**/v1/stream", lambda route: route.fulfill(content_type="text/event-stream", body="retry: 60000\n\n"))
    ended = run(
        blank,
        "api.js",
        """
        const leave = new AbortController();
        const api = new m.Api("x").scoped(leave.signal);
        const stream = api.events("/v1/stream", {}, {onstate: (s) => s === "waiting" && leave.abort()});
        await stream;
        return api.get("/v1/venues").catch((error) => error.name);
        """,
    )
    assert ended == "AbortError"


def test_all_pages_of_a_list(blank: Page) -> None:
    def answer(route: Route) -> None:
        cursor = parse_qs(urlsplit(route.request.url).query).get("cursor", ["0"])[0]
        following = {"0": "a", "a": "b", "b": None}[cursor]
        route.fulfill(content_type="application/json", body=json.dumps({"items": [cursor], "next_cursor": following}))

    blank.route("**/v1/things?*", answer)
    blank.route("**/v1/things", answer)
    assert run(blank, "api.js", "return new m.Api('x').all('/v1/things');") == ["0", "a", "b"]
    assert run(blank, "api.js", "return new m.Api('x').all('/v1/things', {}, {most: 2});") == ["0", "a"]


def test_zooming_keeps_the_place_under_the_pointer(blank: Page) -> None:
    moved = run(
        blank,
        "canvas.js",
        """
        const view = new m.PlanView({label: "x", extent: {x_min: 10, y_min: -5, x_max: 110, y_max: 45}});
        document.querySelector("main").append(view.element);
        await new Promise((resolve) => { view.onmove = resolve; });
        const corner = view.pixel(10, -5);
        const before = view.place(200, 90);
        view.zoom(3.3, 200, 90);
        const after = view.place(200, 90);
        view.pan(25, -40);
        const [px, py] = view.pixel(before.x, before.y);
        const scale = view.scale;
        view.destroy();
        return {corner, size: view.size, before, after, px, py, back: view.place(px, py), scale};
        """,
    )
    assert moved["after"] == pytest.approx(moved["before"])
    assert (moved["px"], moved["py"]) == pytest.approx((225, 50))
    assert moved["back"] == pytest.approx(moved["before"])
    left, low = moved["corner"]
    assert 0 < left < moved["size"]["width"] / 2
    assert moved["size"]["height"] / 2 < low < moved["size"]["height"]


def test_two_fingers_zoom(blank: Page) -> None:
    scales = run(
        blank,
        "canvas.js",
        """
        const view = new m.PlanView({label: "x", extent: {x_min: 0, y_min: 0, x_max: 100, y_max: 50}});
        document.querySelector("main").append(view.element);
        await new Promise((resolve) => { view.onmove = resolve; });
        view.canvas.setPointerCapture = () => {};
        const before = view.scale;
        const box = view.canvas.getBoundingClientRect();
        const send = (type, id, x, y) => view.canvas.dispatchEvent(
            new PointerEvent(type, {pointerId: id, clientX: box.left + x, clientY: box.top + y}));
        send("pointerdown", 1, 100, 100);
        send("pointerdown", 2, 200, 100);
        const place = view.place(150, 100);
        send("pointermove", 1, 50, 100);
        send("pointermove", 2, 250, 100);
        const after = view.place(150, 100);
        send("pointerup", 1, 50, 100);
        send("pointerup", 2, 250, 100);
        view.destroy();
        return [view.scale / before, place.x - after.x, place.y - after.y];
        """,
    )
    assert scales == pytest.approx([2.0, 0.0, 0.0], abs=1e-6)


def test_durations_carry_over(blank: Page) -> None:
    told = run(blank, "ui.js", "return given.map(m.duration);", [4.21, 59.4, 59.97, 119.7, 3599.8, 7260])
    assert [one.replace("\u202f", " ") for one in told] == [
        "4.2 s", "59 s", "1 min 0 s", "2 min 0 s", "1 h 0 min", "2 h 1 min",
    ]  # fmt: skip
