"""Smoothed trajectories: all segments of a session at once, after the fact; nothing stored."""

from __future__ import annotations

from app.engine.localization.particle import ParticleTracker
from app.engine.types import Segment
from app.services.base import Service
from app.services.clock import Clock
from app.services.errors import InvalidError, NotSmoothableError
from app.services.ids import seed_of
from app.services.level_frame import in_level_frame
from app.services.map_refs import MapRefs
from app.services.ports import Executor, MapCache, UnitOfWork, UnitOfWorkFactory, WorkerLostError
from app.services.records import JobState, Session, Trajectory
from app.services.tasks import SmoothResult, SmoothSpec, SmoothTask

MAX_SEGMENTS = 360
MAX_SPAN_S = 1800.0
"""The smoother remembers all particles of every step: what it needs grows with the time walked."""


class TrajectoryService(Service):
    """Smooths the trajectories of sessions. Blocks until a worker has answered."""

    def __init__(
        self, *, uow: UnitOfWorkFactory, clock: Clock, executor: Executor, cache: MapCache, task: SmoothTask
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._executor = executor
        self._refs = MapRefs(uow=uow, cache=cache)
        self._task = task

    def trajectory(self, session_id: str) -> Trajectory:
        """Smoothed fixes from all segments processed so far; the same segments give the same answer."""
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            check_smoothable(uow, session)
            segments = session_segments(uow, session)
        spec = SmoothSpec(
            method=session.method,
            parameters=session.parameters,
            prior=session.prior,
            seed=seed_of(session_id),
            segments=segments,
            maps=self._refs.refs(session.maps),
        )
        fixes = self._run(spec).fixes if segments else ()
        return Trajectory(
            session_id=session_id, level_id=session.level_id, maps=session.maps, method=session.method, fixes=fixes
        )

    def _run(self, spec: SmoothSpec) -> SmoothResult:
        affinity = spec.maps[0].hash
        try:
            return self._executor.submit(self._task, spec, affinity=affinity).result()
        except WorkerLostError:
            # once more on another worker: another session's crash is not this caller's fault
            return self._executor.submit(self._task, spec, affinity=affinity).result()


def session_segments(uow: UnitOfWork, session: Session) -> tuple[Segment, ...]:
    """All segments processed so far, in the level frame."""
    recordings = uow.sessions.load_segments(session.id, MAX_SEGMENTS)
    try:
        return in_level_frame(uow, session.venue_id, recordings)
    except InvalidError as error:  # the anchor was changed since: what is stored stands against it, not the request
        raise NotSmoothableError(error.field, error.message, error.remedy) from error


def check_smoothable(uow: UnitOfWork, session: Session) -> None:
    """Refuse what the smoother cannot do before any samples are read."""
    if session.method != ParticleTracker.method:
        raise NotSmoothableError(
            "method",
            f"the method {session.method!r} of this session has no smoother",
            f"read its positions, or open sessions with the method {ParticleTracker.method!r}",
        )
    remedy = f"read its positions, and open a new session every {MAX_SPAN_S / 60:.0f} minutes"
    if session.next_seq > MAX_SEGMENTS:
        raise NotSmoothableError(
            "session_id", f"{session.next_seq} segments, more than the {MAX_SEGMENTS} that are smoothed", remedy
        )
    infos = uow.sessions.list_segments(session.id, cursor=None, limit=MAX_SEGMENTS).items
    span = sum(info.t_end - info.t_start for info in infos if info.job_state is JobState.DONE)
    if span > MAX_SPAN_S:
        raise NotSmoothableError(
            "session_id", f"{span / 60:.1f} minutes of samples, more than the {MAX_SPAN_S / 60:.0f} smoothed", remedy
        )
