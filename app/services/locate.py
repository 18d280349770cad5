"""One-shot location: a segment in, a trajectory out, nothing stored."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace

from app.engine.types import ImuSamples, Prior, RadioScans, Segment
from app.services.base import Service
from app.services.clock import Clock
from app.services.ids import seed_of
from app.services.map_refs import MapRefs
from app.services.methods import MethodCheck, check_method
from app.services.ports import Executor, MapCache, UnitOfWorkFactory, WorkerLostError
from app.services.records import Located
from app.services.sessions import choose_map
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
        level_id: str,
        method: str,
        parameters: Mapping[str, object],
        prior: Prior | None,
        samples: ImuSamples,
        *,
        wifi: RadioScans | None = None,
        map_id: str | None = None,
    ) -> Located:
        """Locate the samples on the level; the same request gives the same answer."""
        self._check(method, parameters)
        with self._uow() as uow:
            chosen = choose_map(uow, level_id, map_id)
        ref = self._refs.ref(chosen)
        spec = LocateSpec(
            method=method,
            parameters=dict(parameters),
            prior=Prior(level_id) if prior is None else replace(prior, level_id=level_id),
            seed=seed_of(hashlib.sha256(samples.t.tobytes() + samples.mag.tobytes()).hexdigest()),
            state=None,
            segment=Segment(samples, wifi),
            maps=(ref,),
        )
        return Located(fixes=self._run(spec).fixes, map_id=chosen, method=method)

    def _run(self, spec: LocateSpec) -> LocateResult:
        affinity = spec.maps[0].hash
        try:
            return self._executor.submit(self._task, spec, affinity=affinity).result()
        except WorkerLostError:
            # once more on another worker: another session's crash is not this caller's fault
            return self._executor.submit(self._task, spec, affinity=affinity).result()
