"""Recordings as CSV: names, units and clocks are found, or asked for; whatever comes, words come back."""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.api import plausibility
from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.mapping.samples import place_samples
from app.engine.types import SurveyWalk, Waypoints
from app.exchange.surveys import CsvChoices, Findings, read_csv, recording
from tests.exchange.recordings import SENSORS, WALK, csv_of, plain_csv

PLANE = TangentPlane(48.15, 11.57, 30.0)


def read(content: bytes, plane: TangentPlane | None = None, **choices: object) -> tuple[list[SurveyWalk], Findings]:
    findings = Findings()
    found = read_csv(io.BytesIO(content), "walk", CsvChoices(**choices), plane, findings)  # type: ignore[arg-type]
    return list(found), findings


def same(walk: SurveyWalk, *, places: float = 1e-9) -> bool:
    sensors = all(
        np.allclose(getattr(walk.samples, one), getattr(WALK.samples, one), rtol=1e-7, atol=1e-7) for one in SENSORS
    )
    points, expected = walk.waypoints, WALK.waypoints
    return (
        sensors
        and np.allclose(walk.samples.t, WALK.samples.t, atol=2e-6, rtol=0)
        and np.allclose(points.x, expected.x, atol=places)
        and np.allclose(points.y, expected.y, atol=places)
        and np.abs(points.t - expected.t).max() <= 0.011
    )


def test_limits_are_those_of_the_service() -> None:
    limits = plausibility.WALK_LIMITS
    assert (limits.max_duration_s, limits.max_samples) == (recording.MAX_WALK_S, recording.MAX_WALK_SAMPLES)
    assert (recording.MAX_GAP_S, recording.MIN_RATE_HZ) == (plausibility.MAX_GAP_S, plausibility.MIN_RATE_HZ)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_a_walk_comes_back(delimiter: str) -> None:
    content = csv_of(delimiter=delimiter, filled=delimiter == " ")
    (walk,), findings = read(content.replace(b"  ", b" ") if delimiter == " " else content)
    if delimiter == " ":  # white space cannot hold an empty cell: all are filled
        assert len(walk.waypoints) == len(WALK.waypoints)
        return
    assert same(walk)
    assert not findings.skipped
    assert len(place_samples(walk)) > 20


def test_positions_that_are_filled_in_count_once() -> None:
    (walk,), _ = read(csv_of(filled=True))
    assert same(walk)


def test_latitude_and_longitude_go_through_the_anchor() -> None:
    (walk,), _ = read(csv_of(plane=PLANE), PLANE)
    assert same(walk, places=1e-6)
    with pytest.raises(InputError, match="anchor"):
        read(csv_of(plane=PLANE))
    with pytest.raises(InputError, match="50 km"):
        read(csv_of(plane=PLANE), TangentPlane(11.57, 48.15))


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({"mag": 1e3}, "nt"),
        ({"mag": 1e-2}, "gauss"),
        ({"acc": 1 / 9.80665}, "g by"),
        ({"acc": 1e3 / 9.80665}, "mg by"),
        ({"mag": 1e3, "acc": 1 / 9.80665}, "nt"),
    ],
)
def test_units_are_guessed_and_said(factors: dict[str, float], words: str) -> None:
    (walk,), findings = read(csv_of(factors=factors))
    assert same(walk)
    assert any(words in note for note in findings.assumed)


def turning() -> SurveyWalk:
    """A walk that turns all the time, so that its rates show their unit."""
    gyro = WALK.samples.gyro + np.array([0.0, 0.0, 0.4])
    return replace(WALK, samples=replace(WALK.samples, gyro=gyro))


@pytest.mark.parametrize("told", ["header", "choice", "guess"])
def test_degrees_per_second(told: str) -> None:
    content = csv_of(turning(), factors={"gyro": 180 / np.pi})
    if told == "header":
        content = content.replace(b"gyro_x,gyro_y,gyro_z", b"gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s)")
    (walk,), findings = read(content, units={"gyro": "dps"} if told == "choice" else {})
    assert walk.samples.gyro == pytest.approx(turning().samples.gyro, rel=1e-6, abs=1e-7)
    assert any("rotation" in note for note in findings.assumed) == (told == "guess")


