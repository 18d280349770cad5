"""The doors for phones over HTTP: tokens, what phones are told, and what comes of any message."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.services.records import Scope
from tests.api.harness import Api, Options
from tests.exchange.recordings import WALK
from tests.support.phones import Phone, phyphox_bodies, sensor_logger_messages

BODIES = sensor_logger_messages(WALK.samples)
FAR_IDS = [0, -1, 2**31, 2**63, 10**30, 1.5, "7", None, True, [], float("1e300")]


def make_token(api: Api, level_id: str | None = None, *, key: Scope = Scope.ADMIN, **said: Any) -> dict[str, Any]:
    device = api.ok("POST", "/v1/devices", json={"name": "phone"})
    level_id = api.mapped_level().id if level_id is None else level_id
    body = {"name": "phone", "app": "sensor-logger", "device_id": device["id"], "level_id": level_id, **said}
    answer: dict[str, Any] = api.ok("POST", "/v1/ingest-tokens", json=body, key=key)
    return answer


def push(api: Api, token: dict[str, Any], body: bytes) -> Any:
    url = token["url"].removesuffix("/experiment.phyphox")
    return api.post(url, key=None, content=body, headers={"Content-Type": "application/json"})


def recordings(api: Api, **wanted: str) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = api.ok("GET", "/v1/recordings", params=wanted)["items"]
    return items


# Tokens


def test_a_secret_is_told_once(api: Api) -> None:
    token = make_token(api)
    secret = token["token"]
    assert token["url"] == f"http://isodyn.test/v1/ingest/sensor-logger/{secret}"
    assert any("Push URL" in line for line in token["settings"])
    for path in ("/v1/ingest-tokens", f"/v1/ingest-tokens/{token['id']}", "/v1/recordings", "/v1/devices"):
        assert secret not in api.get(path).text
    assert api.get(f"/v1/ingest-tokens/{token['id']}").json()["id"] == token["id"]


def test_a_revoked_token_says_so_to_the_person_with_the_phone(api: Api) -> None:
    token = make_token(api)
    assert push(api, token, BODIES[0]).status_code == 200
    assert api.call("DELETE", f"/v1/ingest-tokens/{token['id']}").status_code == 204
    refused = push(api, token, BODIES[1])
    assert (refused.status_code, refused.headers["Content-Type"]) == (499, "text/plain; charset=utf-8")
    assert "make a new one" in refused.text
    assert push(api, {"url": token["url"] + "x"}, BODIES[1]).status_code == 499
    (listed,) = api.ok("GET", "/v1/ingest-tokens")["items"]
    assert listed["revoked_at"]


def test_who_may_make_a_token_for_surveys(api: Api) -> None:
    level_id = api.level().id
    device = api.ok("POST", "/v1/devices", json={"name": "phone"})
    body = {"name": "p", "app": "sensor-logger", "device_id": device["id"], "level_id": level_id, "purpose": "survey"}
    refused = api.post("/v1/ingest-tokens", json=body, key=Scope.LOCATE)
    assert (refused.status_code, refused.json()["type"].rsplit("/", 1)[1]) == (403, "forbidden")
    assert api.post("/v1/ingest-tokens", json=body, key=Scope.ADMIN).status_code == 201


def test_a_token_opens_its_own_door_only(api: Api) -> None:
    token = make_token(api)
    for path in ("/v1/recordings", "/v1/ingest-tokens", "/v1/sessions"):
        assert api.get(path, key=token["token"]).status_code == 401


def test_a_token_is_in_no_problem_and_no_metric(make_api: Callable[..., Api]) -> None:
    api = make_api(rate_limit_per_minute=1, rate_limit_burst=5)
    secret = "isi_" + "x" * 32
    url = f"http://isodyn.test/v1/ingest/sensor-logger/{secret}"
    answers = [push(api, {"url": url}, BODIES[0]) for _ in range(7)]
    assert [one.status_code for one in answers] == [499] * 5 + [429] * 2
    answers.append(api.get(url, key=None))  # no such method
    answers.append(api.post(f"{url}/more", key=None))  # no such path
    for one in answers:
        assert secret not in one.text
        assert secret not in str(one.headers)
    assert secret not in str(api.metrics.requests)


# Messages


def test_a_test_push_needs_a_good_token(api: Api) -> None:
    token = make_token(api)
    for body in (b'{"messageId":0,"sessionId":"s","deviceId":"d","payload":[]}', b'{"payload":[]}'):
        assert push(api, token, body).json() == {"stored": True, "repeated": False}
        assert push(api, {"url": token["url"] + "x"}, body).status_code == 499
    assert recordings(api) == []


@pytest.mark.parametrize("body", [b"{", b"[]", b"null", b'"x"', b'{"payload": 3}', b"\xff\xfe", b'{"payload":[7]}'])
def test_what_is_no_message_is_refused_in_words(api: Api, body: bytes) -> None:
    for app in ("sensor-logger", "phyphox"):
        answer = push(api, make_token(api, app=app), body)
        if app == "sensor-logger" or answer.status_code != 200:
            assert answer.status_code == 499
            assert len(answer.text) > 10
    assert recordings(api) == []


def test_missing_sensors_are_told_although_messages_are_stored(api: Api) -> None:
    token = make_token(api)
    answers = []
    for body in BODIES[:5]:
        message = json.loads(body)
        message["payload"] = [one for one in message["payload"] if one["name"] in ("magnetometer", "accelerometer")]
        answers.append(push(api, token, json.dumps(message).encode()))
    # others may be slow to start: the first messages prove nothing
    assert [one.status_code for one in answers] == [200, 200, 499, 499, 499]
    assert "gyroscope, gravity" in answers[-1].text
    assert recordings(api)[0]["n_messages"] == 5


def test_a_walk_becomes_a_session(api: Api) -> None:
    token = make_token(api)
    for body in BODIES:
        assert push(api, token, body).json() == {"stored": True, "repeated": False}
    assert push(api, token, BODIES[3]).json() == {"stored": True, "repeated": True}
    (recording,) = recordings(api, token_id=token["id"])
    closed = api.ok("POST", f"/v1/recordings/{recording['id']}/close")
    assert (closed["state"], closed["problem"], closed["n_messages"]) == ("closed", "", len(BODIES))
    assert api.ok("POST", f"/v1/recordings/{recording['id']}/close") == closed
    assert api.ok("GET", f"/v1/sessions/{closed['session_id']}")["status"] == "closed"
    assert len(api.ok("GET", f"/v1/sessions/{closed['session_id']}/positions")["number"]) > 5


# Surveys


def survey(api: Api, labels: list[str] | None = None, **said: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A pushed and closed survey recording; without labels annotations are "x,y"."""
    level_id = said.pop("level_id", None) or api.mapped_level().id
    token = make_token(api, level_id, purpose="survey", **said)
    api.worker.idle = True  # maps are ordered here, and built elsewhere
    for body in sensor_logger_messages(WALK.samples, WALK.waypoints, labels=labels or ()):
        assert push(api, token, body).status_code == 200
    return token, api.ok("POST", f"/v1/recordings/{recordings(api, token_id=token['id'])[0]['id']}/close")


