"""The sample floor in a running service: small cells are slow, so it is mapped in large ones."""

from __future__ import annotations

from dataclasses import dataclass

from isodyn_client import Client

from app.cli.transport import ServiceTransport
from app.cli.uploads import level_upload
from app.engine.types import MapBuildSettings
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.e2e.service import Service

WALKS_EACH = 8
"""Walks of each of the two surveys."""
SETTINGS = MapBuildSettings(cell_m=1.0)


@dataclass(frozen=True)
class Floor:
    """Ids of what is there."""

    venue_id: str
    level_id: str
    map_ids: tuple[str, str]
    """The first version, of the first survey; the second, of both: the current one."""


def survey_floor(service: Service, level: Ilc20Level) -> Floor:
    """Upload a floor, survey it twice, map it after each survey."""
    walks = [walk.survey_walk() for walk in level.walks("train")[: 2 * WALKS_EACH]]
    maps = []
    with Client(f"http://127.0.0.1:{service.port}", service.key) as client:
        transport = ServiceTransport(client)
        level_id = transport.add_level(level_upload(level))
        for some in (walks[:WALKS_EACH], walks[WALKS_EACH:]):
            transport.add_walks(level_id, some, lambda *_: None)
            transport.build_map(level_id, SETTINGS, lambda *_: None)
            maps.append(client.level(level_id).current_map_id)
        venue_id = client.level(level_id).venue_id
    first, second = maps
    assert first is not None
    assert second is not None
    return Floor(venue_id, level_id, (first, second))
