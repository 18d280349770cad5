"""A prepared data directory (level, map, open sessions), copied for every test that needs one."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.service import Service, build_map, open_session, segment_bodies, upload_survey
from tests.e2e.synthetic import trip

N_SESSIONS = 8
SEGMENT_S = 20.0
HEAVY = {"particles": 20_000}
"""Makes a segment take some 50 ms, so that there is something to interrupt."""

MakeService = Callable[..., Service]


@dataclass(frozen=True)
class Prepared:
    """A stopped service's data and what will be sent to it."""

    data_dir: Path
    key: str
    level_id: str
    bodies: dict[str, list[dict[str, Any]]]
    """Segments by session."""
    first_output: str
    first_log: str

    @property
    def n_segments(self) -> int:
        return sum(len(bodies) for bodies in self.bodies.values())


@pytest.fixture(scope="session")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    service = Service(tmp_path_factory.mktemp("prepared") / "data")
    try:
        service.start()
        level_id = upload_survey(service)
        assert build_map(service, level_id)["state"] == "done"
        walks = [trip(seed, t0=1.75e9) for seed in range(N_SESSIONS)]
        bodies = {open_session(service, level_id, walk, **HEAVY): segment_bodies(walk, SEGMENT_S) for walk in walks}
        service.terminate()
    finally:
        service.clean_up()
    return Prepared(service.data_dir, service.key, level_id, bodies, service.shown, service.log)


@pytest.fixture
def make_service(tmp_path: Path, prepared: Prepared) -> Iterator[MakeService]:
    """Makes (unstarted) services over copies of the prepared data."""
    made: list[Service] = []

    def make(**environment: str) -> Service:
        data_dir = tmp_path / f"data{len(made)}"
        shutil.copytree(prepared.data_dir, data_dir)
        service = Service(data_dir, prepared.key, environment)
        made.append(service)
        return service

    yield make
    for service in made:
        service.clean_up()


@pytest.fixture(scope="session")
def undisturbed(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], dict[str, Any]]:
    """What the service answers, by session and seq, when nothing goes wrong."""
    data_dir = tmp_path_factory.mktemp("undisturbed") / "data"
    shutil.copytree(prepared.data_dir, data_dir)
    service = Service(data_dir, prepared.key)
    try:
        service.start()
        return {
            (session_id, body["seq"]): service.post(f"/v1/sessions/{session_id}/segments", body, Prefer="wait=30")
            for session_id, bodies in prepared.bodies.items()
            for body in bodies
        }
    finally:
        service.clean_up()
