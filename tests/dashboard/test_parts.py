"""The modules that pages share, run in the browser they are made for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

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


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_server_sent_events_in_any_pieces(blank: Page, size: int) -> None:
    found = run(
        blank,
        "api.js",
        """
        const bytes = new TextEncoder().encode(given.text);
        const stream = new ReadableStream({start(c) {
          for (let i = 0; i < bytes.length; i += given.size) c.enqueue(bytes.slice(i, i + given.size));
          c.close();
        }});
        const out = [];
        for await (const event of m.serverSentEvents(stream)) out.push(event);
        return out;
        """,
        {"text": EVENTS, "size": size},
    )
    assert [(one["name"], one["data"], one["id"], one["retry"]) for one in found] == [
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


@pytest.mark.parametrize(
    ("low", "high", "steps"),
    [(0, 10, [0, 2, 4, 6, 8, 10]), (31.2, 58.7, [35, 40, 45, 50, 55]), (-1, 1, [-1, -0.5, 0, 0.5, 1])],
)
def test_steps_are_round(blank: Page, low: float, high: float, steps: list[float]) -> None:
    found = run(blank, "heat.js", "return m.roundSteps(given[0], given[1]);", [low, high])
    assert found == pytest.approx(steps)
