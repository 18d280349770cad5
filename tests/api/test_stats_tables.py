from __future__ import annotations

import csv
import io
from datetime import timedelta
from typing import Any

import pytest

from app.services.ids import new_id
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body
from tests.support.builders import START

TABLES = ("throughput", "latency", "backlog", "errors", "fixes", "accuracy", "storage", "levels", "alarms")


@pytest.fixture(autouse=True)
def ids_of_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ids never go backwards, the clocks of tests do: those of other tests may have run far ahead."""
    monkeypatch.setattr(new_id, "_last", 0)


@pytest.fixture
def used(api: Api) -> Api:
    """A service with one processed and one failed segment."""
    session_id = api.session_id()
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    api.worker.error = "no such cell (12, 7)"
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(1)))
    return api


def lines(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.parametrize("name", TABLES)
def test_every_table_is_json_and_csv_with_the_same_columns(used: Api, name: str) -> None:
    shown = used.ok("GET", f"/v1/stats/{name}")["items"]
    for asked in ({"params": {"format": "csv"}}, {"headers": {"Accept": "text/csv"}}):
        response = used.get(f"/v1/stats/{name}", **asked)
        assert response.headers["content-type"].startswith("text/csv")
        assert f'filename="{name}.csv"' in response.headers["content-disposition"]
        rows = lines(response.text)
        assert len(rows) == len(shown)
        for row, item in zip(rows, shown, strict=True):
            assert list(row) == list(item)
    assert used.get(f"/v1/stats/{name}", params={"format": "json"}, headers={"Accept": "text/csv"}).json()


def test_csv_says_what_json_says(used: Api) -> None:
    (item,) = used.ok("GET", "/v1/stats/errors")["items"]
    (row,) = lines(used.get("/v1/stats/errors?format=csv").text)
    assert {name: "" if value is None else str(value) for name, value in item.items()} == row


def test_throughput_counts_segments_samples_and_fixes(used: Api) -> None:
    table = used.ok("GET", "/v1/stats/throughput", params={"bucket": "minute"})
    assert (table["bucket"], table["complete_since"]) == ("minute", None)
    assert len(table["items"]) == 61  # a whole hour, empty minutes too, and the minute that is begun
    busy = [row for row in table["items"] if row["segments"]]
    assert [(row["segments"], row["segments_failed"], row["fixes"]) for row in busy] == [(2, 1, 3)]
    assert busy[0]["samples"] == 2 * len(segment_body()["samples"]["t_ms"])
    assert busy[0]["since"] == "2026-11-22T08:00:00.000Z"


def test_errors_have_their_newest_example(used: Api) -> None:
    (row,) = used.ok("GET", "/v1/stats/errors")["items"]
    assert (row["kind"], row["n"], row["share"]) == ("locate_segment", 1, 0.5)
    assert row["text"] == "no such cell (…, …)"
    assert row["example_error"] == "no such cell (12, 7)"
    assert row["example_seq"] == 1
    assert used.ok("GET", f"/v1/jobs/{row['example_job_id']}")["state"] == "failed"


def test_latency_has_all_kinds_that_ran(used: Api) -> None:
    rows = {row["kind"]: row for row in used.ok("GET", "/v1/stats/latency")["items"]}
    assert {kind: row["n"] for kind, row in rows.items()} == {"locate_segment": 2, "build_map": 1}
    one = rows["locate_segment"]
    assert one["total_p50_ms"] == pytest.approx(one["wait_p50_ms"] + one["processing_p50_ms"], abs=2)
    assert 0 < one["wait_p50_ms"] <= one["wait_p99_ms"]


def test_fixes_are_told_apart_on_request(used: Api) -> None:
    (whole,) = used.ok("GET", "/v1/stats/fixes")["items"]
    assert (whole["n"], whole["ok"], whole["sure_share"], whole["level_id"]) == (3, 3, 1.0, None)
    (row,) = used.ok("GET", "/v1/stats/fixes", params={"by": ["level", "method"]})["items"]
    assert row["level_id"].startswith("lvl_")
    assert (row["method"], row["device_id"]) == ("particle", None)
    assert used.ok("GET", "/v1/stats/fixes", params={"level_id": "lvl_0"})["items"] == []
    assert used.ok("GET", "/v1/stats/fixes", params={"level_id": row["level_id"]})["items"][0]["n"] == 3


@pytest.mark.parametrize("name", ["throughput", "latency", "errors", "fixes", "accuracy"])
def test_filters_leave_nothing_of_others(used: Api, name: str) -> None:
    for filter_ in ("venue_id", "level_id", "device_id", "method"):
        rows = used.ok("GET", f"/v1/stats/{name}", params={filter_: "other"})["items"]
        assert not any(row.get("segments", row.get("n")) for row in rows), filter_


def test_a_window_that_lies_elsewhere_is_empty(used: Api) -> None:
    span = {"since": "2020-01-01T00:00:00Z", "until": "2020-01-02T00:00:00+01:00"}
    assert used.ok("GET", "/v1/stats/latency", params=span)["items"] == []
    table = used.ok("GET", "/v1/stats/throughput", params={**span, "bucket": "hour"})
    assert [row["segments"] for row in table["items"]] == [0] * 23
    assert table["until"] == "2020-01-01T23:00:00.000Z"


def test_storage_and_levels(used: Api) -> None:
    parts = {row["part"]: row for row in used.ok("GET", "/v1/stats/storage")["items"]}
    assert parts["segments"]["rows"] == 2
    assert parts["segments"]["bytes"] > 1000
    assert parts["map_tiles"]["bytes"] > 1000
    (level,) = used.ok("GET", "/v1/stats/levels")["items"]
    assert (level["sessions"], level["walks"], level["map_version"], level["map_behind"]) == (1, 1, 1, False)
    assert level["map_age_days"] >= 0
    before = {"since": (START - timedelta(days=2)).isoformat(), "until": (START - timedelta(days=1)).isoformat()}
    assert used.ok("GET", "/v1/stats/levels", params=before)["items"][0]["sessions"] == 0


def test_levels_come_in_pages(api: Api) -> None:
    ids = [api.level().id for _ in range(3)]
    first = api.get("/v1/stats/levels", params={"limit": 2})
    assert [row["level_id"] for row in first.json()["items"]] == ids[:0:-1]
    assert 'rel="next"' in first.headers["Link"]
    rest = api.ok("GET", "/v1/stats/levels", params={"limit": 2, "cursor": first.json()["next_cursor"]})
    assert [row["level_id"] for row in rest["items"]] == ids[:1]
    assert rest["next_cursor"] is None


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ({"since": "yesterday"}, "since"),
        ({"since": "2026-11-22T09:00:00"}, "since"),
        ({"since": "2026-11-23T00:00:00Z", "until": "2026-11-22T00:00:00Z"}, "since"),
        ({"bucket": "fortnight"}, "bucket"),
        ({"bucket": "minute", "since": "2026-01-01T00:00:00Z"}, "bucket"),
        ({"venue_id": "Not An Id"}, "venue_id"),
        ({"format": "xml"}, "format"),
    ],
)
def test_wrong_questions_name_field_and_remedy(api: Api, query: dict[str, Any], field: str) -> None:
    response = api.get("/v1/stats/throughput", params=query)
    assert response.status_code == 422, response.text
    (error,) = response.json()["errors"]
    assert error["field"] == field
    assert error["remedy"]


def test_alarms_name_rule_subject_and_remedy(used: Api) -> None:
    assert used.ok("GET", "/v1/stats/alarms")["items"] == []
    used.worker.idle = True
    (session,) = used.ok("GET", "/v1/sessions")["items"]
    session_id = session["id"]
    used.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body(2)))
    used.clock.now += timedelta(minutes=2)
    (alarm,) = used.ok("GET", "/v1/stats/alarms")["items"]
    assert (alarm["rule"], alarm["severity"], alarm["subject"]) == ("queue-old", "warning", "locate_segment")
    assert alarm["remedy"]
    assert alarm["since"].startswith("2026-11-22T08:00:00")


def test_text_is_no_formula(api: Api) -> None:
    session_id = api.session_id()
    api.worker.error = "=HYPERLINK(1)"
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    (row,) = lines(api.get("/v1/stats/errors?format=csv").text)
    assert row["example_error"] == "'=HYPERLINK(1)"


def test_other_keys_see_nothing(used: Api) -> None:
    for name in TABLES:
        assert used.get(f"/v1/stats/{name}", key=Scope.SURVEY).status_code == 403
