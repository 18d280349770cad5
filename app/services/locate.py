"""One-shot location: a segment in, a trajectory out, nothing stored."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from app.engine.types import ImuSamples, Prior
from app.services.aids import NO_AIDS, Aids, Recording
from app.services.base import Service
from app.services.clock import Clock
from app.services.ids import seed_of
from app.services.level_frame import in_level_frame
from app.services.map_refs import MapRefs
from app.services.methods import MethodCheck, check_method, method_for
from app.services.places import choose_place
from app.services.ports import Executor, MapCache, UnitOfWorkFactory, WorkerLostError
from app.services.records import Located
from app.services.tasks import LocateResult, LocateSpec, LocateTask


class LocateService(Service):
    """Locates a segment without a session. Blocks until a worker has answered."""

    def __init__(
        self,
        *,
        uow: UnitOfWorkFactory,
        clock: Clock,
        executor: Executor,
        cache: MapCache,
        task: LocateTask,
        check: MethodCheck = check_method,
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._executor = executor
        self._refs = MapRefs(uow=uow, cache=cache)
        self._task = task
        self._check = check

    def locate(
        self,
        level_id: str | None,
        method: str,
        parameters: Mapping[str, object],
        prior: Prior | None,
        samples: ImuSamples,
        *,
        venue_id: str | None = None,
        aids: Aids = NO_AIDS,
        map_id: str | None = None,
    ) -> Located:
        """Locate the samples on the level, or on any level of the venue; the same request gives the same answer."""
        self._check(method, parameters)
        with self._uow() as uow:
            place = choose_place(uow, level_id, venue_id, map_id)
            odometry = aids.speed is not None or aids.steps is not None
            chosen = method_for(uow, place, method, prior, odometry=odometry)
            (segment,) = in_level_frame(uow, place.venue_id, [Recording(samples, aids)])
        spec = LocateSpec(
            method=chosen.name,
            parameters=dict(parameters),
            prior=place.prior(prior),
            seed=seed_of(hashlib.sha256(samples.t.tobytes() + samples.mag.tobytes()).hexdigest()),
            state=None,
            segment=segment,
            maps=self._refs.refs(place.maps),
        )
        result = self._run(spec)
        return Located(
            fixes=result.fixes,
            lagged=result.lagged,
            level_id=place.level_id,
            maps=place.maps,
            method=chosen.name,
            method_reason=chosen.reason,
        )

    def _run(self, spec: LocateSpec) -> LocateResult:
        affinity = spec.maps[0].hash
        try:
            return self._executor.submit(self._task, spec, affinity=affinity).result()
        except WorkerLostError:
            # once more on another worker: another session's crash is not this caller's fault
            return self._executor.submit(self._task, spec, affinity=affinity).result()