def set_markers(api: Api, level_id: str) -> list[str]:
    points = WALK.waypoints
    markers = [
        {"name": f"P{i}", "x": float(x), "y": float(y)} for i, (x, y) in enumerate(zip(points.x, points.y, strict=True))
    ]
    api.ok("PUT", f"/v1/levels/{level_id}/markers", json={"markers": markers})
    return [one["name"] for one in markers]


@pytest.mark.parametrize("form", ["x,y", "markers", "route"])
def test_annotations_make_a_walk(api: Api, form: str) -> None:
    level_id = api.mapped_level().id
    names = set_markers(api, level_id)
    said = {"route": names} if form == "route" else {}
    labels = {"x,y": None, "markers": [name.lower() for name in names], "route": [""] * len(names)}[form]
    token, recording = survey(api, labels, level_id=level_id, **said)
    assert (recording["state"], recording["problem"]) == ("closed", "")
    (walk_id,) = recording["walk_ids"]
    walk = api.ok("GET", f"/v1/surveys/{token['survey_id']}/walks/{walk_id}")
    assert (walk["n_waypoints"], walk["n_samples"]) == (len(names), len(WALK.samples))


def test_walks_are_stored_once_although_recordings_are_repeated(api: Api) -> None:
    level_id = api.level().id
    token, first = survey(api, level_id=level_id)
    again, second = survey(api, level_id=level_id, survey_id=token["survey_id"])
    assert again["id"] != token["id"]
    assert first["walk_ids"] == second["walk_ids"]
    assert len(api.ok("GET", f"/v1/surveys/{token['survey_id']}/walks")["items"]) == 1


