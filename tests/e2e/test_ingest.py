"""Phones that push: their recordings give what a client's upload of the same walk gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.engine.types import ImuSamples
from app.storage import Database
from tests.e2e.conftest import MakeService, Prepared
from tests.e2e.service import Service, open_session, segment_bodies
from tests.e2e.synthetic import Walk, survey_walks, trip
from tests.support.phones import sensor_logger_messages

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]


@pytest.fixture
def service(make_service: MakeService) -> Service:
    made = make_service()
    made.start()
    return made


@pytest.fixture(scope="module")
def walk() -> Walk:
    return trip(41, t0=1.76e9)


def make_token(service: Service, level_id: str, **said: Any) -> dict[str, Any]:
    device = service.post("/v1/devices", {"name": "phone"})
    body = {"name": "phone", "app": "sensor-logger", "device_id": device["id"], "level_id": level_id, **said}
    return service.post("/v1/ingest-tokens", body)


def push(service: Service, token: dict[str, Any], body: bytes) -> str:
    answer = service.request("POST", token["url"], content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 200, answer.text
    return answer.text


def recording_of(service: Service, token: dict[str, Any]) -> dict[str, Any]:
    (recording,) = service.get("/v1/recordings", token_id=token["id"])["items"]
    return recording


def fixes_of(service: Service, session_id: str) -> np.ndarray:
    page = service.get(f"/v1/sessions/{session_id}/positions", limit=500)
    assert page["next_cursor"] is None
    fixes = page["fixes"]
    return np.array([fixes["t_ms"], fixes["x"], fixes["y"]]).T


def stored_samples(service: Service, session_id: str) -> ImuSamples:
    """All samples of a session, as the database has them."""
    database = Database.at(service.data_dir / "isodyn.db")
    with database() as uow:
        parts = [one.samples for one in uow.sessions.load_segments(session_id, limit=10_000)]
    database.close()
    return ImuSamples(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "mag", "acc", "gyro"))
    )


def test_a_pushed_walk_is_located_as_an_uploaded_one(service: Service, prepared: Prepared, walk: Walk) -> None:
    prior = {"x": float(walk.x[0]), "y": float(walk.y[0]), "radius_m": 3.0}
    token = make_token(service, prepared.level_id, prior=prior)
    for body in sensor_logger_messages(walk.samples, swapped=[2, 9], repeated=[4, 5]):
        push(service, token, body)
    recording = service.post(f"/v1/recordings/{recording_of(service, token)['id']}/close", {})
    assert (recording["state"], recording["problem"], recording["n_late"]) == ("closed", "", 0)
    native = open_session(service, prepared.level_id, walk)
    for body in segment_bodies(walk, 1.0):
        service.post(f"/v1/sessions/{native}/segments", body)
    service.await_all_jobs()
    pushed, uploaded = (fixes_of(service, one) for one in (recording["session_id"], native))
    times, ours, theirs = np.intersect1d(pushed[:, 0], uploaded[:, 0], return_indices=True)
    # one fix more is told at the end of a segment, and two messages that were interchanged are one segment
    assert len(times) >= len(uploaded) - 2
    apart = np.hypot(*(pushed[ours, 1:] - uploaded[theirs, 1:]).T)
    # two sessions draw other particles: as far apart are two uploads of one walk
    # (with the same ones they are equal: tests/evaluation/test_pushed_walks.py)
    assert apart.mean() < 0.3
    service.terminate()
    first, second = (stored_samples(service, one) for one in (recording["session_id"], native))
    assert np.array_equal(first.t, second.t)
    for name in ("mag", "acc", "gyro"):
        assert np.abs(getattr(first, name) - getattr(second, name)).max() < 1e-5


def test_a_pushed_survey_becomes_walks_and_a_map(service: Service, prepared: Prepared) -> None:
    walks = survey_walks()
    before = service.get(f"/v1/levels/{prepared.level_id}")["current_map_id"]
    token = make_token(service, prepared.level_id, purpose="survey")
    for body in sensor_logger_messages(walks[0].samples, walks[0].waypoints):
        push(service, token, body)
    recording = service.post(f"/v1/recordings/{recording_of(service, token)['id']}/close", {})
    assert (recording["state"], recording["problem"], len(recording["walk_ids"])) == ("closed", "", 1)
    service.await_all_jobs()
    assert service.get(f"/v1/levels/{prepared.level_id}")["current_map_id"] != before


def test_secrets_of_push_addresses_are_in_nothing_the_service_says(
    make_service: MakeService, prepared: Prepared
) -> None:
    service = make_service(ISODYN_LOG_LEVEL="debug", ISODYN_RATE_LIMIT_PER_MINUTE="60", ISODYN_RATE_LIMIT_BURST="20")
    service.start()
    token = make_token(service, prepared.level_id)
    body = sensor_logger_messages(trip(42, t0=1.76e9).samples)[0]
    said = [push(service, token, body)]
    wrong = f"{token['url']}wrong"
    for url, content in (
        (token["url"], b"{"),
        (wrong, body),
        (token["url"] + "/more", body),
        (token["url"], b"\xff" * 99),
    ):
        said.append(service.request("POST", url, content=content).text)
    said += [service.request("GET", token["url"]).text]
    refused = [service.request("POST", token["url"], content=body) for _ in range(40)]
    assert {one.status_code for one in refused} == {200, 429}
    said += [one.text for one in refused]
    said.append(service.request("GET", "/metrics").text)
    assert 'route="/v1/ingest/sensor-logger/{token}"' in said[-1]
    service.terminate()
    assert token["token"] not in "".join([*said, service.log, service.shown])


def test_a_kill_between_two_messages_loses_nothing(service: Service, prepared: Prepared, walk: Walk) -> None:
    token = make_token(service, prepared.level_id, prior={"x": float(walk.x[0]), "y": float(walk.y[0])})
    bodies = sensor_logger_messages(walk.samples)
    for number, body in enumerate(bodies):
        push(service, token, body)
        if number == len(bodies) // 2:
            service.kill()
            service.start()
    recording = service.post(f"/v1/recordings/{recording_of(service, token)['id']}/close", {})
    assert (recording["state"], recording["problem"], recording["n_late"]) == ("closed", "", 0)
    service.await_all_jobs()
    service.terminate()
    assert np.array_equal(stored_samples(service, recording["session_id"]).t, walk.samples.t)
