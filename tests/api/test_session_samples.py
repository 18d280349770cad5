"""Raw samples of a session, and the field along its track."""

from __future__ import annotations

import csv
import io

import msgpack
import numpy as np
import pytest

from app.api.session_files import COLUMNS
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body


def sent(api: Api, n: int = 3) -> str:
    path = f"/v1/sessions/{api.session_id()}"
    for seq in range(n):
        api.ok("POST", f"{path}/segments", json=plain(segment_body(seq)))
    return path


def test_samples_come_back_as_they_were_sent(api: Api) -> None:
    path = sent(api)
    response = api.get(f"{path}/samples", key=Scope.LOCATE)
    assert response.headers["Content-Type"].startswith("text/csv")
    assert response.headers["Content-Disposition"].endswith('-samples.csv"')
    rows = list(csv.DictReader(io.StringIO(response.text)))
    assert tuple(rows[0]) == COLUMNS
    given = [plain(segment_body(seq))["samples"] for seq in range(3)]
    assert [float(row["t_ms"]) for row in rows] == pytest.approx(
        np.concatenate([one["t_ms"] for one in given]), abs=1e-3
    )
    told = [float(row["mag_x"]) for row in rows]
    assert told == pytest.approx(np.concatenate([one["mag"]["x"] for one in given]), rel=1e-6)
    assert {row["seq"] for row in rows} == {"0", "1", "2"}


def test_msgpack_can_be_sent_again(api: Api) -> None:
    path = sent(api)
    unpacker = msgpack.Unpacker(io.BytesIO(api.get(f"{path}/samples?format=msgpack").content))
    other = f"/v1/sessions/{api.session_id()}/segments"
    seqs = []
    for segment in unpacker:
        answer = api.post(other, content=msgpack.packb(segment), headers={"Content-Type": "application/msgpack"})
        assert answer.is_success, answer.text
        seqs.append(segment["seq"])
    assert seqs == [0, 1, 2]
    again = api.get(f"{other.removesuffix('/segments')}/samples").content
    assert again == api.get(f"{path}/samples").content


@pytest.mark.parametrize(
    ("query", "seqs"), [("after=0", {"1", "2"}), ("last=1", {"0", "1"}), ("after=0&last=1", {"1"}), ("after=7", set())]
)
def test_a_part_may_be_asked_for(api: Api, query: str, seqs: set[str]) -> None:
    path = sent(api)
    rows = csv.DictReader(io.StringIO(api.get(f"{path}/samples?{query}").text))
    assert {row["seq"] for row in rows} == seqs


def test_a_session_that_sent_nothing_has_a_header_only(api: Api) -> None:
    path = sent(api, 0)
    assert api.get(f"{path}/samples").text == ",".join(COLUMNS) + "\r\n"
    assert api.ok("GET", f"{path}/profile")["number"] == []


def test_no_such_session(api: Api) -> None:
    for call in ("samples", "profile"):
        assert api.get(f"/v1/sessions/ses_{26 * '0'}/{call}").status_code == 404


def test_the_profile_stands_beside_the_positions(api: Api) -> None:
    path = sent(api)
    profile = api.ok("GET", f"{path}/profile")
    positions = api.ok("GET", f"{path}/positions")
    assert profile["number"] == positions["number"]
    assert profile["t_ms"] == positions["fixes"]["t_ms"]
    for part in ("measured", "mapped", "sd"):
        assert {name: len(column) for name, column in profile[part].items()} == dict.fromkeys(
            ("total", "h", "v"), len(profile["number"])
        )
    given = plain(segment_body(0))["samples"]["mag"]
    total = np.sqrt(sum(np.mean(given[axis]) ** 2 for axis in "xyz"))
    assert profile["calibration"] is None
    assert profile["measured"]["total"][0] == pytest.approx(total, rel=0.2)
