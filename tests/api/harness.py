"""The real application over a real SQLite file, with fake numerics, in one process."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
from fastapi import FastAPI

from app.api import create_api
from app.api.checks import Checks
from app.engine.types import Float64Array, ImuSamples
from app.services.aids import Aids
from app.services.container import Services, build_services
from app.services.records import Anchor, Job, JobKind, JobState, Level, Scope, VenueKind
from app.services.tasks import BuildResult
from app.storage import FileMapCache
from app.workers.broker import JobBroker
from app.workers.events import JobEvents
from app.workers.live import SessionHub
from tests.support.builders import (
    CallingExecutor,
    SteppingClock,
    answer_locate,
    answer_replay,
    answer_smooth,
    database_at,
    map_build,
    new_walk,
    samples,
)

JSON_TYPE = "application/json"
MSGPACK_TYPE = "application/msgpack"
ANCHOR = Anchor(48.1507, 11.5691, 12.5, 515.0)


@dataclass(frozen=True)
class Options:
    """Settings of the HTTP side, generous unless a test says otherwise."""

    max_body_bytes: int = 8 * 2**20
    max_wait_s: float = 30.0
    max_streams: int = 1000
    rate_limit_per_minute: int = 0
    rate_limit_burst: int = 200
    cors_origins: tuple[str, ...] = ()


@dataclass
class Seen:
    """Metrics that remember."""

    requests: list[tuple[str, str, int]] = field(default_factory=list)

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        assert seconds >= 0
        self.requests.append((method, route, status))

    def render(self) -> bytes:
        return b"# HELP up Whether it is up.\nup 1\n"


class Worker:
    """A runner without threads: does a job in the thread that queued it, or keeps it until told."""

    def __init__(self) -> None:
        self.services: Services | None = None
        self.events: JobEvents | None = None
        self.idle = False
        self.error: str | None = None

    def job_queued(self, job: Job) -> None:
        if not self.idle:
            self.work()

    def job_finished(self, job: Job) -> None:
        pass

    def work(self) -> int:
        """Do all queued jobs; returns how many."""
        assert self.services is not None
        assert self.events is not None
        done = 0
        while jobs := self.services.processing.claim(10):
            for job in jobs:
                self.events.job_finished(self._do(job))
                done += 1
        return done

    def _do(self, job: Job) -> Job:
        assert self.services is not None
        processing = self.services.processing
        if self.error is not None:
            return processing.fail(job, self.error)
        if job.kind is JobKind.BUILD_MAP:
            spec = processing.build_spec(job)
            ids = [new.walk.walk_id for new in spec.walks]
            build = map_build(spec.level_id, walk_ids=ids, features=spec.settings.features)
            build = replace(build, field_sd=(8.0,) * len(spec.settings.features.channels))
            return processing.complete_build(job, BuildResult(build, cpu_s=0.1), 0.2)
        done = processing.complete_locate(job, answer_locate(processing.locate_spec(job), lambda *_: None))
        assert done is not None
        return done


class Api:
    """An application with its parts, and short ways to call it."""

    def __init__(self, folder: Path, options: Options = Options(), *, max_queued: int = 1000) -> None:
        self.database = database_at(folder / "isodyn.db")
        self.clock = SteppingClock()
        self.events, self.broker, self.worker = JobEvents(), JobBroker(), Worker()
        self.hub = SessionHub()
        self.services = build_services(
            uow=self.database,
            clock=self.clock,
            executor=CallingExecutor(),
            cache=FileMapCache(folder / "maps"),
            listener=self.events,
            watchers=self.hub,
            checks=Checks(),
            locate_task=answer_locate,
            smooth_task=answer_smooth,
            replay_task=answer_replay,
            max_queued=max_queued,
        )
        self.worker.services, self.worker.events = self.services, self.events
        self.events.add(self.broker)
        self.events.add(self.hub)
        self.events.add(self.worker)
        self.parts: dict[str, bool] = {"database": True, "pool": True}
        self.metrics = Seen()
        self.app: FastAPI = create_api(
            services=self.services,
            broker=self.broker,
            hub=self.hub,
            settings=options,
            metrics=self.metrics,
            ready=self.ready,
            clock=self.clock,
        )
        self.secrets = {scope: self.services.accounts.create_key(scope.value, {scope})[1] for scope in Scope}

    def ready(self) -> Mapping[str, bool]:
        return self.parts

    def close(self) -> None:
        self.database.close()

    def call(self, method: str, path: str, *, key: Scope | str | None = Scope.ADMIN, **kwargs: Any) -> httpx.Response:
        """Call as a key of this scope (or with this secret); None: without a key."""
        return asyncio.run(self.acall(method, path, key=key, **kwargs))

    async def acall(
        self, method: str, path: str, *, key: Scope | str | None = Scope.ADMIN, **kwargs: Any
    ) -> httpx.Response:
        headers = dict(kwargs.pop("headers", None) or {})
        if key is not None:
            headers["Authorization"] = f"Bearer {self.secrets[key] if isinstance(key, Scope) else key}"
        transport = httpx.ASGITransport(app=self.app)
        async with httpx.AsyncClient(transport=transport, base_url="http://isodyn.test") as client:
            return await client.request(method, path, headers=headers, **kwargs)

    def get(self, path: str, **kwargs: Any) -> httpx.Response:
        return self.call("GET", path, **kwargs)

    def post(self, path: str, **kwargs: Any) -> httpx.Response:
        return self.call("POST", path, **kwargs)

    def level(self) -> Level:
        """A level of a new venue, without a map."""
        venue = self.services.venues.create("House", VenueKind.INDOOR, None)
        return self.services.venues.create_level(venue.id, "1", 0, (-3.5, 2.25, 61.0, 36.75))

    def surveyed_level(self) -> Level:
        """A level with a survey of one walk."""
        level = self.level()
        survey = self.services.surveys.create(level.id, "survey")
        self.services.surveys.add_walk(survey.id, new_walk())
        return level

    def anchored_level(self, anchor: Anchor | None = ANCHOR) -> Level:
        """A level with a current map, of a venue with this anchor."""
        level = self.mapped_level()
        venue = self.services.venues.get(level.venue_id)
        self.services.venues.update(venue.id, venue.name, anchor)
        return level

    def mapped_level(self, **settings: object) -> Level:
        """A level with a current map (vector features)."""
        level = self.surveyed_level()
        self.ok("POST", "/v1/maps", json={"level_id": level.id, **settings}, headers={"Prefer": "wait=5"})
        return self.services.venues.get_level(level.id)

    def mapped_venue(self, n_levels: int = 2) -> tuple[str, list[Level]]:
        """A venue with an anchor and so many mapped levels, lowest first."""
        anchor = Anchor(48.15, 11.57)
        venue_id = self.services.venues.create("Tower", VenueKind.INDOOR, anchor).id
        ids = []
        for ordinal in range(n_levels):
            level = self.services.venues.create_level(venue_id, str(ordinal), ordinal, (-3.5, 2.25, 61.0, 36.75))
            survey = self.services.surveys.create(level.id, "survey")
            self.services.surveys.add_walk(survey.id, new_walk())
            self.ok("POST", "/v1/maps", json={"level_id": level.id}, headers={"Prefer": "wait=5"})
            ids.append(level.id)
        return venue_id, [self.services.venues.get_level(level_id) for level_id in ids]

    def session_id(self) -> str:
        """A session on a mapped level."""
        return str(self.ok("POST", "/v1/sessions", json={"level_id": self.mapped_level().id})["id"])

    def ok(self, method: str, path: str, **kwargs: Any) -> Any:
        """Call, demand success, return the body."""
        response = self.call(method, path, **kwargs)
        assert response.is_success, response.text
        return response.json() if response.content else None

    def stored(self) -> dict[str, int]:
        """Counts of everything stored, to show that nothing changed."""
        stats = self.services.stats.stats()
        counts = {name: getattr(stats, name) for name in ("venues", "levels", "surveys", "walks", "maps", "sessions")}
        jobs = sum(stats.jobs_by_state.get(state, 0) for state in JobState)
        return {**counts, "segments": stats.segments, "fixes": stats.fixes, "jobs": jobs}


def columns(chunk: ImuSamples) -> dict[str, Any]:
    """Samples as numpy columns, as an upload names them."""
    vectors = {
        name: {axis: np.asarray(getattr(chunk, name))[:, i] for i, axis in enumerate("xyz")}
        for name in ("mag", "acc", "gyro")
    }
    return {"t_ms": chunk.t * 1000.0, **vectors}


def plain(value: Any) -> Any:
    """Columns as lists, for JSON."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return {name: plain(item) for name, item in value.items()} if isinstance(value, dict) else value


