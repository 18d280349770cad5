from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest

from app.api.schemas.segments import SegmentOut
from app.services.records import Scope
from tests.api.harness import Api, as_msgpack, plain, segment_body


def path(session_id: str) -> str:
    return f"/v1/sessions/{session_id}/segments"


def test_waits_for_the_fixes(api: Api) -> None:
    session_id = api.session_id()
    response = api.post(
        path(session_id), key=Scope.LOCATE, json=plain(segment_body()), headers={"Prefer": "respond-async, wait=5"}
    )
    assert response.status_code == 200
    assert response.headers["Preference-Applied"] == "wait=5"
    assert "Isodyn-Repeated" not in response.headers
    answer = response.json()
    SegmentOut.model_validate(answer)
    assert answer["state"] == "done"
    assert answer["fixes"]["t_ms"] == segment_body()["samples"]["t_ms"][:3].tolist()
    assert {len(column) for column in answer["fixes"].values()} == {3}
    last = {name: column[-1] for name, column in answer["fixes"].items()}
    assert {name: answer["position"][name] for name in last} == last
    assert answer["position"]["ellipse95"]["semi_major_m"] > answer["position"]["ellipse95"]["semi_minor_m"] > 0
    assert api.get(response.headers["Location"]).json() == answer


def test_earlier_steps_are_told_once_more(api: Api) -> None:
    session_id = api.session_id()
    first, second = (
        api.ok("POST", path(session_id), json=plain(segment_body(seq)), headers={"Prefer": "wait=5"}) for seq in (0, 1)
    )
    assert all(column == [] for column in first["fixed_lag"].values())
    SegmentOut.model_validate(second)
    assert second["fixed_lag"]["t_ms"] == first["fixes"]["t_ms"][:2]
    assert second["fixed_lag"]["kind"] == ["fixed_lag"] * 2
    assert (second["fixes"]["kind"], second["position"]["kind"]) == (["filtered"] * 3, "filtered")
    assert second["fixed_lag"]["x"] != first["fixes"]["x"][:2]
    assert api.ok("GET", f"{path(session_id)}/1") == second
    assert api.ok("POST", path(session_id), json=plain(segment_body(1))) == second


def test_without_waiting_there_is_a_place_to_look(api: Api) -> None:
    session_id = api.session_id()
    api.worker.idle = True
    response = api.post(path(session_id), json=plain(segment_body()))
    assert response.status_code == 202
    answer = response.json()
    SegmentOut.model_validate(answer)
    assert (answer["state"], answer["fixes"], answer["position"]) == ("queued", None, None)
    assert answer["fixed_lag"] is None
    api.worker.work()
    done = api.get(response.headers["Location"]).json()
    assert (done["state"], len(done["fixes"]["x"])) == ("done", 3)


def test_the_wait_ends_as_soon_as_the_job_does(api: Api) -> None:
    session_id = api.session_id()
    api.worker.idle = True

    async def scene() -> tuple[int, float]:
        started = time.perf_counter()
        request = asyncio.create_task(
            api.acall("POST", path(session_id), json=plain(segment_body()), headers={"Prefer": "wait=20"})
        )
        deadline = started + 10.0
        while not api.broker.waiting and time.perf_counter() < deadline:
            await asyncio.sleep(0.005)
        await asyncio.to_thread(api.worker.work)
        return (await request).status_code, time.perf_counter() - started

    status, seconds = asyncio.run(scene())
    assert status == 200
    assert seconds < 10.0


def test_the_longest_wait_is_a_setting(make_api: Callable[..., Api]) -> None:
    api = make_api(max_wait_s=0.05)
    session_id = api.session_id()
    api.worker.idle = True
    response = api.post(path(session_id), json=plain(segment_body()), headers={"Prefer": "wait=600"})
    assert response.status_code == 202


@pytest.mark.parametrize("prefer", ["wait=-1", "wait=abc", "await=5", "wait", ""])
def test_a_wish_that_is_none_is_ignored(api: Api, prefer: str) -> None:
    session_id = api.session_id()
    api.worker.idle = True
    response = api.post(path(session_id), json=plain(segment_body()), headers={"Prefer": prefer})
    assert response.status_code == 202


