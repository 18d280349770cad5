"""What a map version lacks of its level's evidence, and what it has too much; the jobs that mend it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from app.engine.mapping import MapModel
from app.engine.mapping.kriging import LARGEST_BLOCK
from app.engine.types import Evidence, FeatureSet, Float64Array, SurveyWalk
from app.services.new_jobs import new_job
from app.services.ports import Box, UnitOfWork
from app.services.records import Job, JobKind, MapInfo, MapKind, NewBuild, Publication

MAX_CONTRIBUTIONS = 500
"""Contributions of one update: it stays short, and the next takes the rest."""
_DISPLACED_M = 5.0
"""Further than this no walk is moved from its labels."""
_BLOCKS = 2


@dataclass(frozen=True, slots=True)
class MapChanges:
    """Ids of walks and contributions to add, and of sources to take out because they were deleted or rejected."""

    walks: tuple[str, ...]
    contributions: tuple[str, ...]
    removed: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.walks or self.contributions or self.removed)


def changes_of(uow: UnitOfWork, new: NewBuild, map_id: str) -> MapChanges:
    """What an update of this version would do."""
    known = uow.maps.sources(map_id)
    walks, offered = uow.surveys.walk_ids(new.level_id, ()), uow.contributions.live(new.level_id)
    wanted = uow.surveys.walk_ids(new.level_id, new.survey_ids) if new.survey_ids else walks
    fresh = [one for one in offered if one not in known]
    return MapChanges(
        walks=tuple(walk for walk in wanted if walk not in known),
        contributions=tuple(fresh[:MAX_CONTRIBUTIONS]),
        removed=tuple(sorted(known - {*walks, *offered})),
    )


def can_update(info: MapInfo) -> bool:
    """Whether a version keeps what an update needs."""
    return info.model is not None and info.features is FeatureSet.VECTOR


def queue_update(uow: UnitOfWork, level_id: str, now: datetime, *, offered: bool = False) -> Job | None:
    """Queue an update of the level's current map, unless one waits already or there is nothing to update.

    ``offered``: a contribution came just now, so there is. Nor is an update queued after a roll-back: what made
    somebody go back would come in again. Walks are taken from the surveys that the current map was ordered from.
    """
    current = uow.levels.get(level_id).current_map_id
    if current is None or not can_update(uow.maps.get(current)) or uow.maps.awaits_build(level_id):
        return None
    order = uow.maps.build_of(current) or NewBuild(level_id)
    new = replace(order, mode=MapKind.UPDATE, publish=True, key_id=None)
    if _went_back(uow, level_id) is not None or not (offered or changes_of(uow, new, current)):
        return None
    job = build_job(new, now)
    uow.jobs.add(job)
    uow.maps.add_build(job.id, new)
    return job


def is_overtaken(uow: UnitOfWork, job: Job) -> bool:
    """Whether somebody went back to an older version since an update was queued: it would undo that."""
    back = _went_back(uow, str(job.subject["level_id"]))
    return back is not None and job.created_at < back.created_at


def _went_back(uow: UnitOfWork, level_id: str) -> Publication | None:
    """The level's last publication, if it was of an older version: then maps change only when somebody asks for it."""
    last = uow.publications.latest(level_id)
    if last is None or last.from_map_id is None:
        return None
    return last if uow.maps.get(last.map_id).version < uow.maps.get(last.from_map_id).version else None


def build_job(new: NewBuild, now: datetime) -> Job:
    """A job that builds or updates a level's map."""
    return new_job(JobKind.BUILD_MAP, new.level_id, {"level_id": new.level_id}, now)


def box_of(
    info: MapInfo, walks: Sequence[SurveyWalk], contributed: Evidence | None, *, everything: bool = False
) -> Box:
    """What an update can change, with the evidence that this rests on, m.

    ``everything``: sources are taken out, and only their rows tell where they were.
    """
    points = [_points(walk) for walk in walks]
    if contributed is not None and len(contributed):
        points.append(contributed.xy.astype(np.float64))
    if everything or not points:
        x1, y1 = info.x0 + info.cell_m * (info.columns - 1), info.y0 + info.cell_m * (info.rows - 1)
        points.append(np.array([[info.x0, y1], [x1, info.y0]]))
    corners = np.concatenate(points)
    reach = MapModel.from_values(info.model).covariance.reach_m if info.model else 0.0
    # weights change about what comes, nodes about these are kriged, from all evidence that reaches them
    margin = 3.0 * reach + _BLOCKS * LARGEST_BLOCK * info.cell_m + _DISPLACED_M
    (x_min, y_min), (x_max, y_max) = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    return float(x_min), float(y_min), float(x_max), float(y_max)


def _points(walk: SurveyWalk) -> Float64Array:
    return np.stack([walk.waypoints.x, walk.waypoints.y], axis=1)
