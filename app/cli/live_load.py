"""Phones that push and watchers that wait for their positions: how long a message takes to become a fix on a screen."""

from __future__ import annotations

import asyncio
import json
import os
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import cycle, islice

import httpx
import numpy as np
import psutil
from isodyn_client import AsyncClient, IsodynError, Prior
from isodyn_client.sse import Event, async_events

from app.engine.types import Float64Array, ImuSamples
from app.evaluation.datasets.walks import RecordedWalk

MESSAGE_S = 1.0
QUIET_S = 5.0
"""After the last message watchers wait so long for what is still under way."""
_OPEN_S = 1.0
_NS = 1_000_000_000
_LATE_S = 0.1
Stage = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Trip:
    """A recorded walk under a push address of its own, whose sessions begin where the walk does."""

    samples: ImuSamples
    url: str
    token_id: str


@dataclass(slots=True)
class Load:
    """What was seen; times in seconds."""

    answers: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    late: int = 0
    """Messages that the generator itself sent more than 0.1 s after their time."""
    errors: Counter[str] = field(default_factory=Counter)
    fixes: int = 0


@dataclass(frozen=True, slots=True)
class LiveReport:
    """A run of ``isodyn bench live``; milliseconds. ``cpu`` is in cores, None of a service that was there before."""

    phones: int
    seconds: float
    messages: int
    measured: int
    fixes: int
    errors: dict[str, int]
    late: int
    latency_ms: dict[str, float]
    answer_ms: dict[str, float]
    cpu: float | None
    client_cpu: float
    load_before: float
    load_after: float

    def as_dict(self) -> dict[str, object]:
        """For a JSON file."""
        return {name: getattr(self, name) for name in self.__slots__}


def messages(samples: ImuSamples, t0_ns: int, session_id: str) -> Iterator[bytes]:
    """Push messages of Sensor Logger, one a second.

    Times are moved, so that the first sample is at ``t0_ns``.
    """
    t = samples.t - samples.t[0]
    times = t0_ns + np.round(t * 1e6).astype(np.int64) * 1000
    number = (t / MESSAGE_S).astype(np.int64)
    for k in range(int(number[-1]) + 1):
        rows = np.flatnonzero(number == k)
        acc = samples.acc[rows]
        gravity = np.broadcast_to(acc.mean(axis=0), acc.shape)
        told = {
            "magnetometer": samples.mag[rows],
            "accelerometer": acc - gravity,
            "gravity": gravity,
            "gyroscope": samples.gyro[rows],
        }
        payload = [
            {"name": name, "time": t_ns, "values": dict(zip("xyz", row, strict=True)), "accuracy": 3}
            for name, values in told.items()
            for t_ns, row in zip(times[rows].tolist(), values.tolist(), strict=True)
        ]
        head = {"messageId": k, "sessionId": session_id, "deviceId": "bench", "payload": payload}
        yield json.dumps(head).encode()


@dataclass
class Phone:
    """One phone: walks one after the other, each second a message, and one watcher of each session."""

    number: int
    trips: Sequence[Trip]
    client: AsyncClient
    http: httpx.AsyncClient
    load: Load
    until: float
    """On the clock of ``time.time``; no message is sent after it."""
    _sent: dict[int, float] = field(default_factory=dict)
    """When message ``k`` was sent. Its sensors are read at the same times, so it is complete, and segment ``k``."""

    async def run(self, first: float) -> None:
        """Push from ``first`` (Unix s) on."""
        start = first
        for trip in cycle(self.trips):
            if start >= self.until:
                return
            start = await self._walk(trip, start)

    async def _walk(self, trip: Trip, start: float) -> float:
        """Push one walk; returns when the next one may begin."""
        name = f"{self.number} {start:.3f}"
        watcher: asyncio.Task[None] | None = None
        due = start
        for k, body in enumerate(messages(trip.samples, round(start * _NS), name)):
            due = start + (k + 1) * MESSAGE_S
            if due > self.until:
                break
            await self._wait_until(due)
            if watcher is not None:
                self._sent[k] = time.perf_counter()
            taken = await self._push(trip, body)
            if taken and watcher is None:
                watcher = asyncio.create_task(self._watch(trip, name))
        if watcher is not None:
            await self._end(watcher)
        return due + MESSAGE_S

    async def _wait_until(self, due: float) -> None:
        await asyncio.sleep(max(0.0, due - time.time()))
        self.load.late += time.time() - due > _LATE_S

    async def _push(self, trip: Trip, body: bytes) -> bool:
        began = time.perf_counter()
        try:
            answer = await self.http.post(trip.url, content=body, headers={"Content-Type": "application/json"})
        except httpx.TransportError as error:
            self.load.errors[type(error).__name__] += 1
            return False
        self.load.answers.append(time.perf_counter() - began)
        if not answer.is_success:
            self.load.errors[str(answer.status_code)] += 1
        return answer.is_success

    async def _watch(self, trip: Trip, name: str) -> None:
        try:
            session_id = await self._session_of(trip, name)
            async for event in async_events(self.client, f"/v1/sessions/{session_id}/events", params={"after": -1}):
                if isinstance(event, Event) and event.name == "fixes":
                    self._told(json.loads(event.data)["seq"])
        except IsodynError as error:
            self.load.errors[type(error).__name__] += 1

    async def _session_of(self, trip: Trip, name: str) -> str:
        async for one in self.client.recordings(token_id=trip.token_id):
            if one.app_session.endswith(name) and one.session_id is not None:
                return one.session_id
        raise IsodynError(f"no recording {name}")

    def _told(self, seqs: Sequence[int]) -> None:
        now = time.perf_counter()
        self.load.fixes += len(seqs)
        for seq in sorted(set(seqs)):
            if (sent := self._sent.pop(seq, None)) is not None:
                self.load.latencies.append(now - sent)

    async def _end(self, watcher: asyncio.Task[None]) -> None:
        deadline = time.monotonic() + QUIET_S
        while self._sent and not watcher.done() and time.monotonic() < deadline:
            await asyncio.sleep(0.05)
        self.load.errors["no fix"] += len(self._sent)
        self._sent.clear()
        watcher.cancel()
        await asyncio.gather(watcher, return_exceptions=True)


