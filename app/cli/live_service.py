"""The service that ``isodyn bench live`` talks to: one of its own with the sample floor, or one that runs."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.cli.common import connect
from app.cli.errors import CommandError
from app.cli.live_load import Stage
from app.cli.process import start_service, stopped_unless_kept
from app.cli.transport import ServiceTransport
from app.cli.uploads import level_upload
from app.engine.types import Float64Array, MapBuildSettings
from app.evaluation.datasets.ilc20 import Ilc20Level, open_ilc20
from app.evaluation.datasets.walks import RecordedWalk

LEVEL = "site1-F2"
LONG_S = 45.0
"""Shorter walks are left out: each new one opens a session."""
SILENCE_S = 0.5


@dataclass(frozen=True, slots=True)
class Found:
    """A service with a mapped level; ``pid`` if it is ours."""

    url: str
    key: str | None
    level_id: str
    pid: int | None


def level_of_samples(data: Path) -> Ilc20Level:
    """The sample floor."""
    return open_ilc20(data).level(LEVEL)


def walks_of_samples(data: Path) -> list[RecordedWalk]:
    """Recorded walks of the sample floor that are long, and in which no sensor fell silent."""
    level = level_of_samples(data)
    found = [*level.walks("test"), *level.walks("train")]
    return [walk for walk in found if _suits(walk.samples.t)]


def _suits(t: Float64Array) -> bool:
    return float(t[-1] - t[0]) >= LONG_S and float(np.diff(t).max()) <= SILENCE_S


@contextmanager
def service_for(url: str | None, key: str | None, level_id: str | None, data: Path, say: Stage) -> Iterator[Found]:
    """The service at this address, or one that lives as long as the block."""
    if url is not None:
        if level_id is None:
            raise CommandError("--url needs --level: the sample floor there, with a map (isodyn demo --keep makes one)")
        yield Found(url, key, level_id, None)
        return
    with tempfile.TemporaryDirectory(prefix="isodyn-bench-", ignore_cleanup_errors=True) as folder:
        say(0.0, "starting the service")
        service = start_service(Path(folder) / "data", {"ISODYN_RATE_LIMIT_PER_MINUTE": "0"})
        with stopped_unless_kept(service):
            say(0.0, "building the map")
            made = _mapped_level(service.url, service.key, level_of_samples(data))
            yield Found(service.url, service.key, made, service.process.pid)


def _mapped_level(url: str, key: str, level: Ilc20Level) -> str:
    def quiet(fraction: float, text: str) -> None:
        """Progress that nobody sees."""

    with connect(url, key) as client:
        transport = ServiceTransport(client)
        level_id = transport.add_level(level_upload(level))
        transport.add_walks(level_id, [walk.survey_walk() for walk in level.walks("train")], quiet)
        transport.build_map(level_id, MapBuildSettings(), quiet)
    return level_id
