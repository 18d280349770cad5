"""Maps: requests to build them, finished versions, their grids."""

from __future__ import annotations

from datetime import datetime

from app.engine.types import Evidence, GridMap
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError, InvalidError, NoMapError
from app.services.ids import new_id
from app.services.map_refs import MapRefs
from app.services.ports import JobListener, MapCache, UnitOfWork, UnitOfWorkFactory
from app.services.records import Job, JobKind, JobState, MapInfo, NewBuild, Page


class MapService(Service):
    """Order map builds, read map versions."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache, listener: JobListener) -> None:
        super().__init__(uow=uow, clock=clock)
        self._listener = listener
        self._refs = MapRefs(uow=uow, cache=cache)

    def request_build(self, new: NewBuild) -> Job:
        """Queue a build from the level's surveys (or the named ones); ConflictError if they hold no walk."""
        now = self._clock()
        job = _build_job(new, now)
        with self._uow(write=True) as uow:
            uow.levels.get(new.level_id)
            _check_surveys(uow, new)
            if not uow.surveys.count_walks(new.level_id, new.survey_ids):
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
        self._refs.info(map_id)
        return None


def _check_surveys(uow: UnitOfWork, new: NewBuild) -> None:
    for i, survey_id in enumerate(new.survey_ids):
        if uow.surveys.get(survey_id).level_id != new.level_id:
            raise InvalidError(
                f"survey_ids.{i}", f"survey {survey_id} is of another level", f"name surveys of level {new.level_id}"
            )


def _build_job(new: NewBuild, now: datetime) -> Job:
    return Job(
        id=new_id("job", now),
        kind=JobKind.BUILD_MAP,
        state=JobState.QUEUED,
        order_key=new.level_id,
        subject={"level_id": new.level_id},
        attempts=0,
        progress=0.0,
        progress_text="",
        result={},
        error=None,
        created_at=now,
        started_at=None,
        finished_at=None,
    )
