"""Lines of loggers: headers, units, clocks; late, lost and repeated rows; segments that the service takes."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.exchange.surveys.recording import DEFAULT_START_S
from app.exchange.vehicles import Cutter, LineChoices, LineReader, Piece, Row
from app.exchange.vehicles.cutter import MAX_GAP_S, MIN_S

HEADER = "t,mx,my,mz,ax,ay,az,gx,gy,gz,speed"
T0 = 1_764_000_000.0
SENSORS = (20.0, -5.0, -40.0, 0.1, 0.2, 9.8, 0.01, 0.0, -0.02)


def line(t: float | str, speed: object = 1.5, factors: Sequence[float] = (1.0, 1.0, 1.0)) -> str:
    values = [value * factors[i // 3] for i, value in enumerate(SENSORS)]
    return ",".join([str(t), *map(str, values), str(speed)])


def lines(n: int = 120, *, t0: float = T0, step: float = 0.01, scale: float = 1.0, **more: Any) -> list[str]:
    return [line(round((t0 + step * i) * scale, 6), **more) for i in range(n)]


def rows_of(reader: LineReader, texts: Iterable[str]) -> list[Row]:
    rows = [row for text in texts for row in reader.feed(text)]
    return rows + list(reader.judge())


@pytest.mark.parametrize(
    ("header", "factors", "speed", "units"),
    [
        (HEADER, (1.0, 1.0, 1.0), 1.0, {}),
        ("t,mx(nT),my(nT),mz(nT),ax[g],ay[g],az[g],gx(deg/s),gy(deg/s),gz(deg/s),Speed (km/h)",
         (1e3, 1 / 9.80665, 180 / np.pi), 3.6, {}),
        ("t,mx,my,mz,ax,ay,az,gx,gy,gz,v", (1e3, 1 / 9.80665, 180 / np.pi), 3.6,
         {"mag": "nT", "acc": "g", "gyro": "deg/s", "speed": "km/h"}),
        ("t,mx,my,mz,ax,ay,az,gx,gy,gz,wheel_speed_m/s", (1.0, 1.0, 1.0), 1.0, {}),
    ],
)  # fmt: skip
def test_headers_and_units(header: str, factors: tuple[float, ...], speed: float, units: dict[str, str]) -> None:
    reader = LineReader(LineChoices(units=units))
    rows = rows_of(reader, [header, *lines(factors=factors, speed=1.5 * speed)])
    assert len(rows) == 120
    np.testing.assert_allclose([row.sensors for row in rows], [SENSORS] * 120, rtol=1e-9)
    np.testing.assert_allclose([row.speed for row in rows], 1.5)  # type: ignore[arg-type]
    np.testing.assert_allclose([row.t for row in rows], T0 + 0.01 * np.arange(120), atol=1e-6)


def test_lines_without_a_header_and_with_another_separator() -> None:
    reader = LineReader(LineChoices(header=tuple(HEADER.split(","))))
    texts = [text.replace(",", ";").replace(".", ",") for text in lines()]
    rows = rows_of(reader, ["0,1;0,2", *texts])  # a serial line begins in the middle of one
    assert len(rows) == 120
    assert reader.n_bad == 1
    assert rows[0].sensors == pytest.approx(SENSORS)


def test_columns_with_names_of_their_own() -> None:
    header = HEADER.replace("mx", "Feld A").replace("speed", "Rad")
    reader = LineReader(LineChoices(columns={"mag_x": "Feld A", "speed": "Rad"}))
    rows = rows_of(reader, [header, *lines()])
    assert (rows[0].sensors[0], rows[0].speed) == (20.0, 1.5)


@pytest.mark.parametrize(
    ("choices", "header", "field", "words"),
    [
        (LineChoices(), "t,mx,my,ax,ay,az,gx,gy,gz", "header", "mag_z"),
        (LineChoices(columns={"speed": "nope"}), HEADER, "column", "nope"),
        (LineChoices(columns={"mag_x": "nope"}), HEADER, "column", "nope"),
    ],
)
def test_a_header_that_lacks_something_is_refused(choices: LineChoices, header: str, field: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        list(LineReader(choices).feed(header))
    assert caught.value.field == field


@pytest.mark.parametrize("units", [{"mag": "V"}, {"t": "h"}, {"speed": "c"}, {"light": "lx"}])
def test_units_that_are_none_are_refused_at_once(units: dict[str, str]) -> None:
    with pytest.raises(InputError, match="name one of"):
        LineReader(LineChoices(units=units))


def test_units_that_fit_nothing_are_refused_with_the_remedy() -> None:
    with pytest.raises(InputError, match="--unit acc="):
        rows_of(LineReader(), [HEADER, *lines(factors=(1.0, 7.0, 1.0))])


def test_bad_lines_are_counted_and_named() -> None:
    reader = LineReader()
    texts = [
        HEADER,
        "",
        "# comment",
        *lines(60),
        HEADER,
        "1,2",
        line("noon"),
        line(T0 + 1, speed="x"),
        "\0garbage",
        *lines(2, t0=T0 + 2),
    ]
    rows = rows_of(reader, texts)
    assert len(rows) == 62
    assert reader.n_bad == 4
    assert reader.first_bad.startswith("line 65: has 2 columns")


def test_rows_may_lack_speed_or_sensors() -> None:
    partial = f"{T0 + 1},,,,,,,,,,2.5"
    rows = rows_of(LineReader(), [HEADER, *lines(60, speed=""), partial])
    assert [row.speed for row in rows] == [None] * 60 + [2.5]
    assert [row.full for row in rows] == [True] * 60 + [False]


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_unix_clocks_of_any_unit(scale: float, unit: str) -> None:
    reader = LineReader()
    rows = rows_of(
        reader, [HEADER, *[line(int((T0 + 0.01 * i) * scale) if scale > 1 else T0 + 0.01 * i) for i in range(60)]]
    )
    assert rows[10].t == pytest.approx(T0 + 0.1, abs=2e-3 if scale == 1e3 else 1e-5)
    assert f"time in {unit} by its steps" in reader.findings.assumed


def test_dates() -> None:
    stamps = [f"2025-11-24T16:00:{i / 100:06.3f}Z" for i in range(60)]
    rows = rows_of(LineReader(), [HEADER, *map(line, stamps)])
    assert rows[5].t == pytest.approx(datetime(2025, 11, 24, 16, 0, 0, 50_000, UTC).timestamp())


@pytest.mark.parametrize(
    ("choices", "start"),
    [
        (LineChoices(), DEFAULT_START_S),
        (LineChoices(start_s=1.7e9), 1.7e9),
        (LineChoices(start_s=1.7e9, live=True), 1.7e9),
    ],
)
def test_clocks_without_a_date(choices: LineChoices, start: float) -> None:
    rows = rows_of(LineReader(choices), [HEADER, *lines(t0=12.0)])
    np.testing.assert_allclose([row.t for row in rows], start + 0.01 * np.arange(120), atol=1e-6)


def test_a_live_clock_without_a_date_begins_now_and_anew_when_the_logger_does() -> None:
    now = [5000.0]
    reader = LineReader(LineChoices(live=True), now=lambda: now[0])
    rows = rows_of(reader, [HEADER, *lines(60, t0=100.0)])
    assert rows[-11].t == pytest.approx(5000.0)  # the row by which the clock was judged
    assert any("begun now" in note for note in reader.findings.assumed)
    now[0] = 5030.0
    again = rows_of(reader, lines(60, t0=0.0))
    assert again[0].t == pytest.approx(5030.0)
    assert again[-1].t == pytest.approx(5030.59)


def test_few_rows_are_judged_at_the_end() -> None:
    reader = LineReader()
    assert [row for text in [HEADER, *lines(20)] for row in reader.feed(text)] == []
    assert len(list(reader.judge())) == 20
    assert list(LineReader().judge()) == []


def row(t: float, speed: float | None = None, *, full: bool = True) -> Row:
    return Row(t, SENSORS if full else (np.nan,) * 9, speed)


def cut(cutter: Cutter, rows: Iterable[Row]) -> list[Piece]:
    return [piece for one in rows for piece in cutter.put(one)] + list(cutter.flush())


def test_segments_have_their_length_and_their_speeds() -> None:
    pieces = cut(Cutter(2.0), [row(T0 + 0.1 * i, i if i % 2 else None) for i in range(50)])
    assert [len(piece.samples) for piece in pieces] == [20, 20, 10]
    for piece in pieces:
        assert piece.speed is not None
        assert set(piece.speed.t) <= set(piece.samples.t)
        np.testing.assert_allclose(piece.speed.speed, np.round((piece.speed.t - T0) * 10))


def test_a_hole_ends_a_segment() -> None:
    times = [*np.arange(0, 1, 0.1), *np.arange(2.5, 4, 0.1)]
    pieces = cut(Cutter(5.0), [row(T0 + t) for t in times])
    assert [len(piece.samples) for piece in pieces] == [10, 15]
    assert pieces[0].speed is None


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.floats(0.0, 0.4), st.floats(0.0, 0.3))
def test_late_lost_and_repeated_rows(seed: int, delay: float, loss: float) -> None:
    """Whatever arrives within the time of holding back comes out once and in order; so do segments."""
    chance = random.Random(seed)
    sent = [(T0 + 0.05 * i) for i in range(200)]
    arriving = [t for t in sent if chance.random() >= loss]
    arriving += [t for t in arriving if chance.random() < 0.2]
    arriving.sort(key=lambda t: t + chance.uniform(0.0, delay))
    cutter = Cutter(1.0, reorder_s=0.5)
    pieces = cut(cutter, map(row, arriving))
    out = np.concatenate([piece.samples.t for piece in pieces]) if pieces else np.zeros(0)
    assert (np.diff(out) > 0).all()
    assert len(out) + cutter.n_short == len(set(arriving))
    assert cutter.n_late == len(arriving) - len(set(arriving))
    for piece in pieces:
        assert (np.diff(piece.samples.t) <= MAX_GAP_S).all()
        assert MIN_S <= piece.samples.t[-1] - piece.samples.t[0] < 1.0 + 1e-9


def test_what_comes_too_late_is_counted() -> None:
    cutter = Cutter(1.0, reorder_s=0.1)
    cut(cutter, [row(T0 + t) for t in (0.0, 0.1, 0.2, 0.3, 0.4, 0.15, 0.5, 0.6)])
    assert cutter.n_late == 1


def test_one_stray_row_does_not_start_anew_but_a_clock_put_back_does() -> None:
    first = [row(T0 + 0.1 * i) for i in range(100)]
    stray = [row(T0 - 50.0)]
    second = [row(T0 - 100.0 + 0.1 * i) for i in range(50)]
    cutter = Cutter(100.0, reorder_s=0.0)
    pieces = cut(cutter, [*first, *stray, row(T0 + 10.0), *second])
    assert [len(piece.samples) for piece in pieces] == [101, 41]
    assert pieces[1].samples.t[0] < pieces[0].samples.t[0]
    assert cutter.n_late == 1 + 9


def test_rests_and_partial_rows_are_counted() -> None:
    cutter = Cutter(1.0, reorder_s=0.0)
    pieces = cut(cutter, [row(T0), row(T0 + 0.1), row(T0 + 5.0, full=False), row(T0 + 5.1, 2.0, full=False)])
    assert pieces == []
    assert (cutter.n_short, cutter.n_partial) == (2, 1)
