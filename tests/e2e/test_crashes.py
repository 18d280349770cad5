"""Kill what can be killed: every accepted segment is processed once in effect, with the fixes of a quiet run."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from app.workers.bootstrap import ONE_THREAD
from tests.e2e.conftest import MakeService, Prepared
from tests.e2e.service import Service
from tests.workers.polling import eventually, gone

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(900)]

Answers = dict[tuple[str, int], dict[str, Any]]
RETRIED = 'isodyn_jobs_retried_total{kind="locate_segment"}'


def in_turn(prepared: Prepared) -> list[tuple[str, dict[str, Any]]]:
    """All segments, a round of one of each session after the other."""
    rounds = itertools.zip_longest(
        *([(session_id, body) for body in bodies] for session_id, bodies in prepared.bodies.items())
    )
    return [item for one in rounds for item in one if item is not None]


def thirds(segments: list[tuple[str, dict[str, Any]]]) -> list[list[tuple[str, dict[str, Any]]]]:
    third = len(segments) // 3
    return [segments[:third], segments[third : 2 * third], segments[2 * third :]]


def send(service: Service, segments: list[tuple[str, dict[str, Any]]]) -> None:
    for session_id, body in segments:
        answer = service.request("POST", f"/v1/sessions/{session_id}/segments", json=body)
        assert answer.status_code in (200, 202), answer.text


def check_everything_was_done_once(service: Service, prepared: Prepared, expected: Answers) -> None:
    jobs = [job for job in service.await_all_jobs() if job["kind"] == "locate_segment"]
    assert len(jobs) == prepared.n_segments
    assert {job["state"] for job in jobs} == {"done"}
    for session_id, bodies in prepared.bodies.items():
        for body in bodies:
            answer = service.get(f"/v1/sessions/{session_id}/segments/{body['seq']}")
            quiet = expected[session_id, body["seq"]]
            assert answer["fixes"] == quiet["fixes"], f"{session_id} {body['seq']}"
            assert answer["position"] == quiet["position"]
    n_fixes = sum(len(answer["fixes"]["t_ms"]) for answer in expected.values())
    assert service.get("/v1/stats")["fixes"] == n_fixes


def test_segments_of_a_quiet_run_have_fixes(undisturbed: Answers) -> None:
    """Else the comparisons below would compare nothing."""
    assert all(answer["state"] == "done" for answer in undisturbed.values())
    assert sum(len(answer["fixes"]["t_ms"]) for answer in undisturbed.values()) > 10 * len(undisturbed)


def test_killing_the_service_loses_and_doubles_nothing(
    make_service: MakeService, prepared: Prepared, undisturbed: Answers
) -> None:
    """Twice: while segments come in and a map is built, and while the rest is processed."""
    service = make_service(ISODYN_WORKERS="1")
    service.start()
    n_maps = len(service.get("/v1/maps", level_id=prepared.level_id)["items"])
    segments = in_turn(prepared)
    send(service, segments[: len(segments) // 2])
    build = service.post("/v1/maps", {"level_id": prepared.level_id, "cell_m": 0.1})
    eventually(lambda: service.get(f"/v1/jobs/{build['id']}")["state"] != "queued")
    states = [job["state"] for job in service.jobs()]
    assert states.count("running") >= 1, "nothing was left to interrupt"
    service.kill()

    service.start()
    send(service, segments)  # the first half again, as a client would that never saw the answers
    states = [job["state"] for job in service.jobs()]
    assert states.count("queued") + states.count("running") >= 1, "nothing was left to interrupt"
    service.kill()

    service.start()
    check_everything_was_done_once(service, prepared, undisturbed)
    assert service.get(f"/v1/jobs/{build['id']}")["state"] == "done"
    assert len(service.get("/v1/maps", level_id=prepared.level_id)["items"]) == n_maps + 1


def test_killing_busy_workers_loses_and_doubles_nothing(
    make_service: MakeService, prepared: Prepared, undisturbed: Answers
) -> None:
    service = make_service(ISODYN_LOG_LEVEL="debug", ISODYN_WORKERS="1")
    service.start()
    eventually(lambda: len(service.workers()) == 2, 60)
    for worker in service.workers():
        assert {worker.environ()[name] for name in ONE_THREAD} == {"1"}
        assert worker.num_threads() == 2, "the task's and the one that watches the service"
    segments = in_turn(prepared)
    for kills, part in enumerate(thirds(segments), start=1):
        send(service, part)
        eventually(service.workers)  # one that was killed before may not be back yet
        max(service.workers(), key=lambda worker: worker.cpu_times().user).kill()
        eventually(lambda kills=kills: service.metric("isodyn_workers_lost_total") == kills)  # type: ignore[misc]
    assert service.metric(RETRIED) >= 1, "only idle workers were hit"
    check_everything_was_done_once(service, prepared, undisturbed)
    assert service.metric("isodyn_runner_errors_total") == 0
    assert service.shown == "", "the admin key is shown at the first start only"
    assert "isk_" not in service.log


def test_a_stop_finishes_what_runs_and_leaves_the_rest_for_later(
    make_service: MakeService, prepared: Prepared, undisturbed: Answers
) -> None:
    service = make_service(ISODYN_WORKERS="1")
    service.start()
    family = service.family()
    send(service, in_turn(prepared))
    assert [job["state"] for job in service.jobs()].count("queued") > 3, "nothing was left for later"
    service.terminate()
    eventually(lambda: all(gone(process.pid) for process in family))
    assert "service stopped" in service.log
    assert "Traceback" not in service.log
    service.start()
    assert "recovered_jobs=0" in service.log.rsplit("service started", 1)[1]
    check_everything_was_done_once(service, prepared, undisturbed)
    with pytest.raises(AssertionError, match="another service runs in"):
        Service(service.data_dir, service.key, service.environment).start()
    assert service.request("GET", "/readyz").status_code == 200


def test_the_admin_key_is_shown_once_and_never_logged(prepared: Prepared) -> None:
    assert prepared.first_output.count(prepared.key) == 1
    assert "isk_" not in prepared.first_log
