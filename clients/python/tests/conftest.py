"""A service of canned answers, and clients that talk to it without a network."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import pytest
from isodyn_client import AsyncClient, Client, RetryPolicy, Samples

Answer = httpx.Response | Exception


@dataclass
class FakeService:
    """Gives the answers it was told to give, in order, and remembers the requests."""

    answers: list[Answer | Callable[[httpx.Request], Answer]] = field(default_factory=list)
    requests: list[httpx.Request] = field(default_factory=list)
    bodies: list[bytes] = field(default_factory=list)
    pauses: list[float] = field(default_factory=list)

    def will(self, *answers: Answer | Callable[[httpx.Request], Answer]) -> None:
        self.answers.extend(answers)

    def handle(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        self.bodies.append(request.read())
        return self._answer(request)

    async def handle_async(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        self.bodies.append(await request.aread())
        return self._answer(request)

    def _answer(self, request: httpx.Request) -> httpx.Response:
        answer = self.answers.pop(0)
        if callable(answer):
            answer = answer(request)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def sleep(self, seconds: float) -> None:
        self.pauses.append(seconds)

    def client(self, **options: Any) -> Client:
        return Client(
            "http://service.test",
            "isk_test",
            transport=httpx.MockTransport(self.handle),
            sleep=self.pauses.append,
            **{"retry": RetryPolicy(), **options},
        )

    def async_client(self, **options: Any) -> AsyncClient:
        return AsyncClient(
            "http://service.test",
            "isk_test",
            transport=httpx.MockTransport(self.handle_async),
            sleep=self.sleep,
            **options,
        )


@pytest.fixture
def service() -> FakeService:
    return FakeService()


@pytest.fixture
def client(service: FakeService) -> Iterator[Client]:
    with service.client() as client:
        yield client


def ok(value: object, status: int = 200, **headers: str) -> httpx.Response:
    return httpx.Response(status, content=json.dumps(value), headers={"Content-Type": "application/json", **headers})


def problem(status: int, slug: str, *, errors: list[dict[str, str]] | None = None, **headers: str) -> httpx.Response:
    body = {
        "type": f"https://isodyn.dev/problems/{slug}",
        "title": slug.replace("-", " ").capitalize(),
        "status": status,
        "detail": "what happened",
        "errors": errors or [],
    }
    return httpx.Response(
        status, content=json.dumps(body), headers={"Content-Type": "application/problem+json", **headers}
    )


NOW = "2026-11-22T09:00:00.000Z"
VENUE = {"id": "ven_1", "name": "Mall", "kind": "indoor", "anchor": None, "created_at": NOW, "updated_at": NOW}
SESSION = {
    "id": "ses_1",
    "venue_id": "ven_1",
    "level_id": "lev_1",
    "map_id": "map_1",
    "device_id": None,
    "method": "particle",
    "parameters": {},
    "prior": {"x": 1.0, "y": 2.0, "radius_m": 3.0},
    "status": "open",
    "next_seq": 0,
    "created_at": NOW,
    "closed_at": None,
}
FIXES = {
    "t_ms": [1000.0, 2000.5],
    "kind": ["filtered", "filtered"],
    "x": [1.0, 2.0],
    "y": [3.0, 4.0],
    "cov_xx": [4.0, 1.0],
    "cov_xy": [0.0, 0.5],
    "cov_yy": [1.0, 2.0],
    "heading_deg": [10.0, 20.0],
    "status": ["insufficient", "ok"],
    "quality": [0.1, 0.9],
    "sure": [False, True],
    "walk_on_m": [12.5, None],
    "level_id": ["lev_1", "lev_1"],
}
LAGGED = {name: values[:1] for name, values in FIXES.items()} | {"kind": ["fixed_lag"], "x": [0.75]}


def job(state: str, progress: float = 0.0, **more: object) -> dict[str, object]:
    return {
        "id": "job_1",
        "kind": "build_map",
        "state": state,
        "subject": {"level_id": "lev_1"},
        "attempts": 1,
        "progress": progress,
        "progress_text": "kriging",
        "result": {},
        "error": None,
        "created_at": NOW,
        "started_at": NOW,
        "finished_at": None,
        **more,
    }


def segment(seq: int, state: str = "done") -> dict[str, object]:
    done = state == "done"
    told = {"fixes": FIXES if done else None, "fixed_lag": LAGGED if done else None, "position": None}
    return {"session_id": "ses_1", "seq": seq, "state": state, "error": None, **told}


def make_samples(n: int = 100, *, start_ms: float = 1_764_000_000_000.0, step_ms: float = 20.0) -> Samples:
    rng = np.random.default_rng(n)
    t_ms = start_ms + step_ms * np.arange(n)
    return Samples(t_ms, rng.normal(0, 30, (n, 3)), rng.normal(0, 9, (n, 3)), rng.normal(0, 1, (n, 3)))