@pytest.mark.parametrize(("build", "published"), [("publish", [True]), ("draft", [False]), ("none", [])])
def test_a_map_is_ordered_as_the_token_says(api: Api, build: str, published: list[bool]) -> None:
    level_id = api.mapped_level().id
    survey(api, level_id=level_id, build=build)
    waiting = api.ok("GET", "/v1/jobs", params={"kind": "build_map", "state": "queued"})["items"]
    with api.database() as uow:
        orders = [uow.maps.get_build(job["id"]) for job in waiting]
    assert [one.publish for one in orders] == published
    assert {one.level_id for one in orders} <= {level_id}


def test_a_survey_without_waypoints_waits_and_is_mended(api: Api) -> None:
    token, waiting = survey(api, ["nowhere"] * len(WALK.waypoints))
    assert (waiting["state"], waiting["walk_ids"]) == ("waiting", [])
    assert "nowhere" in waiting["problem"]
    path = f"/v1/recordings/{waiting['id']}/waypoints"
    points = WALK.waypoints
    columns = {"t_ms": (points.t * 1000).tolist(), "x": points.x.tolist(), "y": points.y.tolist()}
    off = api.call("PUT", path, json={**columns, "t_ms": [t + 1e7 for t in columns["t_ms"]]})
    assert off.status_code == 422
    assert off.json()["errors"][0]["field"].startswith("waypoints")
    assert api.call("PUT", path, json={**columns, "x": columns["x"][:-1]}).status_code == 422
    mended = api.ok("PUT", path, json=columns)
    assert (mended["state"], len(mended["walk_ids"])) == ("closed", 1)
    assert api.call("PUT", path, json=columns).status_code == 409
    assert len(api.ok("GET", f"/v1/surveys/{token['survey_id']}/walks")["items"]) == 1


def test_waypoints_belong_to_surveys(api: Api) -> None:
    token = make_token(api)
    push(api, token, BODIES[0])
    path = f"/v1/recordings/{recordings(api)[0]['id']}/waypoints"
    refused = api.call("PUT", path, json={"t_ms": [1, 2], "x": [1, 2], "y": [3, 4]})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "recording_id")


# phyphox


def test_phyphox_is_answered_with_its_position(api: Api) -> None:
    token = make_token(api, app="phyphox")
    file = api.get(token["url"], key=None)
    assert file.headers["Content-Type"].startswith("application/xml")
    assert file.headers["Cache-Control"] == "no-store"
    ElementTree.fromstring(file.content)
    assert token["url"].removesuffix("/experiment.phyphox") in file.text
    answers = [push(api, token, body) for body in phyphox_bodies(WALK.samples, ios=True)]
    assert all(one.status_code == 200 for one in answers)
    assert set(answers[0].json()) == set(answers[-1].json()) == {"x", "y", "sd", "status"}
    (recording,) = recordings(api)
    last = api.ok("GET", f"/v1/sessions/{recording['session_id']}/positions")["fixes"]
    told = answers[-1].json()
    assert told["status"] != [0]
    if told["x"]:
        assert told["x"][0] == pytest.approx(last["x"][-1], abs=0.01)


def test_an_experiment_that_is_started_anew_is_a_new_recording(api: Api) -> None:
    token = make_token(api, app="phyphox")
    later = phyphox_bodies(
        type(WALK.samples)(WALK.samples.t + 3600, *(getattr(WALK.samples, n) for n in ("mag", "acc", "gyro")))
    )
    for body in [*phyphox_bodies(WALK.samples)[:4], *later[:4]]:
        assert push(api, token, body).status_code == 200
    assert [one["n_messages"] for one in recordings(api)] == [4, 4]


def test_a_revoked_experiment_is_told_in_words(api: Api) -> None:
    token = make_token(api, app="phyphox")
    api.call("DELETE", f"/v1/ingest-tokens/{token['id']}")
    assert api.get(token["url"], key=None).status_code == 499
    assert push(api, token, phyphox_bodies(WALK.samples)[0]).status_code == 499


