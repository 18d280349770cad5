"""GetSensorData logs: sensors on one clock, positions in level metres; robust against what phones write."""

from __future__ import annotations

import contextlib
import io
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.mapping.samples import place_samples
from app.engine.types import SurveyWalk, Waypoints
from app.exchange.surveys import Findings, LogChoices, read_getsensordata, recording
from app.exchange.surveys.getsensordata import aligned
from tests.exchange.recordings import PLANE, SENSORS, WALK, log_of


def read(content: bytes, plane: TangentPlane | None = PLANE, **choices: object) -> tuple[list[SurveyWalk], Findings]:
    findings = Findings()
    log = LogChoices(**choices)  # type: ignore[arg-type]
    return list(read_getsensordata(io.BytesIO(content), "log", log, plane, findings)), findings


def test_a_log_becomes_a_walk() -> None:
    (walk,), findings = read(log_of())
    began = datetime(2019, 7, 25, 13, 59, 43, tzinfo=UTC).timestamp()  # CEST is two hours ahead
    assert walk.samples.t[0] == pytest.approx(began, abs=0.05)
    shift = began - WALK.samples.t[0]
    assert walk.waypoints.t - shift == pytest.approx(WALK.waypoints.t, abs=1e-3)
    assert walk.waypoints.x == pytest.approx(WALK.waypoints.x, abs=1e-3)
    assert walk.waypoints.y == pytest.approx(WALK.waypoints.y, abs=1e-3)
    # on the magnetometer's clock, late by the shortest delay only
    late = walk.samples.t - shift
    assert np.diff(late) == pytest.approx(np.full(len(late) - 1, 0.02), abs=1e-4)
    for sensor, within in (("mag", 2.5), ("acc", 0.6), ("gyro", 0.02)):
        truth = np.stack(
            [np.interp(late, WALK.samples.t, getattr(WALK.samples, sensor)[:, i]) for i in range(3)], axis=1
        )
        assert np.sqrt(((getattr(walk.samples, sensor) - truth) ** 2).mean()) < within, sensor
    assert (walk.wifi, walk.ble) == (None, None)
    assert any("PRES" in note for note in findings.skipped)
    assert len(place_samples(walk)) > 20


def test_readings_of_one_moment_meet() -> None:
    """Whatever the origin of the sensors' clocks and however late their readings: columns belong together."""
    for origin, delays in ((0.0, 0.001), (51_000.0, 0.02), (1.7e9, 0.08)):
        (walk,), _ = read(log_of(sensor_origin=origin, delays=delays))
        assert np.ptp(np.diff(walk.samples.t)) < 1e-3
        norm = np.linalg.norm(walk.samples.acc, axis=1)
        expected = np.linalg.norm(WALK.samples.acc, axis=1)
        lags = range(-8, 9)
        fits = [np.corrcoef(norm[20:-20], np.roll(expected, lag)[20 : len(norm) - 20])[0, 1] for lag in lags]
        assert abs(lags[int(np.argmax(fits))]) <= 2, origin


def test_a_clock_that_jumps_is_not_believed() -> None:
    rng = np.random.default_rng(2)
    app = np.arange(500) * 0.02
    sensor = app + 100.0
    steady = aligned(app + rng.exponential(0.03, 500), sensor, "MAGN", Findings())
    assert np.abs(steady - app).max() < 0.01
    outliers = app + rng.exponential(0.03, 500)
    outliers[::60] += 5.0  # the phone was busy
    assert np.abs(aligned(outliers, sensor, "MAGN", Findings()) - app).max() < 0.01
    jumped, findings = sensor + np.where(np.arange(500) > 250, 30.0, 0.0), Findings()
    assert np.array_equal(aligned(app, jumped, "MAGN", findings), app)
    assert findings.assumed


def test_radio_only_when_asked_for() -> None:
    (walk,), _ = read(log_of(), radio=True)
    assert walk.wifi is not None
    assert walk.ble is not None
    assert set(walk.wifi.address) == {f"a4:2b:8c:91:{i:02x}:f7" for i in range(5)}
    assert set(walk.ble.address) == {f"c0:ff:ee:00:00:{i:02x}" for i in range(3)}
    assert walk.wifi.rssi[0] == -60.0
    assert walk.ble.rssi[1] == -71.0
    old = log_of().replace(b";2437;-", b";-")  # older logs have no frequency
    (walk,), _ = read(old, radio=True)
    assert walk.wifi is not None
    assert walk.wifi.rssi[0] == -60.0