def test_other_names() -> None:
    header = ["Timestamp [ms]", "Pos_X", "Pos_Y", "Magnetometer X (uT)", "Magnetometer Y (uT)", "Magnetometer Z (uT)"]
    header += ["accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2", "wx", "wy", "wz"]
    (walk,), findings = read(csv_of(header=header, time="ms"))
    assert same(walk)
    assert not any("magnetic" in note or "acceleration" in note for note in findings.assumed)
    header[3] = "strange"
    with pytest.raises(InputError, match="mag_x") as caught:
        read(csv_of(header=header, time="ms"))
    assert "--column" in caught.value.message
    (walk,), _ = read(csv_of(header=header, time="ms"), columns={"mag_x": "Strange"})
    assert same(walk)


def test_clocks() -> None:
    relative = replace(WALK, samples=replace(WALK.samples, t=WALK.samples.t - WALK.samples.t[0] + 5.25))
    relative = replace(relative, waypoints=replace(WALK.waypoints, t=WALK.waypoints.t - WALK.samples.t[0] + 5.25))
    for time in ("s", "ms", "us"):
        (walk,), findings = read(csv_of(relative, time=time))
        assert walk.samples.t[0] == pytest.approx(recording.DEFAULT_START_S + 0.25, abs=1e-5)
        assert any("without a date" in note for note in findings.assumed)
        (walk,), _ = read(csv_of(relative, time=time), start_s=1.6e9)
        assert walk.samples.t[0] == pytest.approx(1.6e9 + 0.25, abs=1e-5)


def test_dates() -> None:
    lines = plain_csv().decode().splitlines()
    base = np.datetime64("2023-11-14T22:13:20", "us")
    rows = [f"{base + np.timedelta64(20_000 * i, 'us')}Z,{line.partition(',')[2]}" for i, line in enumerate(lines[1:])]
    (walk,), _ = read("\n".join([lines[0], *rows]).encode())
    assert same(walk)


def test_several_walks_in_one_file() -> None:
    lines = plain_csv().decode().splitlines()
    again = csv_of(replace(WALK, samples=replace(WALK.samples, t=WALK.samples.t - 500.0))).decode().splitlines()
    points = csv_of(
        replace(
            WALK,
            samples=replace(WALK.samples, t=WALK.samples.t - 500.0),
            waypoints=replace(WALK.waypoints, t=WALK.waypoints.t - 500.0),
        )
    )
    assert len(again) == len(lines)
    # the clock runs back: another recording begins
    walks, _ = read("\n".join(lines + points.decode().splitlines()[1:]).encode())
    assert len(walks) == 2
    # named by a column
    named = [f"walk_id,{lines[0]}", *(f"a,{line}" for line in lines[1:]), *(f"b,{line}" for line in lines[1:])]
    walks, _ = read("\n".join(named).encode())
    assert [walk.walk_id for walk in walks] == ["walk a", "walk b"]
    assert all(same(walk) for walk in walks)


def test_a_gap_parts_walks_and_says_so() -> None:
    lines = plain_csv().decode().splitlines()
    walks, findings = read("\n".join(lines[:500] + lines[600:]).encode())
    assert [walk.walk_id for walk in walks] == ["walk 1", "walk 2"][: len(walks)]
    assert len(walks) + len(findings.skipped) == 2


def test_floors() -> None:
    lines = plain_csv().decode().splitlines()
    rows = [f"floor,{lines[0]}"] + [f"{1 if i < 500 else 2}.0,{line}" for i, line in enumerate(lines[1:])]
    content = "\n".join(rows).encode()
    with pytest.raises(InputError, match="1, 2"):
        read(content)
    (walk,), findings = read(content, floor="1")
    assert walk.waypoints.t[-1] <= WALK.samples.t[500]
    assert walk.samples.t[-1] <= walk.waypoints.t[-1] + recording.FLOOR_SLACK_S
    assert any("other floors" in note for note in findings.skipped)
    none, findings = read(content, floor="7")
    assert not none
    assert any("no position on floor 7" in note for note in findings.skipped)


