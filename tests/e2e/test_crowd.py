"""From the HTTP door: a surveyed map, everyday sessions of several keys, and what becomes of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.e2e.conftest import SEGMENT_S, MakeService, Prepared
from tests.e2e.service import Service, samples_body, segment_bodies
from tests.e2e.synthetic import Walk, trip

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]


def upload(service: Service, survey_id: str, walk: Walk) -> str:
    marks = walk.waypoints
    body = {
        "name": f"late {walk.samples.t[0]}",
        "frame": "android",
        "samples": samples_body(walk.samples),
        "waypoints": {"t_ms": (marks.t * 1e3).tolist(), "x": marks.x.tolist(), "y": marks.y.tolist()},
    }
    walk_id: str = service.post(f"/v1/surveys/{survey_id}/walks", body)["id"]
    return walk_id


def go(service: Service, level_id: str, walk: Walk, secret: str) -> str:
    """A session of one key that opted in, closed at its end."""
    headers = {"Authorization": f"Bearer {secret}"}
    prior = {"x": float(walk.x[0]), "y": float(walk.y[0]), "radius_m": 1.0}
    opened = {"level_id": level_id, "prior": prior, "contribute": True}
    session = service.request("POST", "/v1/sessions", json=opened, headers=headers).json()
    assert session["contributes"]
    for body in segment_bodies(walk, SEGMENT_S):
        answer = service.request("POST", f"/v1/sessions/{session['id']}/segments", json=body, headers=headers)
        assert answer.status_code in (200, 202), answer.text
    service.request("POST", f"/v1/sessions/{session['id']}/close", headers=headers)
    session_id: str = session["id"]
    return session_id


def current(service: Service, level_id: str) -> dict[str, Any]:
    level = service.get(f"/v1/levels/{level_id}")
    return service.get(f"/v1/maps/{level['current_map_id']}")


def settled(service: Service) -> None:
    """Nothing runs any more, and what that caused neither."""
    for _ in range(3):
        service.await_all_jobs()


def test_a_map_lives_on_what_its_users_see(make_service: MakeService, prepared: Prepared) -> None:
    service = make_service()
    service.start()
    level_id = prepared.level_id
    built = current(service, level_id)
    (survey,) = service.get("/v1/surveys", level_id=level_id)["items"]

    walk_id = upload(service, survey["id"], trip(31, t0=1.76e9))
    job = service.post("/v1/maps", {"level_id": level_id, "mode": "update"}, Prefer="wait=30")
    assert job["state"] == "done", job
    updated = current(service, level_id)
    assert (updated["kind"], updated["added"], updated["parent_id"]) == ("update", [walk_id], built["id"])

    secrets = [service.post("/v1/keys", {"name": f"user {i}", "scopes": ["locate"]})["secret"] for i in range(3)]
    honest = [go(service, level_id, trip(40 + i, t0=1.77e9 + 1e3 * i), secrets[i % 2]) for i in range(4)]
    walk = trip(50, t0=1.78e9)
    swing = 25.0 * np.sin(2.0 * np.pi * (walk.samples.t - walk.samples.t[0]) / 8.0)  # a magnet in the other hand
    magnet = walk.samples.mag + swing[:, None] * np.array([0.3, 0.3, 0.9])
    hostile = go(service, level_id, replace(walk, samples=replace(walk.samples, mag=magnet)), secrets[2])
    settled(service)

    contributions = {one["session_id"]: one for one in service.get("/v1/contributions")["items"]}
    assert contributions.keys() == {*honest, hostile}
    states = [contributions[session_id]["state"] for session_id in honest]
    assert states == ["used"] * 4, contributions
    assert contributions[hostile]["state"] in ("quarantined", "empty"), contributions[hostile]
    assert all(contributions[session_id]["n_agreed"] > 20 for session_id in honest)

    grown = current(service, level_id)
    assert grown["version"] > updated["version"]
    assert grown["n_samples"] > updated["n_samples"] + 200
    used = contributions[honest[0]]
    rejected = service.post(f"/v1/contributions/{used['id']}/reject", {})
    assert rejected["state"] == "rejected"
    settled(service)
    assert current(service, level_id)["removed"] == [used["id"]]
