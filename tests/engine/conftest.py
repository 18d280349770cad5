"""A simulated building: field, walks, maps."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.types import GridMap, SurveyWalk
from tests.support.walks import Field, SimulatedWalk, survey_of, true_map, walk_through

CORNERS = np.array([[2.0, 2.0], [38.0, 2.0], [38.0, 18.0], [2.0, 18.0], [2.0, 10.0], [30.0, 10.0]])


class OneMap:
    """Map source of one map."""

    def __init__(self, grid_map: GridMap) -> None:
        self._map = grid_map

    def level_ids(self) -> tuple[str, ...]:
        return (self._map.level_id,)

    def grid_map(self, level_id: str) -> GridMap:
        return self._map


@pytest.fixture(scope="session")
def field() -> Field:
    return Field.random(np.random.default_rng(1))


@pytest.fixture(scope="session")
def field_map(field: Field) -> GridMap:
    return true_map(field, (0.0, 0.0, 42.0, 22.0))


@pytest.fixture(scope="session")
def walk(field: Field) -> SimulatedWalk:
    return walk_through(CORNERS, field, np.random.default_rng(2))


@pytest.fixture(scope="session")
def survey(field: Field) -> tuple[SurveyWalk, ...]:
    """Twelve walks with hard iron and carrying angles of their own, both directions, a metre apart."""
    rng = np.random.default_rng(3)
    walks = []
    for i in range(12):
        corners = CORNERS + rng.normal(0, 0.5, CORNERS.shape)
        corners = corners if i % 2 else corners[::-1]
        simulated = walk_through(corners, field, rng, hard_iron=rng.normal(0, 4, 3), carry=rng.normal(0, 0.12))
        walks.append(survey_of(simulated, f"walk-{i}"))
    return tuple(walks)


class LevelMaps:
    """Map source with several levels."""

    def __init__(self, maps: dict[str, GridMap]) -> None:
        self.maps = maps

    def level_ids(self) -> tuple[str, ...]:
        return tuple(self.maps)

    def grid_map(self, level_id: str) -> GridMap:
        return self.maps[level_id]