def test_floors_are_chosen() -> None:
    n = len(WALK.waypoints)
    content = log_of(floors=[1.0] * 3 + [2.0] * (n - 3))
    with pytest.raises(InputError, match="1, 2"):
        read(content)
    (walk,), findings = read(content, floor="1")
    assert len(walk.waypoints) == 3
    assert any("other floors" in note for note in findings.skipped)


def test_dates() -> None:
    (walk,), findings = read(log_of(date=None))
    assert walk.samples.t[0] == pytest.approx(recording.DEFAULT_START_S, abs=0.1)
    assert any("without a date" in note for note in findings.assumed)
    (walk,), _ = read(log_of(date=None), start_s=1.6e9)
    assert walk.samples.t[0] == pytest.approx(1.6e9, abs=0.1)
    _, findings = read(log_of(date="Thu Jul 25 15:59:43 XYZ 2019"))
    assert any("XYZ" in note for note in findings.assumed)


def test_reading_twice_gives_the_same() -> None:
    (one,), _ = read(log_of(date=None))
    (two,), _ = read(log_of(date=None))
    for sensor in ("t", *SENSORS):
        assert np.array_equal(getattr(one.samples, sensor), getattr(two.samples, sensor))


def test_presses_without_a_place_are_left_out() -> None:
    content = log_of() + b"POSI;3.0;99;0.0;0.0;2;1\n"
    (walk,), findings = read(content)
    assert len(walk.waypoints) == len(WALK.waypoints)
    assert any("without a place" in note for note in findings.skipped)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no MAGN, ACCE, GYRO"),
        (b"t,x,y,mx\n1,2,3,4\n" * 9, "line 1 "),
        (b"\n".join(line for line in log_of().splitlines() if not line.startswith(b"GYRO")), "no GYRO"),
        (b"\n".join(line for line in log_of().splitlines() if not line.startswith(b"POSI")), "no POSI"),
        (log_of().replace(b"GYRO;", b"GYRO;9"), "all three sensors"),
        (log_of(plane=TangentPlane(-20.0, 11.0)), "50 km"),
    ],
)
def test_what_is_wrong_is_said(content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(content)


def test_without_an_anchor_nothing_is_placed() -> None:
    with pytest.raises(InputError, match="anchor"):
        read(log_of(), None)


def test_a_truncated_log_is_read_as_far_as_it_goes() -> None:
    whole = log_of()
    (walk,), findings = read(whole[: int(len(whole) * 0.8)])
    assert 0.6 < len(walk.samples) / len(WALK.samples) < 0.9
    assert len(findings.skipped) <= 3


def test_a_log_that_never_ends_is_not_read_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.exchange.surveys.getsensordata_lines.MAX_EVENTS", 100)
    with pytest.raises(InputError, match=r"line 1\d\d"):
        read(log_of())


SHORT = log_of(replace(WALK, samples=replace(WALK.samples, **{
    name: getattr(WALK.samples, name)[:50] for name in ("t", *SENSORS)
}), waypoints=Waypoints(WALK.samples.t[[0, 49]], np.array([0.0, 5.0]), np.zeros(2)))).decode()  # fmt: skip
JUNK = st.sampled_from(
    [";", "\n", "nan", "\x00", "1e400", "inf", "-", "POSI;1;2;3", "MAGN;", "%", "\ufeff", "9" * 400, "é"]
)


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(SHORT)), st.integers(0, 40), JUNK | st.text(max_size=5)), max_size=6),
    st.booleans(),
)
def test_nothing_crashes_the_reader(changes: list[tuple[int, int, str]], radio: bool) -> None:
    text = SHORT
    for at, cut, junk in changes:
        text = text[:at] + junk + text[at + cut :]
    with contextlib.suppress(InputError):
        walks, _ = read(text.encode("utf-8", "surrogatepass"), radio=radio)
        for walk in walks:
            assert (np.diff(walk.samples.t) > 0).all()
            assert np.isfinite(walk.samples.mag).all()


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400))
def test_garbage_is_refused(content: bytes) -> None:
    with pytest.raises(InputError):
        read(content)
