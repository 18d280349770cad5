"""Smoothed trajectories: all segments of a session at once, after the fact; nothing stored."""

from __future__ import annotations

from app.engine.localization.particle import ParticleTracker
from app.services.base import Service
from app.services.clock import Clock
from app.services.errors import NotSmoothableError
from app.services.ids import seed_of
from app.services.map_refs import MapRefs
from app.services.ports import Executor, MapCache, UnitOfWorkFactory, WorkerLostError
from app.services.records import Session, Trajectory
from app.services.stored_segments import load_segments
from app.services.tasks import SmoothResult, SmoothSpec, SmoothTask


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
            check_smoothable(session)
            # the smoother remembers all particles of every step: what it needs grows with the time walked
            segments = load_segments(uow, session, NotSmoothableError)
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


def check_smoothable(session: Session) -> None:
    """Refuse methods that cannot be smoothed."""
    if session.method != ParticleTracker.method:
        raise NotSmoothableError(
            "method",
            f"the method {session.method!r} of this session has no smoother",
            f"read its positions, or open sessions with the method {ParticleTracker.method!r}",
        )
