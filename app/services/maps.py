"""Maps: requests to build them, finished versions, their grids."""

from __future__ import annotations

from app.engine.types import Evidence, FeatureSet, GridMap
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError, InvalidError, NoMapError
from app.services.map_changes import build_job, can_update, changes_of
from app.services.map_refs import MapRefs
from app.services.ports import JobListener, MapCache, UnitOfWork, UnitOfWorkFactory
from app.services.records import Job, MapInfo, MapKind, NewBuild, Page


class MapService(Service):
    """Order map builds, read map versions."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache, listener: JobListener) -> None:
        super().__init__(uow=uow, clock=clock)
        self._listener = listener
        self._refs = MapRefs(uow=uow, cache=cache)

    def request_build(self, new: NewBuild) -> Job:
        """Queue a build from the level's surveys (or the named ones), or an update of its current map by what is new.

        ConflictError if there is no walk to build from, or nothing that the current map lacks or has too much.
        """
        now = self._clock()
        job = build_job(new, now)
        with self._uow(write=True) as uow:
            uow.levels.get(new.level_id)
            _check_surveys(uow, new)
            if new.mode is MapKind.UPDATE:
                _check_update(uow, new)
            elif not uow.surveys.count_walks(new.level_id, new.survey_ids):
                raise ConflictError(f"level {new.level_id} has no survey walks; upload walks before building a map")
            uow.jobs.add(job)
            uow.maps.add_build(job.id, new)
        self._listener.job_queued(job)
        return job

    def get(self, map_id: str) -> MapInfo:
        """One map version."""
        return self._refs.info(map_id)

    def list(self, level_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT) -> Page[MapInfo]:
        """Map versions, newest first, of one level if it is named."""
        with self._uow() as uow:
            if level_id is not None:
                uow.levels.get(level_id)
            return uow.maps.list(level_id=level_id, cursor=cursor, limit=check_limit(limit))

    def current(self, level_id: str) -> MapInfo:
        """The version new sessions on the level use; NoMapError if there is none."""
        with self._uow() as uow:
            map_id = uow.levels.get(level_id).current_map_id
        if map_id is None:
            raise NoMapError(level_id=level_id)
        return self._refs.info(map_id)

    def grid(self, map_id: str) -> GridMap:
        """The map's arrays, read-only and memory-mapped."""
        return self._refs.grid(map_id)

    def evidence(self, map_id: str) -> Evidence | None:
        """What the map rests on; None for a map that was stored without it."""
        with self._uow() as uow:
            return uow.maps.evidence(map_id)


def _check_surveys(uow: UnitOfWork, new: NewBuild) -> None:
    for i, survey_id in enumerate(new.survey_ids):
        if uow.surveys.get(survey_id).level_id != new.level_id:
            raise InvalidError(
                f"survey_ids.{i}", f"survey {survey_id} is of another level", f"name surveys of level {new.level_id}"
            )


def _why_not(info: MapInfo) -> str:
    """Why a version takes no updates, and what to do."""
    if info.kind is MapKind.IMPORT:
        return "it was imported and has no walks behind it; build a map from the surveys of the level"
    if info.features is not FeatureSet.VECTOR:
        return f"its features are {info.features.value!r}; build it once more, with the features 'vector'"
    return "it was stored without what was fitted; build it once more"


def _check_update(uow: UnitOfWork, new: NewBuild) -> None:
    current = uow.levels.get(new.level_id).current_map_id
    if current is None:
        raise NoMapError(level_id=new.level_id)
    info = uow.maps.get(current)
    if not can_update(info):
        raise ConflictError(f"map {current} cannot be updated: {_why_not(info)}")
    if not changes_of(uow, new, current):
        raise ConflictError(f"map {current} is up to date: nothing was added or deleted since")