async def run_phones(
    url: str, key: str | None, level_id: str, walks: Sequence[RecordedWalk], phones: int, seconds: float, say: Stage
) -> Load:
    """Let phones push for so many seconds, each in a second part of its own, and watch all of their sessions."""
    load = Load()
    rng = random.Random(1)
    unlimited = httpx.Limits(max_connections=None, max_keepalive_connections=None)
    async with (
        AsyncClient(url, key, transport=httpx.AsyncHTTPTransport(limits=unlimited)) as client,
        httpx.AsyncClient(limits=unlimited, timeout=30.0, trust_env=False) as http,
    ):
        trips = [await _trips(client, level_id, walks, k, seconds, say, phones) for k in range(phones)]
        begin = time.time() + _OPEN_S
        until = begin + seconds
        made = [Phone(k, trips[k], client, http, load, until) for k in range(phones)]
        pushing = [asyncio.create_task(one.run(begin + rng.random() * MESSAGE_S)) for one in made]
        watching = asyncio.create_task(_show(begin, seconds, load, say))
        await asyncio.gather(*pushing)
        watching.cancel()
    return load


async def _trips(
    client: AsyncClient, level_id: str, walks: Sequence[RecordedWalk], k: int, seconds: float, say: Stage, phones: int
) -> list[Trip]:
    """Walks of phone ``k`` for so many seconds, each with a token that knows where it begins."""
    device = await client.create_device(f"bench {k}")
    trips: list[Trip] = []
    left = seconds
    for walk in islice(cycle(walks), k, None):
        prior = Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]))
        made = await client.create_ingest_token(f"bench {k}", device.id, level_id=level_id, prior=prior)
        trips.append(Trip(walk.samples, made.url, made.id))
        left -= float(walk.samples.t[-1] - walk.samples.t[0])
        if left <= 0:
            break
    say(k / phones, f"phone {k + 1} of {phones}")
    return trips


async def _show(begin: float, seconds: float, load: Load, say: Stage) -> None:
    while True:
        await asyncio.sleep(1.0)
        recent = load.latencies[-200:]
        text = f"{1000 * float(np.median(recent)):.0f} ms" if recent else ""
        say(min(1.0, max(0.0, (time.time() - begin) / seconds)), text)


def measure(
    url: str,
    key: str | None,
    level_id: str,
    walks: Sequence[RecordedWalk],
    *,
    phones: int,
    seconds: float,
    pid: int | None,
    say: Stage,
) -> LiveReport:
    """Run the load, and sum up what was seen; ``pid`` is of the service, if it is ours."""
    processes = _family(pid) if pid is not None else []
    load_before = os.getloadavg()[0]
    before, own, began = _cpu_s(processes), time.process_time(), time.monotonic()
    load = asyncio.run(run_phones(url, key, level_id, walks, phones, seconds, say))
    took = time.monotonic() - began
    return LiveReport(
        phones=phones,
        seconds=seconds,
        messages=len(load.answers),
        measured=len(load.latencies),
        fixes=load.fixes,
        errors={name: n for name, n in load.errors.items() if n},
        late=load.late,
        latency_ms=_percentiles(load.latencies),
        answer_ms=_percentiles(load.answers),
        cpu=None if pid is None else (_cpu_s(processes) - before) / took,
        client_cpu=(time.process_time() - own) / took,
        load_before=load_before,
        load_after=os.getloadavg()[0],
    )


def _percentiles(seconds: Sequence[float]) -> dict[str, float]:
    if not seconds:
        return {}
    ms: Float64Array = 1000.0 * np.asarray(seconds, dtype=np.float64)
    return {f"p{q}": round(float(np.percentile(ms, q)), 1) for q in (50, 95, 99)}


def _family(pid: int) -> list[psutil.Process]:
    parent = psutil.Process(pid)
    return [parent, *parent.children(recursive=True)]


def _cpu_s(processes: Sequence[psutil.Process]) -> float:
    """Processor time of these processes so far."""
    total = 0.0
    for process in processes:
        if process.is_running():
            times = process.cpu_times()
            total += times.user + times.system
    return total
