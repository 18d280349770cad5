"""What a map version lacks of its level's evidence, and what it has too much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.engine.mapping import MapModel, reach_m
from app.engine.mapping.update import SQUARE
from app.engine.types import Float64Array, SurveyWalk
from app.services.ports import Box, UnitOfWork
from app.services.records import MapInfo, NewBuild

_DISPLACED_M = 5.0
"""Further than this no walk is moved from its labels."""


@dataclass(frozen=True, slots=True)
class MapChanges:
    """Ids of walks to add, and of sources to take out because they were deleted."""

    walks: tuple[str, ...]
    removed: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.walks or self.removed)


def changes_of(uow: UnitOfWork, new: NewBuild, map_id: str) -> MapChanges:
    """What an update of this version would do."""
    known = uow.maps.sources(map_id)
    there = uow.surveys.walk_ids(new.level_id, ())
    wanted = uow.surveys.walk_ids(new.level_id, new.survey_ids) if new.survey_ids else there
    return MapChanges(
        walks=tuple(walk for walk in wanted if walk not in known), removed=tuple(sorted(known - set(there)))
    )


def box_of(info: MapInfo, walks: Sequence[SurveyWalk], *, everything: bool = False) -> Box:
    """What an update by these walks can change, with the evidence that this rests on, m.

    ``everything``: sources are taken out, and only their rows tell where they were.
    """
    x1, y1 = info.x0 + info.cell_m * (info.columns - 1), info.y0 + info.cell_m * (info.rows - 1)
    if everything or info.model is None:
        corners = [np.array([[info.x0, y1], [x1, info.y0]]), *(_points(walk) for walk in walks)]
    else:
        corners = [_points(walk) for walk in walks]
    points = np.concatenate(corners)
    reach = reach_m(MapModel.from_values(info.model)) if info.model else 0.0
    # a square of the map is kriged as a whole, with all evidence that reaches it
    margin = 2.0 * reach + SQUARE * info.cell_m + _DISPLACED_M
    (x_min, y_min), (x_max, y_max) = points.min(axis=0) - margin, points.max(axis=0) + margin
    return float(x_min), float(y_min), float(x_max), float(y_max)


def _points(walk: SurveyWalk) -> Float64Array:
    return np.stack([walk.waypoints.x, walk.waypoints.y], axis=1)