def packed(value: Any) -> Any:
    """Columns as little-endian binaries, for msgpack: float64 for times and waypoints, float32 for sensors."""
    return {name: _packed_samples(item) if isinstance(item, dict) else item for name, item in value.items()}


def _packed_samples(value: dict[str, Any]) -> dict[str, Any]:
    def column(name: str, item: Any, *, wide: bool) -> Any:
        if isinstance(item, dict):
            return {axis: column(axis, part, wide=False) for axis, part in item.items()}
        return _binary(item, "<f8" if wide else "<f4") if isinstance(item, np.ndarray) else item

    wide = {"t_ms", "latitude_deg", "longitude_deg", "count", "x", "y"}
    return {name: column(name, item, wide=name in wide) for name, item in value.items()}


def aid_columns(aids: Aids) -> dict[str, Any]:
    """Aids as numpy columns, as an upload names them."""
    names = {
        "wifi": {"bssid": "address", "rssi": "rssi"},
        "ble": {"address": "address", "rssi": "rssi"},
        "gnss": {name: name for name in ("latitude_deg", "longitude_deg", "accuracy_m")},
        "pressure": {"hpa": "hpa"},
        "speed": {"speed_m_s": "speed"},
        "steps": {"count": "count"},
    }
    given = {name: getattr(aids, name) for name in names if getattr(aids, name) is not None}
    return {
        name: {
            "t_ms": aid.t * 1000.0,
            **{column: _listed(getattr(aid, field)) for column, field in names[name].items()},
        }
        for name, aid in given.items()
    }


def _listed(column: Any) -> Any:
    return list(column) if isinstance(column, tuple) else column


def _binary(column: Float64Array, kind: str) -> bytes:
    return column.astype(kind).tobytes()


def segment_body(seq: int = 0, *, n: int = 250, **changes: Any) -> dict[str, Any]:
    """A segment with numpy columns; ``seq`` follows ``seq - 1`` in time."""
    chunk = samples(n, t0=1_790_000_000.0 + 5.0 * seq, seed=seq)
    return {"seq": seq, "samples": columns(chunk), **changes}


def walk_body(name: str = "walk", *, n: int = 500, seed: int = 0) -> dict[str, Any]:
    """A survey walk with numpy columns."""
    walk = new_walk(name, n=n, seed=seed)
    waypoints = {"t_ms": walk.waypoints.t * 1000.0, "x": walk.waypoints.x, "y": walk.waypoints.y + 2.0}
    return {"name": name, "samples": columns(walk.samples), "waypoints": waypoints}


def as_msgpack(value: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a call with this body in msgpack."""
    return {"content": msgpack.packb(packed(value)), "headers": {"Content-Type": MSGPACK_TYPE}}
