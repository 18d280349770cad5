"""Starts, kills and talks to the real service."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from app.engine.types import ImuSamples
from tests.e2e.synthetic import EXTENT, Walk, survey_walks
from tests.workers.polling import eventually, gone

ROOT = Path(__file__).resolve().parents[2]
START_TIMEOUT_S = 240.0
FINAL = {"done", "failed", "cancelled"}
Json = dict[str, Any]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Service:
    """One data directory and, now and then, a process that serves it."""

    data_dir: Path
    key: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[bytes] | None = None
    http: httpx.Client | None = None

    @property
    def log(self) -> str:
        return (self.data_dir.parent / f"{self.data_dir.name}.log").read_text()

    @property
    def shown(self) -> str:
        """What the service wrote to stdout, in all its runs."""
        return (self.data_dir.parent / f"{self.data_dir.name}.out").read_text()

    def start(self) -> None:
        """Start the process and wait until it is ready."""
        environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("ISODYN_")},
            "ISODYN_DATA_DIR": str(self.data_dir),
            "ISODYN_PORT": str(self.port),
            "ISODYN_WORKERS": "2",
            "ISODYN_RATE_LIMIT_PER_MINUTE": "0",
            **self.environment,
        }
        stem = self.data_dir.parent / self.data_dir.name
        with stem.with_suffix(".out").open("ab") as out, stem.with_suffix(".log").open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "app.cli", "serve"], cwd=ROOT, env=environment, stdout=out, stderr=log
            )
        self.http = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=60.0)
        eventually(self._ready, START_TIMEOUT_S)
        if not self.key:
            self.key = re.findall(r"isk_[\w-]+", self.shown)[0]
        self.http.headers["Authorization"] = f"Bearer {self.key}"

    def _ready(self) -> bool:
        assert self.process is not None
        assert self.http is not None
        assert self.process.poll() is None, self.log
        try:
            return self.http.get("/readyz").status_code == 200
        except httpx.TransportError:
            return False

    def family(self) -> list[psutil.Process]:
        """The service's child processes, theirs included."""
        assert self.process is not None
        return psutil.Process(self.process.pid).children(recursive=True)

    def workers(self) -> list[psutil.Process]:
        """Worker processes: the children of the fork server."""
        assert self.process is not None
        mine = psutil.Process(self.process.pid).children()
        return [child for process in mine for child in process.children()]

    def kill(self) -> None:
        """``kill -9`` of the service process only; its children must notice by themselves."""
        assert self.process is not None
        family = self.family()
        self.process.kill()
        self.process.wait(10)
        self._hang_up()
        eventually(lambda: all(gone(process.pid) for process in family))

    def terminate(self) -> int:
        """Stop in an orderly way and return the exit status."""
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        status = self.process.wait(60)
        self._hang_up()
        return status

    def clean_up(self) -> None:
        """End whatever still runs."""
        if self.process is not None and self.process.poll() is None:
            self.kill()
        self._hang_up()

    def _hang_up(self) -> None:
        if self.http is not None:
            self.http.close()

    # Requests

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        assert self.http is not None
        return self.http.request(method, path, **options)

    def post(self, path: str, body: Json, **headers: str) -> Json:
        answer = self.request("POST", path, json=body, headers={k.replace("_", "-"): v for k, v in headers.items()})
        assert answer.is_success, answer.text
        result: Json = answer.json()
        return result

    def get(self, path: str, **params: str | int) -> Json:
        answer = self.request("GET", path, params=params)
        assert answer.is_success, answer.text
        result: Json = answer.json()
        return result

    def metric(self, sample: str) -> float:
        """Value of one line of /metrics; 0 if it is not there yet."""
        text = self.request("GET", "/metrics").text
        found = re.search(rf"^{re.escape(sample)} (\S+)$", text, flags=re.MULTILINE)
        return float(found.group(1)) if found else 0.0

    def jobs(self) -> list[Json]:
        items: list[Json] = []
        cursor: dict[str, str] = {}
        while True:
            page = self.get("/v1/jobs", limit=500, **cursor)
            items.extend(page["items"])
            if page["next_cursor"] is None:
                return items
            cursor = {"cursor": page["next_cursor"]}

    def await_all_jobs(self, timeout: float = 120.0) -> list[Json]:
        eventually(lambda: all(job["state"] in FINAL for job in self.jobs()), timeout)
        return self.jobs()


def samples_body(samples: ImuSamples) -> Json:
    def vector(columns: np.ndarray) -> Json:
        return {axis: columns[:, i].tolist() for i, axis in enumerate("xyz")}

    return {
        "t_ms": (samples.t * 1e3).tolist(),
        "mag": vector(samples.mag),
        "acc": vector(samples.acc),
        "gyro": vector(samples.gyro),
    }


def segment_bodies(walk: Walk, seconds: float) -> list[Json]:
    """The walk as segments, ready to be posted in order."""
    start = walk.samples.t[0]
    number = ((walk.samples.t - start + 1e-6) // seconds).astype(int)
    bodies = []
    for seq in range(int(number[-1]) + 1):
        chosen = number == seq
        chunk = ImuSamples(*(column[chosen] for column in _columns(walk.samples)))
        bodies.append({"seq": seq, "frame": "android", "samples": samples_body(chunk)})
    return bodies


def _columns(samples: ImuSamples) -> Iterable[np.ndarray]:
    return samples.t, samples.mag, samples.acc, samples.gyro


def upload_survey(service: Service) -> str:
    """Make a venue, a level and a survey with its walks; returns the level's id."""
    venue = service.post("/v1/venues", {"name": "Test hall", "kind": "indoor"})
    extent = dict(zip(("x_min", "y_min", "x_max", "y_max"), EXTENT, strict=True))
    level = service.post(f"/v1/venues/{venue['id']}/levels", {"name": "Ground", "ordinal": 0, "extent": extent})
    survey = service.post("/v1/surveys", {"level_id": level["id"], "name": "aisles"})
    for number, walk in enumerate(survey_walks()):
        marks = walk.waypoints
        service.post(
            f"/v1/surveys/{survey['id']}/walks",
            {
                "name": f"walk {number}",
                "frame": "android",
                "samples": samples_body(walk.samples),
                "waypoints": {"t_ms": (marks.t * 1e3).tolist(), "x": marks.x.tolist(), "y": marks.y.tolist()},
            },
        )
    level_id: str = level["id"]
    return level_id


def build_map(service: Service, level_id: str) -> Json:
    return service.post("/v1/maps", {"level_id": level_id}, Prefer="wait=30")


def open_session(service: Service, level_id: str, walk: Walk, **parameters: object) -> str:
    prior = {"x": float(walk.x[0]), "y": float(walk.y[0]), "radius_m": 3.0}
    session = service.post("/v1/sessions", {"level_id": level_id, "prior": prior, "parameters": parameters})
    session_id: str = session["id"]
    return session_id