# Whatever comes


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Api, dict[str, dict[str, Any]]]]:
    api = Api(tmp_path_factory.mktemp("ingest"), Options())
    level_id = api.mapped_level().id
    tokens = {app: make_token(api, level_id, app=app) for app in ("sensor-logger", "phyphox")}
    yield api, tokens
    api.close()


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
CALM = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


@st.composite
def broken(draw: st.DrawFn, bodies: list[bytes]) -> bytes:
    """A good message with a part replaced, cut or flipped."""
    body = draw(st.sampled_from(bodies))
    if draw(st.booleans()):
        at = draw(st.integers(0, len(body)))
        return body[:at] + draw(st.binary(max_size=6)) + body[at + draw(st.integers(0, 6)) :]
    value = json.loads(body)
    key = draw(st.sampled_from(sorted(value)))
    value[key] = draw(JSON_VALUES | st.sampled_from(FAR_IDS))
    return json.dumps(value).encode()


SHORT = sensor_logger_messages(WALK.samples, phone=Phone(session_id="f"), batch_s=0.2)[:3]
SHORT_PHYPHOX = phyphox_bodies(WALK.samples, interval_s=0.2)[1:4]


@CALM
@given(broken(SHORT) | st.binary(max_size=40))
def test_no_message_of_sensor_logger_is_too_much(shared: tuple[Api, dict[str, dict[str, Any]]], body: bytes) -> None:
    api, tokens = shared
    answer = push(api, tokens["sensor-logger"], body)
    assert answer.status_code in (200, 499), answer.text
    assert answer.content


@CALM
@given(broken(SHORT_PHYPHOX) | st.binary(max_size=40))
def test_no_message_of_phyphox_is_too_much(shared: tuple[Api, dict[str, dict[str, Any]]], body: bytes) -> None:
    api, tokens = shared
    answer = push(api, tokens["phyphox"], body)
    assert answer.status_code in (200, 499), answer.text
    assert answer.content


@pytest.mark.parametrize("number", FAR_IDS, ids=str)
def test_numbers_of_messages_that_cannot_be(api: Api, number: object) -> None:
    message = {**json.loads(BODIES[0]), "messageId": number}
    answer = push(api, make_token(api), json.dumps(message).encode())
    assert answer.status_code in (200, 499)


def test_a_message_that_is_too_large_is_told_in_words(make_api: Callable[..., Api], tmp_path: Path) -> None:
    api = make_api(max_body_bytes=10_000)
    answer = push(api, make_token(api), BODIES[0] + b" " * 20_000)
    assert answer.status_code == 499
    assert "10000" in answer.text


def test_nothing_is_read_for_an_unknown_token(make_api: Callable[..., Api]) -> None:
    api = make_api(max_body_bytes=1000)
    for app in ("sensor-logger", "phyphox"):
        answer = push(api, {"url": f"http://isodyn.test/v1/ingest/{app}/isi_unknown"}, b"x" * 2000)
        assert (answer.status_code, "does not know" in answer.text) == (499, True)


@pytest.mark.parametrize("where", ["sessionId", "text"])
def test_half_a_character_is_refused_in_words(api: Api, where: str) -> None:
    values = {"text": "\ud800"} if where == "text" else {"text": "a"}
    note = {"name": "annotation", "time": 1764000012300000000, "values": values}
    reading = {"name": "magnetometer", "time": 1764000012300000000, "values": {"x": float("nan"), "y": 1, "z": 2}}
    session = "\ud800" if where == "sessionId" else "s"
    body = {"messageId": 0, "sessionId": session, "deviceId": "d", "payload": [reading, note]}
    answer = push(api, make_token(api), json.dumps(body).encode())
    assert (answer.status_code, "no JSON" in answer.text) == (499, True)


def test_silence_ends_a_recording(api: Api) -> None:
    token = make_token(api)
    push(api, token, BODIES[0])
    api.clock.now += timedelta(hours=1)
    api.services.recordings.close_silent(timedelta(minutes=1))
    assert recordings(api, state="closed")[0]["token_id"] == token["id"]