@pytest.mark.parametrize("encode", [lambda body: {"json": plain(body)}, as_msgpack])
def test_a_repeated_segment_gets_the_first_answer(api: Api, encode: Callable[..., dict[str, object]]) -> None:
    session_id = api.session_id()
    first = api.post(path(session_id), json=plain(segment_body()), headers={"Prefer": "wait=5"})
    before = api.stored()
    again = api.post(path(session_id), **encode(segment_body()))
    assert again.status_code == 200
    assert again.headers["Isodyn-Repeated"] == "true"
    assert again.json() == first.json()
    assert api.stored() == before


def test_other_content_under_the_same_number_is_refused(api: Api) -> None:
    session_id = api.session_id()
    api.ok("POST", path(session_id), json=plain(segment_body()))
    before = api.stored()
    body = plain(segment_body())
    body["samples"]["mag"]["x"][0] += 1.0
    refused = api.post(path(session_id), json=body)
    assert refused.status_code == 409
    assert refused.json()["type"].endswith("/sequence-conflict")
    assert "seq 0" in refused.json()["detail"]
    assert api.stored() == before


def test_segments_come_in_order(api: Api) -> None:
    session_id = api.session_id()
    refused = api.post(path(session_id), json=plain(segment_body(2)))
    assert refused.status_code == 409
    assert refused.json()["type"].endswith("/sequence-gap")
    assert "send seq 0 first" in refused.json()["detail"]
    for seq in range(3):
        api.ok("POST", path(session_id), json=plain(segment_body(seq)))
    listed = api.ok("GET", path(session_id))["items"]
    assert [item["seq"] for item in listed] == [0, 1, 2]
    assert api.ok("GET", f"/v1/sessions/{session_id}")["next_seq"] == 3


def test_time_does_not_run_backwards_between_segments(api: Api) -> None:
    session_id = api.session_id()
    api.ok("POST", path(session_id), json=plain(segment_body(0)))
    before = api.stored()
    refused = api.post(path(session_id), json=plain({**segment_body(0), "seq": 1}))
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "samples.t_ms"
    assert api.stored() == before


def test_a_closed_session_takes_no_more(api: Api) -> None:
    session_id = api.session_id()
    api.ok("POST", path(session_id), json=plain(segment_body(0)))
    api.ok("POST", f"/v1/sessions/{session_id}/close")
    before = api.stored()
    refused = api.post(path(session_id), json=plain(segment_body(1)))
    assert refused.status_code == 409
    assert refused.json()["type"].endswith("/session-closed")
    assert "open a new session" in refused.json()["detail"]
    assert api.post(path(session_id), json=plain(segment_body(0))).headers["Isodyn-Repeated"] == "true"
    assert api.stored() == before


def test_a_full_queue_says_when_to_come_back(make_api: Callable[..., Api]) -> None:
    api = make_api(max_queued=1)
    session_id = api.session_id()
    api.worker.idle = True
    api.ok("POST", path(session_id), json=plain(segment_body(0)))
    refused = api.post(path(session_id), json=plain(segment_body(1)))
    assert refused.status_code == 503
    assert refused.json()["type"].endswith("/overloaded")
    assert int(refused.headers["Retry-After"]) >= 1
    assert api.stored()["segments"] == 1


def test_a_failed_segment_says_why_and_the_session_goes_on(api: Api) -> None:
    session_id = api.session_id()
    api.worker.error = "the worker died in each of 3 attempts"
    failed = api.ok("POST", path(session_id), json=plain(segment_body(0)), headers={"Prefer": "wait=5"})
    assert (failed["state"], failed["fixes"]) == ("failed", None)
    assert failed["error"] == api.worker.error
    api.worker.error = None
    done = api.ok("POST", path(session_id), json=plain(segment_body(1)), headers={"Prefer": "wait=5"})
    assert done["state"] == "done"


def test_wifi_goes_along(api: Api) -> None:
    session_id = api.session_id()
    wifi = {"t_ms": [1_790_000_000_000.0], "bssid": ["02:00:00:00:00:01"], "rssi": [-60.0]}
    api.ok("POST", path(session_id), json={**plain(segment_body(0)), "wifi": wifi})
    other = api.post(path(session_id), json={**plain(segment_body(0)), "wifi": {**wifi, "rssi": [-61.0]}})
    assert other.status_code == 409
