"""Replays: the stored segments of a session on other map versions, beside what was told then; nothing stored."""

from __future__ import annotations

from collections.abc import Sequence

from app.engine.localization.comparison import compare_fixes
from app.engine.types import Fix
from app.services.base import Service
from app.services.clock import Clock
from app.services.errors import InvalidError, NotReplayableError
from app.services.ids import seed_of
from app.services.map_refs import MapRefs
from app.services.methods import method_for
from app.services.places import NamedMap, Place, choose_place, chosen_maps, named_maps, with_maps
from app.services.ports import Executor, MapCache, UnitOfWork, UnitOfWorkFactory, WorkerLostError
from app.services.records import LevelMap, Replay, Session
from app.services.stored_segments import load_segments
from app.services.tasks import ReplayResult, ReplaySpec, ReplayTask

_MAX_FIXES = 20_000
"""More than half an hour of steps."""


class ReplayService(Service):
    """Replays sessions. Blocks until a worker has answered."""

    def __init__(
        self, *, uow: UnitOfWorkFactory, clock: Clock, executor: Executor, cache: MapCache, task: ReplayTask
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._executor = executor
        self._refs = MapRefs(uow=uow, cache=cache)
        self._task = task

    def replay(self, session_id: str, map_id: str | None = None, map_ids: Sequence[str] = ()) -> Replay:
        """Take all processed segments again from the session's prior and seed, on the named maps.

        Levels that none is named for keep the map of then. Without any named map: on the current ones, as if the
        session were opened now. On the maps of then the fixes are those of then.
        """
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            maps = _maps(uow, session, map_id, map_ids)
            segments = load_segments(uow, session, NotReplayableError)
            told = uow.sessions.list_positions(session_id, seq=None, cursor=None, limit=_MAX_FIXES).items
        spec = ReplaySpec(
            method=session.method,
            parameters=session.parameters,
            prior=session.prior,
            seed=seed_of(session_id),
            segments=segments,
            maps=self._refs.refs(maps),
        )
        fixes: tuple[Fix, ...] = self._run(spec).fixes if segments else ()
        return Replay(
            session_id=session_id,
            level_id=session.level_id,
            maps=maps,
            maps_then=session.maps,
            method=session.method,
            fixes=fixes,
            comparison=compare_fixes([position.fix for position in told], fixes),
        )

    def _run(self, spec: ReplaySpec) -> ReplayResult:
        affinity = spec.maps[0].hash
        try:
            return self._executor.submit(self._task, spec, affinity=affinity).result()
        except WorkerLostError:
            # once more on another worker: another session's crash is not this caller's fault
            return self._executor.submit(self._task, spec, affinity=affinity).result()


def _maps(uow: UnitOfWork, session: Session, map_id: str | None, map_ids: Sequence[str]) -> tuple[LevelMap, ...]:
    """Maps to replay on; InvalidError for maps of elsewhere, and for those that the session's method cannot use."""
    named = named_maps(map_id, map_ids)
    if named:
        chosen = chosen_maps(uow, session.venue_id, named)
        _check_level(session, chosen, named)
        maps = with_maps(uow, session.maps, chosen)
    else:
        venue_id = session.venue_id if session.level_id is None else None
        maps = choose_place(uow, session.level_id, venue_id, None).maps
    try:
        method_for(uow, Place(session.venue_id, session.level_id, maps), session.method, session.prior)
    except InvalidError as error:
        remedy = f"name maps that the session's method, {session.method}, can use"
        raise InvalidError(named[0].field if named else "map_ids", error.message, remedy) from error
    return maps


def _check_level(session: Session, chosen: dict[str, str], named: Sequence[NamedMap]) -> None:
    if session.level_id is None:
        return
    for level_id, one in zip(chosen, named, strict=True):
        if level_id != session.level_id:
            remedy = f"the session is on one level: name a map of level {session.level_id}"
            raise InvalidError(one.field, f"map {one.map_id} is of another level", remedy)