def test_a_few_bad_lines_are_left_out_and_many_are_another_format() -> None:
    lines = plain_csv().decode().splitlines()
    lines[10] = lines[10][:30]
    lines[20] = lines[20].replace(lines[20].split(",")[5], "1.2.3")
    lines[30] = ",".join([*lines[30].split(",")[:4], "nan", *lines[30].split(",")[5:]])
    lines[40] = lines[41]
    (walk,), findings = read("\n".join(lines).encode())
    words = " ".join(findings.skipped)
    assert "line 11" in words
    assert "2 of" in words
    assert "1 rows without a reading" in words
    assert "1 rows whose time" in words
    assert len(walk.samples) == len(WALK.samples) - 4
    broken = [line[:30] if i % 10 == 5 else line for i, line in enumerate(lines)]
    with pytest.raises(InputError, match=r"line \d+"):
        read("\n".join(broken).encode())


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"# only a comment\n", "empty"),
        (b"t,x,y\n1,2,3\n", "lacks mag_x"),
        (plain_csv().splitlines()[0], "no row"),
        (b"\x00\xff" * 70_000, "longer than"),
        (csv_of(factors={"mag": 1e-9}), "magnetic field"),
        (csv_of(factors={"acc": 0.01}), "with gravity"),
        (csv_of(header=["t", "lat", "x", *"abcdefghi"]), "lacks"),
    ],
)
def test_what_is_wrong_is_said(content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(content)


def test_unknown_choices_are_refused() -> None:
    for choices in ({"units": {"mag": "furlong"}}, {"units": {"depth": "m"}}, {"columns": {"depth": "t"}}):
        with pytest.raises(InputError, match="name one of"):
            read(plain_csv(), **choices)
    with pytest.raises(InputError, match="not in the header"):
        read(plain_csv(), columns={"mag_x": "nobody"})


def test_a_file_that_never_ends_is_not_read_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.exchange.surveys.csv_file.MAX_ROWS", 100)
    with pytest.raises(InputError, match="line 102"):
        read(plain_csv())


def test_positions_are_thinned() -> None:
    t = np.arange(WALK.samples.t[0], WALK.samples.t[-1], 0.02)
    points = Waypoints(
        t, np.interp(t, WALK.waypoints.t, WALK.waypoints.x), np.interp(t, WALK.waypoints.t, WALK.waypoints.y)
    )
    (walk,), _ = read(csv_of(replace(WALK, waypoints=points)))
    assert np.diff(walk.waypoints.t).min() >= recording.MIN_WAYPOINT_S
    assert len(walk.waypoints) == int(t[-1] - t[0]) + 1


TEXT = csv_of(replace(WALK, samples=replace(WALK.samples, **{
    name: getattr(WALK.samples, name)[:40] for name in ("t", *SENSORS)
}), waypoints=Waypoints(WALK.samples.t[[0, 39]], np.array([0.0, 5.0]), np.zeros(2)))).decode()  # fmt: skip
JUNK = st.sampled_from(
    [",", ";", "\n", "nan", "-", "\x00", "1e400", '"', "\ufeff", "9" * 400, "x", "\r", "#", " ", "2023-01-01"]
)


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(TEXT)), st.integers(0, 30), JUNK | st.text(max_size=5)), max_size=6))
def test_nothing_crashes_the_reader(changes: list[tuple[int, int, str]]) -> None:
    text = TEXT
    for at, cut, junk in changes:
        text = text[:at] + junk + text[at + cut :]
    with contextlib.suppress(InputError):
        walks, _ = read(text.encode("utf-8", "surrogatepass"), PLANE)
        for walk in walks:
            assert (np.diff(walk.samples.t) > 0).all()
            assert np.isfinite(walk.waypoints.x).all()


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400))
def test_garbage_is_refused(content: bytes) -> None:
    with pytest.raises(InputError):
        read(content)
