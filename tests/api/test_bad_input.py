"""Every bad input is a problem that names the field and the remedy, at once, and nothing is stored."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from tests.api.harness import Api, as_msgpack, plain, segment_body, walk_body

There = tuple[Api, str]
Change = Callable[[dict[str, Any]], None]


def at(path: str, value: object) -> Change:
    """Set what stands at a path (a number indexes a column); a callable maps the old value."""

    def change(body: dict[str, Any]) -> None:
        *parents, last = path.split(".")
        target: Any = body
        for name in parents:
            target = target[name]
        key: Any = int(last) if last.isdigit() else last
        target[key] = value(target[key]) if callable(value) else value

    return change


def times(factor: float, *names: str) -> Change:
    def change(body: dict[str, Any]) -> None:
        for name in names:
            for axis in "xyz":
                body["samples"][name][axis] = body["samples"][name][axis] * factor

    return change


def drop(path: str) -> Change:
    def change(body: dict[str, Any]) -> None:
        *parents, last = path.split(".")
        target: Any = body
        for name in parents:
            target = target[name]
        del target[last]

    return change


def delay(index: int, seconds: float) -> Change:
    return at("samples.t_ms", lambda t: t + np.where(np.arange(len(t)) >= index, seconds * 1000.0, 0.0))


def without_gravity(body: dict[str, Any]) -> None:
    body["samples"]["acc"]["z"] = body["samples"]["acc"]["z"] - 9.81


SAMPLES = [
    ("NaN", at("samples.mag.x.7", np.nan), "samples.mag.x", "value 7 is NaN", "finite"),
    ("infinity", at("samples.gyro.z.0", np.inf), "samples.gyro.z", "infinite", "finite"),
    ("minus infinity", at("samples.acc.y.3", -np.inf), "samples.acc.y", "infinite", "finite"),
    ("NaN in time", at("samples.t_ms.5", np.nan), "samples.t_ms", "value 5 is NaN", "finite"),
    ("field above 2000 uT", at("samples.mag.y.9", 2500.0), "samples.mag", "sample 9 has", "2000 uT"),
    ("acceleration above 200 m/s^2", at("samples.acc.z.2", 201.0), "samples.acc", "sample 2 has", "200 m/s^2"),
    ("rate above 50 rad/s", at("samples.gyro.x.4", -51.0), "samples.gyro", "sample 4 has", "50 rad/s"),
    ("time backwards", at("samples.t_ms.100", lambda t: t - 40.0), "samples.t_ms", "runs backwards at", "time order"),
    ("time repeated", at("samples.t_ms.100", lambda t: t - 20.0), "samples.t_ms", "repeats at value 100", "once"),
    ("gap over 1 s", delay(60, 1.0), "samples.t_ms", "gap of 1.02 s after value 59", "split"),
    ("empty column", at("samples.mag.z", np.array([])), "samples.mag.z", "is empty", "at least one"),
    ("empty time", at("samples.t_ms", np.array([])), "samples.t_ms", "is empty", "at least one"),
    (
        "shorter column",
        at("samples.acc.x", lambda c: c[:-1]),
        "samples.acc.x",
        "values, samples.t_ms has",
        "every column",
    ),
    ("nT sent as uT", times(1000.0, "mag"), "samples.mag", "looks like nT", "divide by 1000"),
    ("gauss sent as uT", times(0.01, "mag"), "samples.mag", "looks like gauss", "microtesla"),
    ("tesla sent as uT", times(1e-6, "mag"), "samples.mag", "looks like gauss, mT or T", "microtesla"),
    ("g sent as m/s^2", times(1 / 9.80665, "acc"), "samples.acc", "looks like g", "9.80665"),
    ("gravity taken out", without_gravity, "samples.acc", "gravity was taken out", "with gravity"),
    ("mg sent as m/s^2", times(1000 / 9.80665, "acc"), "samples.acc", "looks like mg", "0.00980665"),
    ("deg/s sent as rad/s", times(180 / np.pi, "gyro"), "samples.gyro", "looks like deg/s", "pi / 180"),
    ("seconds sent as ms", at("samples.t_ms", lambda t: t / 1000), "samples.t_ms", "looks like seconds", "by 1000"),
    ("us sent as ms", at("samples.t_ms", lambda t: t * 1000), "samples.t_ms", "looks like us", "milliseconds"),
    ("year 5030", at("samples.t_ms", lambda t: t + 9.5e13), "samples.t_ms", "a day ahead", "Unix milliseconds"),
    ("relative time", at("samples.t_ms", lambda t: t - t[0]), "samples.t_ms", "before the year", "Unix milliseconds"),
    ("no magnetometer", times(0.0, "mag"), "samples.mag", "no reading", "uT"),
    ("no gyroscope", times(0.0, "gyro"), "samples.gyro", "no reading", "rad/s"),
    ("5 Hz", at("samples.t_ms", lambda t: t[0] + np.arange(len(t)) * 200.0), "samples.t_ms", "200 ms", "8 samples"),
    ("unknown field", at("samples.temperature", [1.0]), "samples.temperature", "not permitted", "unknown fields"),
    ("unknown axis", at("samples.mag.w", [1.0]), "samples.mag.w", "not permitted", "unknown fields"),
    ("missing sensor", drop("samples.gyro"), "samples.gyro", "required", "add this field"),
    ("missing axis", drop("samples.gyro.y"), "samples.gyro.y", "required", "add this field"),
    ("a column that is none", at("samples.mag.x", 3.5), "samples.mag.x", "is not a column", "array of numbers"),
    ("a vector that is none", at("samples.mag", [1.0]), "samples.mag", "is not an object", "object"),
    ("unknown frame", at("frame", "ned"), "frame", "'android'", "'frd'"),
    ("Wi-Fi of different lengths", at("wifi.rssi", np.array([-50.0])), "wifi.rssi", "wifi.t_ms has 2", "every column"),
    ("Wi-Fi in mW", at("wifi.rssi.0", 1e3), "wifi.rssi", "value 0", "dBm"),
    ("Wi-Fi with NaN", at("wifi.rssi.1", np.nan), "wifi.rssi", "value 1", "dBm"),
    ("Wi-Fi without addresses", at("wifi.bssid.0", ""), "wifi.bssid", "value 0", "BSSID"),
]
JSON_ONLY = [
    ("null in a column", at("samples.mag.x.3", None), "samples.mag.x", "value 3 is null", "leave a sample out"),
    ("text in a column", at("samples.mag.x.3", "4.5"), "samples.mag.x", "value 3 is a string", "numbers only"),
    ("boolean in a column", at("samples.mag.x.0", True), "samples.mag.x", "value 0 is a boolean", "numbers only"),
    ("array in a column", at("samples.mag.x.0", [1]), "samples.mag.x", "value 0 is an array", "numbers only"),
    ("too large for a float", at("samples.mag.x.0", 1e300), "samples.mag.x", "value 0 is infinite", "finite"),
    ("address that is a number", at("wifi.bssid.1", 17), "wifi.bssid", "value 1", "strings"),
]
SEGMENT_ONLY = [
    (
        "too long in time",
        at("samples.t_ms", lambda t: t[0] + np.arange(len(t)) * 300.0),
        "samples.t_ms",
        "74.7 s",
        "60 s",
    ),
    ("seq below 0", at("seq", -1), "seq", "", "at least 0"),
    ("seq that is a string", at("seq", "0"), "seq", "integer", "integer"),
    ("seq that is a fraction", at("seq", 0.5), "seq", "integer", "integer"),
    ("seq that is no number", at("seq", True), "seq", "integer", "integer"),
    ("huge seq", at("seq", 2**31), "seq", "", "at most"),
    ("seq of 1e30", at("seq", 1e30), "seq", "is not an integer", "from 0 to 2147483647"),
    ("missing seq", drop("seq"), "seq", "required", "add this field"),
    ("field of a walk", at("waypoints", None), "waypoints", "not permitted", "unknown fields"),
]
WALK_ONLY = [
    ("one waypoint", lambda b: cut_waypoints(b, 1), "waypoints.t_ms", "1 of at least 2", "two places"),
    ("no waypoint", lambda b: cut_waypoints(b, 0), "waypoints.t_ms", "0 of at least 2", "two places"),
    ("no waypoints at all", drop("waypoints"), "waypoints", "required", "add this field"),
    (
        "waypoints of different lengths",
        at("waypoints.y", lambda c: c[:2]),
        "waypoints.y",
        "has 2 values",
        "every column",
    ),
    ("NaN in a waypoint", at("waypoints.x.1", np.nan), "waypoints.x", "value 1 is NaN", "finite"),
    (
        "waypoint too early",
        at("waypoints.t_ms.0", lambda t: t - 10_001.0),
        "waypoints.t_ms",
        "waypoint 0",
        "same clock",
    ),
    ("waypoint too late", at("waypoints.t_ms.2", lambda t: t + 10_001.0), "waypoints.t_ms", "waypoint 2", "same clock"),
    ("waypoints out of order", at("waypoints.t_ms", lambda t: t[::-1]), "waypoints.t_ms", "backwards", "time order"),
    ("waypoint far west", at("waypoints.x.0", -53.6), "waypoints.x", "waypoint 0 lies at -53.6 m", "level's frame"),
    ("waypoint far north", at("waypoints.y.2", 86.8), "waypoints.y", "waypoint 2 lies at 86.8 m", "level's frame"),
    ("waypoints in s", at("waypoints.t_ms", lambda t: t / 1e3), "waypoints.t_ms", "looks like seconds", "by 1000"),
    ("waypoints in us", at("waypoints.t_ms", lambda t: t * 1e3), "waypoints.t_ms", "looks like us", "by 1000"),
    ("waypoints in ns", at("waypoints.t_ms", lambda t: t * 1e6), "waypoints.t_ms", "looks like ns", "by 1000000"),
    ("nowhere to go", lambda b: stay(b), "waypoints.x", "at one place: 0.80 m in 26 s", "went through"),
    ("empty name", at("name", ""), "name", "", "longer"),
    ("name that does not show", at("name", " \t"), "name", "", "line of text"),
]


def stay(body: dict[str, Any]) -> None:
    body["waypoints"] = {
        "t_ms": body["samples"]["t_ms"][0] + np.array([-8_000.0, 0.0, 18_000.0]),
        "x": np.array([5.0, 5.4, 5.0]),
        "y": np.array([5.0, 5.0, 5.0]),
    }


def cut_waypoints(body: dict[str, Any], n: int) -> None:
    body["waypoints"] = {name: column[:n] for name, column in body["waypoints"].items()}


def segment_with(change: Change) -> dict[str, Any]:
    body = segment_body(wifi={"t_ms": np.array([1.0, 2.0]), "bssid": ["a", "b"], "rssi": np.array([-50.0, -60.0])})
    change(body)
    return body


def walk_with(change: Change) -> dict[str, Any]:
    body = walk_body()
    body["wifi"] = {"t_ms": np.array([1.0, 2.0]), "bssid": ["a", "b"], "rssi": np.array([-50.0, -60.0])}
    change(body)
    return body


def as_json(body: dict[str, Any]) -> dict[str, Any]:
    """With NaN and Infinity as Python, JavaScript libraries and others write them."""
    return {"content": json.dumps(plain(body)), "headers": {"Content-Type": "application/json"}}


def assert_refused(
    api: Api, response: httpx.Response, before: dict[str, int], field: str, message: str, remedy: str
) -> None:
    assert response.status_code == 422, response.text
    assert response.headers["Content-Type"] == "application/problem+json"
    problem = response.json()
    assert problem["type"] == "https://isodyn.dev/problems/invalid"
    error = next((error for error in problem["errors"] if error["field"] == field), None)
    assert error is not None, f"{field} is not named in {problem['errors']}"
    assert message in error["message"]
    assert remedy in error["remedy"]
    assert api.stored() == before


def named(cases: list[tuple[str, Change, str, str, str]]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(
        ("change", "field", "message", "remedy"), [case[1:] for case in cases], ids=[case[0] for case in cases]
    )


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Any:
    api = Api(tmp_path_factory.mktemp("segments"))
    yield api, f"/v1/sessions/{api.session_id()}/segments"
    api.close()


@named(SAMPLES + SEGMENT_ONLY)
@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_segment_refused(
    session: There, change: Change, field: str, message: str, remedy: str, encode: Callable[..., Any]
) -> None:
    api, path = session
    before = api.stored()
    response = api.post(path, **encode(segment_with(change)))
    assert_refused(api, response, before, field, message, remedy)


@named(JSON_ONLY)
def test_segment_refused_in_json(session: There, change: Change, field: str, message: str, remedy: str) -> None:
    api, path = session
    body = plain(segment_with(lambda _: None))
    change(body)
    before = api.stored()
    assert_refused(api, api.post(path, **as_json(body)), before, field, message, remedy)


def test_too_many_samples(session: There) -> None:
    api, path = session
    n = 20_001
    body = segment_body(n=n)
    body["samples"]["t_ms"] = body["samples"]["t_ms"][0] + np.arange(n) * 2.0
    before = api.stored()
    assert_refused(api, api.post(path, **as_msgpack(body)), before, "samples.t_ms", "20001 samples", "20000")


def test_a_binary_that_is_cut(session: There) -> None:
    api, path = session
    body = segment_body()
    body["samples"]["mag"]["x"] = body["samples"]["mag"]["x"].astype("<f4").tobytes()[:-1]
    before = api.stored()
    assert_refused(api, api.post(path, **as_msgpack(body)), before, "samples.mag.x", "999 bytes", "float32")


def test_all_fields_of_a_stage_are_named(session: There) -> None:
    api, path = session
    body = segment_with(lambda _: None)
    for name, axis in (("mag", "x"), ("gyro", "y")):
        body["samples"][name][axis] = body["samples"][name][axis][:-2]
    problem = api.post(path, **as_msgpack(body)).json()
    assert [error["field"] for error in problem["errors"]] == ["samples.mag.x", "samples.gyro.y"]
    assert problem["detail"].endswith("(and 1 more)")


@pytest.mark.timing
@pytest.mark.parametrize("encode", [as_json, as_msgpack])
def test_refusals_take_milliseconds(session: There, encode: Callable[..., Any]) -> None:
    api, path = session
    call = encode(segment_with(at("samples.mag.x.7", np.nan)))
    api.post(path, **call)
    best = min(_seconds(api, path, call) for _ in range(5))
    # measured: 6 ms with client and event loop set up for each call; the bound leaves room for a busy machine
    assert best < 0.1


def _seconds(api: Api, path: str, call: dict[str, Any]) -> float:
    started = time.perf_counter()
    assert api.post(path, **call).status_code == 422
    return time.perf_counter() - started


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Any:
    api = Api(tmp_path_factory.mktemp("walks"))
    level = api.level()
    survey_id = api.ok("POST", "/v1/surveys", json={"level_id": level.id, "name": "s"})["id"]
    yield api, f"/v1/surveys/{survey_id}/walks"
    api.close()


@named(SAMPLES + WALK_ONLY)
def test_walk_refused(survey: There, change: Change, field: str, message: str, remedy: str) -> None:
    api, path = survey
    before = api.stored()
    assert_refused(api, api.post(path, **as_json(walk_with(change))), before, field, message, remedy)


@named(WALK_ONLY)
def test_walk_refused_in_msgpack(survey: There, change: Change, field: str, message: str, remedy: str) -> None:
    api, path = survey
    before = api.stored()
    assert_refused(api, api.post(path, **as_msgpack(walk_with(change))), before, field, message, remedy)


def test_walks_may_be_longer_than_segments(survey: There) -> None:
    api, path = survey
    n = 30_000
    body = walk_body(n=n)
    body["samples"]["t_ms"] = body["samples"]["t_ms"][0] + np.arange(n) * 59.0
    body["waypoints"]["t_ms"] = body["samples"]["t_ms"][[0, 1000, n - 1]]
    assert api.post(path, **as_msgpack(body)).status_code == 201
    body["samples"]["t_ms"] = body["samples"]["t_ms"][0] + np.arange(n) * 61.0
    before = api.stored()
    assert_refused(api, api.post(path, **as_msgpack(body)), before, "samples.t_ms", "spans 1829.9 s", "1800 s a walk")


def test_waypoints_may_lie_a_little_outside(survey: There) -> None:
    api, path = survey
    body = walk_body(seed=7)
    body["waypoints"]["x"][0] = -53.4
    body["waypoints"]["t_ms"][0] -= 9_999.0
    assert api.post(path, **as_msgpack(body)).status_code == 201


def test_an_unknown_survey_is_found_first(survey: There) -> None:
    api, _ = survey
    assert api.post("/v1/surveys/srv_none/walks", **as_json(walk_body())).status_code == 404
