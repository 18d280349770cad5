"""Threads or processes? Replays real walks as 5-second segments through the whole service, with either pool.

    python -m tests.e2e.pool_benchmark [--data maps/samples] [--level site1-F2] [--workers 2] [--rounds 3]

Prints, per pool: answer times of one session alone and of eight side by side (``Prefer: wait``, seen by the client),
how many segments a second are taken from a full queue, and the processor time of service and workers per segment.
The client shares the machine with the service, as in the tests.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import psutil

from app.engine.types import ImuSamples
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk, open_ilc20
from tests.e2e.service import FINAL, Service

SEGMENT_S = 5.0
SIDE_BY_SIDE = 8
MSGPACK = {"Content-Type": "application/msgpack"}


@dataclass(frozen=True)
class Bench:
    """A running service with a map, and walks to replay."""

    service: Service
    level_id: str
    walks: Sequence[RecordedWalk]

    def open(self, walk: RecordedWalk) -> str:
        prior = {"x": float(walk.waypoints.x[0]), "y": float(walk.waypoints.y[0]), "radius_m": 3.0}
        session: str = self.service.post("/v1/sessions", {"level_id": self.level_id, "prior": prior})["id"]
        return session

    def send(self, session_id: str, body: bytes, *, wait: bool) -> float:
        """Post one segment and return how long the answer took."""
        headers = {**MSGPACK, **({"Prefer": "wait=30"} if wait else {})}
        started = time.perf_counter()
        answer = self.service.request("POST", f"/v1/sessions/{session_id}/segments", content=body, headers=headers)
        elapsed = time.perf_counter() - started
        assert answer.status_code == (200 if wait else 202), answer.text
        return elapsed

    def replay(self, walk: RecordedWalk) -> list[float]:
        session_id = self.open(walk)
        return [self.send(session_id, body, wait=True) for body in segments(walk)]

    def cpu_ms(self) -> np.ndarray:
        """Processor time so far: of the service process, and of its worker processes."""
        assert self.service.process is not None

        def used(processes: list[psutil.Process]) -> float:
            return 1e3 * sum(process.cpu_times().user + process.cpu_times().system for process in processes)

        return np.array([used([psutil.Process(self.service.process.pid)]), used(self.service.family())])


def samples_body(samples: ImuSamples) -> dict[str, Any]:
    def vector(columns: np.ndarray) -> dict[str, bytes]:
        return {axis: columns[:, i].astype("<f4").tobytes() for i, axis in enumerate("xyz")}

    return {
        "t_ms": (samples.t * 1e3).astype("<f8").tobytes(),
        "mag": vector(samples.mag),
        "acc": vector(samples.acc),
        "gyro": vector(samples.gyro),
    }


def segments(walk: RecordedWalk) -> Iterator[bytes]:
    s = walk.samples
    number = ((s.t - s.t[0] + 1e-6) // SEGMENT_S).astype(int)
    for seq in range(int(number[-1]) + 1):
        chosen = number == seq
        chunk = ImuSamples(s.t[chosen], s.mag[chosen], s.acc[chosen], s.gyro[chosen])
        yield msgpack.packb({"seq": seq, "frame": "android", "samples": samples_body(chunk)})


def prepare(service: Service, level: Ilc20Level) -> str:
    venue = service.post("/v1/venues", {"name": level.site, "kind": "indoor"})
    extent = dict(zip(("x_min", "y_min", "x_max", "y_max"), level.extent, strict=True))
    made = service.post(f"/v1/venues/{venue['id']}/levels", {"name": level.floor, "ordinal": 0, "extent": extent})
    survey = service.post("/v1/surveys", {"level_id": made["id"], "name": "train"})
    for walk in level.walks("train"):
        marks = walk.waypoints
        body = {
            "name": walk.walk_id,
            "frame": "android",
            "samples": samples_body(walk.samples),
            "waypoints": {
                "t_ms": (marks.t * 1e3).astype("<f8").tobytes(),
                "x": marks.x.astype("<f8").tobytes(),
                "y": marks.y.astype("<f8").tobytes(),
            },
        }
        answer = service.request(
            "POST", f"/v1/surveys/{survey['id']}/walks", content=msgpack.packb(body), headers=MSGPACK
        )
        assert answer.is_success, answer.text
    job = service.post("/v1/maps", {"level_id": made["id"]}, Prefer="wait=30")
    assert job["state"] == "done", job
    level_id: str = made["id"]
    return level_id


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def show(name: str, seconds: Sequence[float], rest: str = "") -> None:
    p50, p95, p99 = 1e3 * np.percentile(seconds, [50, 95, 99])
    say(f"  {name:<14} n {len(seconds):4d}   p50 {p50:6.1f} ms   p95 {p95:6.1f} ms   p99 {p99:6.1f} ms   {rest}")


def measure(bench: Bench, rounds: int) -> None:
    for walk in bench.walks[:2]:
        bench.replay(walk)
    before = bench.cpu_ms()
    alone = [elapsed for _ in range(rounds) for walk in bench.walks for elapsed in bench.replay(walk)]
    show("alone", alone, spent(bench, before, len(alone)))

    before, started = bench.cpu_ms(), time.perf_counter()
    with ThreadPoolExecutor(SIDE_BY_SIDE) as clients:
        side = [elapsed for times in clients.map(bench.replay, [*bench.walks] * rounds) for elapsed in times]
    rate = len(side) / (time.perf_counter() - started)
    show("side by side", side, f"{rate:.0f} segments/s   {spent(bench, before, len(side))}")
    drain(bench, rounds)
    report_jobs(bench)


def spent(bench: Bench, before: np.ndarray, n: int) -> str:
    service, workers = (bench.cpu_ms() - before) / n
    return f"cpu: service {service:.1f} ms, workers {workers:.1f} ms"


def drain(bench: Bench, rounds: int) -> None:
    """Fill the queue, then see how fast it empties."""
    queued = [(bench.open(walk), list(segments(walk))) for walk in [*bench.walks] * rounds]
    n = sum(len(bodies) for _, bodies in queued)
    before, started = bench.cpu_ms(), time.perf_counter()
    with ThreadPoolExecutor(4) as clients:
        for _ in clients.map(lambda item: [bench.send(item[0], body, wait=False) for body in item[1]], queued):
            pass
    while bench.service.get("/v1/jobs", limit=1, state="queued")["items"]:
        time.sleep(0.01)
    rate = n / (time.perf_counter() - started)
    say(f"  {'from a queue':<14} n {n:4d}   {rate:.0f} segments/s   {spent(bench, before, n)}")


def report_jobs(bench: Bench) -> None:
    """The processor time of the task itself, as the worker saw it."""
    jobs = [job for job in bench.service.jobs() if job["kind"] == "locate_segment" and job["state"] in FINAL]
    assert all(job["state"] == "done" for job in jobs)
    show("task (cpu)", [float(job["result"]["cpu_s"]) for job in jobs])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("maps/samples"))
    parser.add_argument("--level", default="site1-F2")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--pools", nargs="+", default=["threads", "processes"])
    options = parser.parse_args()
    level = open_ilc20(options.data).level(options.level)
    for pool in options.pools:
        with tempfile.TemporaryDirectory() as folder:
            settings = {"ISODYN_POOL": pool, "ISODYN_WORKERS": str(options.workers), "ISODYN_LOG_LEVEL": "warning"}
            service = Service(Path(folder) / "data", environment=settings)
            try:
                service.start()
                bench = Bench(service, prepare(service, level), level.walks("test"))
                say(f"{pool}, {options.workers} workers")
                measure(bench, options.rounds)
            finally:
                service.clean_up()


if __name__ == "__main__":
    main()
