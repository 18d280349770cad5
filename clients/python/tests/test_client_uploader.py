"""Spool and uploader: what was first goes first and each segment once, whatever dies meanwhile."""

from __future__ import annotations

import json
import random
import threading
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest
from conftest import SESSION, make_samples, ok, problem, segment
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from isodyn_client import (
    Aids,
    Client,
    IsodynError,
    NoMapError,
    RetryPolicy,
    Samples,
    SpeedReadings,
    Spool,
    Uploader,
)
from isodyn_client.spool import TRIP_GAP_S

START_MS = 1_764_000_000_000.0


def piece(i: int, *, n: int = 20) -> Samples:
    return make_samples(n, start_ms=START_MS + 5000.0 * i)


class FakeSessions:
    """Sessions as the service keeps them; each request fails as ``chance`` says, before or after it is done."""

    def __init__(self, failure: float = 0.0, seed: int = 0) -> None:
        self.failure, self.rng = failure, random.Random(seed)
        self.sessions: dict[str, list[bytes]] = {}
        self.closed: set[str] = set()
        self.refuse: set[float] = set()
        self.after: list[Exception] = []

    def handle(self, request: httpx.Request) -> httpx.Response:
        body = request.read()
        kind = self.rng.random()
        if kind < self.failure / 2:
            raise httpx.ConnectError("away")
        answer = self._answer(request, body)
        if kind < self.failure:
            raise httpx.ReadError("cut off behind the request")
        if self.after:
            raise self.after.pop()
        return answer

    def _answer(self, request: httpx.Request, body: bytes) -> httpx.Response:
        parts = request.url.path.split("/")[2:]
        if parts == ["sessions"]:
            name = f"ses_{len(self.sessions)}"
            self.sessions[name] = []
            return ok(self._info(name), 201)
        name = parts[1]
        if name not in self.sessions:
            return problem(404, "not-found")
        if parts[2:] == ["close"]:
            self.closed.add(name)
        if parts[2:] == ["segments"]:
            return self._segment(name, body)
        return ok(self._info(name))

    def _segment(self, name: str, body: bytes) -> httpx.Response:
        stored, sent = self.sessions[name], msgpack.unpackb(body)
        seq = sent["seq"]
        t_ms = np.frombuffer(sent["samples"]["t_ms"], "<f8")
        if seq < len(stored):
            same = stored[seq] == body
            return ok(segment(seq)) if same else problem(409, "sequence-conflict")
        if name in self.closed:
            return problem(409, "session-closed")
        if seq > len(stored):
            return problem(409, "sequence-gap")
        if stored and t_ms[0] <= self.times(name)[-1]:
            return problem(422, "invalid", errors=[{"field": "samples.t_ms", "message": "", "remedy": ""}])
        if t_ms[0] in self.refuse:
            return problem(422, "invalid")
        stored.append(body)
        return ok(segment(seq))

    def _info(self, name: str) -> dict[str, Any]:
        status = "closed" if name in self.closed else "open"
        return SESSION | {"id": name, "next_seq": len(self.sessions[name]), "status": status}

    def times(self, name: str) -> list[float]:
        found = [np.frombuffer(msgpack.unpackb(body)["samples"]["t_ms"], "<f8") for body in self.sessions[name]]
        return [float(t) for t in np.concatenate([np.zeros(0), *found])]

    def starts(self, name: str = "ses_0") -> list[float]:
        return [
            float(np.frombuffer(msgpack.unpackb(body)["samples"]["t_ms"], "<f8")[0]) for body in self.sessions[name]
        ]

    def client(self) -> Client:
        retry = RetryPolicy(retries=0)
        return Client("http://s.test", "k", transport=httpx.MockTransport(self.handle), retry=retry)


def uploader(service: FakeSessions, folder: Path, told: list[IsodynError] | None = None) -> Uploader:
    client = service.client()
    told = [] if told is None else told
    return Uploader(client, Spool(folder), lambda: client.create_session("lev_1"), on_trouble=told.append)


def drained(one: Uploader) -> None:
    """Send all there is; failures pass at once."""
    stopped, finished = threading.Event(), threading.Event()
    stopped.wait = lambda timeout=None: False  # type: ignore[method-assign, assignment]
    finished.set()
    one.run(stopped, finished)


def same(a: Samples, b: Samples) -> bool:
    return all(np.array_equal(getattr(a, name).astype("f4"), getattr(b, name)) for name in ("mag", "acc", "gyro"))


