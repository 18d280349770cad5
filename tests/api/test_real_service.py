"""The whole service in one process, engine and all: a survey of a real floor goes in, positions come out."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest

from app.engine.types import ImuSamples
from app.evaluation.datasets.ilc20 import RecordedWalk, open_ilc20
from app.main import create_app
from app.settings import PoolKind, Settings
from tests.api.harness import columns, packed

SAMPLES = Path(__file__).parents[2] / "maps" / "samples"
SEGMENT_S = 5.0


def body_of(walk: RecordedWalk) -> dict[str, Any]:
    points = walk.waypoints
    waypoints = {"t_ms": points.t * 1000.0, "x": points.x, "y": points.y}
    return {"name": walk.walk_id, "samples": columns(walk.samples), "waypoints": waypoints}


def cut(samples: ImuSamples) -> list[ImuSamples]:
    number = ((samples.t - samples.t[0]) // SEGMENT_S).astype(int)
    parts = (number == k for k in range(number[-1] + 1))
    return [ImuSamples(samples.t[p], samples.mag[p], samples.acc[p], samples.gyro[p]) for p in parts]


class Client:
    def __init__(self, http: httpx.AsyncClient, key: str) -> None:
        self._http, self._headers = http, {"X-API-Key": key, "Prefer": "wait=30"}

    async def read(self, path: str) -> Any:
        response = await self._http.get(path, headers=self._headers)
        assert response.is_success, response.text
        return response.json()

    async def send(self, path: str, body: dict[str, Any], *, binary: bool = False) -> Any:
        if binary:
            headers = {**self._headers, "Content-Type": "application/msgpack"}
            response = await self._http.post(path, content=msgpack.packb(packed(body)), headers=headers)
        else:
            response = await self._http.post(path, json=body, headers=self._headers)
        assert response.is_success, response.text
        return response.json()


async def walk_through(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[Any, list[Any], Any]:
    floor = open_ilc20(SAMPLES).level("site1-F2")
    x_min, y_min, x_max, y_max = floor.extent
    app = create_app(Settings(data_dir=folder, pool=PoolKind.INLINE, workers=1))
    async with app.router.lifespan_context(app):
        secret = re.search(r"isk_\S+", capsys.readouterr().out)
        assert secret is not None
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://isodyn.test", timeout=60) as http:
            client = Client(http, secret.group())
            venue = await client.send("/v1/venues", {"name": "site1"})
            extent = {"x_min": x_min, "y_min": y_min, "x_max": x_max, "y_max": y_max}
            level = await client.send(f"/v1/venues/{venue['id']}/levels", {"name": "F2", "extent": extent})
            survey = await client.send("/v1/surveys", {"level_id": level["id"], "name": "train"})
            for walk in floor.walks("train")[:8]:
                await client.send(f"/v1/surveys/{survey['id']}/walks", body_of(walk), binary=True)
            job = await client.send("/v1/maps", {"level_id": level["id"]})
            walked = floor.walks("train")[0]
            prior = {"x": float(walked.waypoints.x[0]), "y": float(walked.waypoints.y[0]), "radius_m": 3.0}
            session = await client.send("/v1/sessions", {"level_id": level["id"], "prior": prior})
            answers = [
                await client.send(
                    f"/v1/sessions/{session['id']}/segments", {"seq": seq, "samples": columns(part)}, binary=True
                )
                for seq, part in enumerate(cut(walked.samples)[:6])
            ]
            return job, answers, await client.read(f"/v1/sessions/{session['id']}/trajectory")


def test_from_survey_to_positions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job, answers, trajectory = asyncio.run(walk_through(tmp_path, capsys))
    assert (job["state"], job["error"]) == ("done", None)
    assert [answer["state"] for answer in answers] == ["done"] * len(answers)
    walked = open_ilc20(SAMPLES).level("site1-F2").walks("train")[0]
    t_ms = np.concatenate([answer["fixes"]["t_ms"] for answer in answers])
    xy = np.stack([np.concatenate([answer["fixes"][axis] for answer in answers]) for axis in "xy"])

    def errors(t_ms: Any, xy: Any) -> Any:
        points = walked.waypoints
        truth = [np.interp(np.array(t_ms) / 1000.0, points.t, values) for values in (points.x, points.y)]
        return np.hypot(*(np.array(xy) - truth))

    assert len(t_ms) > 20
    assert all((np.diff(answer["fixes"]["t_ms"]) > 0).all() for answer in answers)
    # a walk the map was built from: coarse, but no unit, axis or clock can be wrong on the way
    assert np.median(errors(t_ms, xy)) < 5.0
    smooth = trajectory["fixes"]
    assert (trajectory["kind"], trajectory["method"]) == ("smoothed", "particle")
    # a fix per step: those of the moment but for the one that ends each segment
    assert set(smooth["t_ms"]) == {t for answer in answers for t in answer["fixes"]["t_ms"][:-1]}
    assert np.median(errors(smooth["t_ms"], (smooth["x"], smooth["y"]))) < 5.0
