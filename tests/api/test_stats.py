from __future__ import annotations

from tests.api.harness import Api, plain, segment_body


def test_counts(api: Api) -> None:
    session_id = api.session_id()
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    stats = api.ok("GET", "/v1/stats")
    jobs = stats.pop("jobs_by_state")
    assert stats == {
        "venues": 1,
        "levels": 1,
        "surveys": 1,
        "walks": 1,
        "maps": 1,
        "sessions_open": 1,
        "sessions": 1,
        "segments": 1,
        "fixes": 3,
    }
    assert jobs["done"] == 2