def test_a_spool_gives_back_what_was_put_in_order(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    aids = Aids(speed=SpeedReadings(np.array([START_MS]), speed_m_s=np.array([1.5])))
    for i in range(3):
        spool.put(piece(i), aids if i else None)
    again = Spool(tmp_path)
    for i in range(3):
        entry = again.oldest()
        assert entry is not None
        assert same(piece(i), entry.samples)
        np.testing.assert_array_equal(entry.samples.t_ms, piece(i).t_ms)
        assert entry.aids.names == (("speed",) if i else ())
        again.drop(entry.name)
    assert again.oldest() is None
    assert len(again) == again.n_bytes == 0


def test_a_full_spool_gives_up_the_oldest(tmp_path: Path) -> None:
    size = _size_of_one(tmp_path / "one")
    spool = Spool(tmp_path / "many", max_bytes=int(3.5 * size))
    for i in range(10):
        spool.put(piece(i))
    assert (len(spool), spool.n_lost) == (3, 7)
    entry = spool.oldest()
    assert entry is not None
    assert entry.samples.t_ms[0] == piece(7).t_ms[0]
    tiny = Spool(tmp_path / "tiny", max_bytes=1)
    tiny.put(piece(0))
    assert len(tiny) == 1  # the newest is always kept


def _size_of_one(folder: Path) -> int:
    spool = Spool(folder)
    spool.put(piece(0))
    return spool.n_bytes


def test_half_a_file_and_a_damaged_one_do_no_harm(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    for i in range(2):
        spool.put(piece(i))
    (tmp_path / "x.segment.part").write_bytes(b"half")
    first = spool.oldest()
    assert first is not None
    (tmp_path / first.name).write_bytes(b"\x83 damaged")
    again = Spool(tmp_path)
    entry = again.oldest()
    assert entry is not None
    assert entry.samples.t_ms[0] == piece(1).t_ms[0]
    assert [file.name for file in (tmp_path / "refused").iterdir()] == [first.name]
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(("gap_s", "trips"), [(10.0, 1), (TRIP_GAP_S + 10, 2), (-100.0, 2)])
def test_another_trip_begins_after_an_hour_or_when_time_runs_back(tmp_path: Path, gap_s: float, trips: int) -> None:
    spool = Spool(tmp_path)
    spool.put(piece(0))
    later = START_MS + 400.0 + gap_s * 1000.0
    Spool(tmp_path).put(make_samples(20, start_ms=later))
    service = FakeSessions()
    drained(uploader(service, tmp_path))
    assert len(service.sessions) == trips
    assert service.closed == set(service.sessions)
    assert [start for name in service.sessions for start in service.starts(name)] == [START_MS, later]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10_000), st.floats(0.0, 0.8))
def test_a_network_that_fails_anywhere_loses_and_repeats_nothing(
    tmp_path_factory: pytest.TempPathFactory, seed: int, failure: float
) -> None:
    folder = tmp_path_factory.mktemp("spool")
    service = FakeSessions(failure, seed)
    spool = Spool(folder)
    for i in range(8):
        spool.put(piece(i))
    one = uploader(service, folder)
    drained(one)
    # an open whose answer was lost leaves a session without segments
    (used,) = [name for name in service.sessions if service.sessions[name]]
    assert service.starts(used) == [piece(i).t_ms[0] for i in range(8)]
    assert (one.n_sent, one.n_refused, len(one.spool)) == (8, 0, 0)
    assert used in service.closed


def test_a_killed_process_sends_the_same_segment_under_the_same_number(tmp_path: Path) -> None:
    service = FakeSessions()
    spool = Spool(tmp_path)
    for i in range(3):
        spool.put(piece(i))
    first = uploader(service, tmp_path)
    assert first.step()
    service.after.append(KeyboardInterrupt())  # type: ignore[arg-type]  # dies when the service has the segment
    with pytest.raises(KeyboardInterrupt):
        first.step()
    assert len(service.sessions["ses_0"]) == 2
    second = uploader(service, tmp_path)
    drained(second)
    assert service.starts() == [piece(i).t_ms[0] for i in range(3)]
    assert (second.n_sent, second.n_refused) == (2, 0)
    assert list(service.sessions) == ["ses_0"]


def test_a_refused_segment_is_put_aside_and_its_number_is_used_by_the_next(tmp_path: Path) -> None:
    service = FakeSessions()
    service.refuse = {float(piece(1).t_ms[0])}
    spool = Spool(tmp_path)
    for i in range(3):
        spool.put(piece(i))
    told: list[IsodynError] = []
    one = uploader(service, tmp_path, told)
    drained(one)
    assert service.starts() == [piece(0).t_ms[0], piece(2).t_ms[0]]
    assert (one.n_sent, one.n_refused, len(told)) == (2, 1, 1)
    assert len(list((tmp_path / "refused").iterdir())) == 1


@pytest.mark.parametrize("what", ["closed", "deleted", "used by another"])
def test_a_session_that_is_not_as_it_was_left(tmp_path: Path, what: str) -> None:
    service = FakeSessions()
    one = uploader(service, tmp_path)
    one.spool.put(piece(0))
    assert one.step()
    if what == "closed":
        service.closed.add("ses_0")
    elif what == "deleted":
        service.sessions["ses_9"] = service.sessions.pop("ses_0")
    else:
        service.sessions["ses_0"].append(msgpack.packb({"samples": {"t_ms": piece(1).t_ms.tobytes()}}))
    one.spool.put(piece(2))
    assert one.step()
    name = one.session_id or ""
    assert service.starts(name)[-1] == piece(2).t_ms[0]
    assert (name == "ses_0") == (what == "used by another")


def test_what_waiting_does_not_mend_ends_it_and_keeps_the_segments(tmp_path: Path) -> None:
    client = Client("http://s.test", "k", transport=httpx.MockTransport(lambda _: problem(409, "no-map")))
    spool = Spool(tmp_path)
    spool.put(piece(0))
    one = Uploader(client, spool, lambda: client.create_session("lev_1"))
    with pytest.raises(NoMapError):
        drained(one)
    assert len(Spool(tmp_path)) == 1


def test_results_and_trouble_are_told(tmp_path: Path) -> None:
    service = FakeSessions()
    service.after.append(httpx.ReadError("cut"))
    told: list[IsodynError] = []
    results: list[int] = []
    one = uploader(service, tmp_path, told)
    one.on_result = lambda result: results.append(result.seq)
    one.spool.put(piece(0))
    one.spool.put(piece(1))
    drained(one)
    assert results == [0, 1]
    assert len(told) == 1
    state = json.loads((tmp_path / "sender.json").read_text())
    assert state["session_id"] is None


def test_it_stops_when_told(tmp_path: Path) -> None:
    one = uploader(FakeSessions(), tmp_path)
    one.spool.put(piece(0))
    stopped = threading.Event()
    stopped.set()
    one.run(stopped, threading.Event())
    assert one.n_sent == 0
