"""What workers run. A task gets a spec and returns a result; it sees no database, no service, no network.

A task is a small frozen value that names how cached maps are opened (workers know ports, not storage); it pickles, and
its :meth:`__call__` is what an executor runs.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock

from app.engine.errors import InputError, MapError
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.registry import create_tracker
from app.engine.localization.smoothing import smooth_session
from app.engine.mapping import MapModel, build_map, update_map
from app.engine.mapping.crowd.contribution import contribute
from app.engine.mapping.crowd.weigh import Weighed, weigh
from app.engine.types import Evidence, EvidenceSource, Fix, GridMap, MapBuild, Progress, SourceKind
from app.services.ports import Checkpoints
from app.services.tasks import (
    BuildResult,
    BuildSpec,
    ContributeResult,
    ContributeSpec,
    LocateResult,
    LocateSpec,
    MapRef,
    Offer,
    ReplayResult,
    ReplaySpec,
    SmoothResult,
    SmoothSpec,
    UpdateBase,
)
from app.workers.placing import placed_once

MapOpener = Callable[[Path], GridMap]


class OpenMaps:
    """Maps a process holds open, by content hash, least recently used first out."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._maps: OrderedDict[str, GridMap] = OrderedDict()

    def __len__(self) -> int:
        return len(self._maps)

    def get(self, ref: MapRef, open_map: MapOpener, keep: int) -> GridMap:
        """Return the map, opened with ``open_map`` unless it is among the last ``keep`` used."""
        with self._lock:
            grid_map = self._maps.get(ref.hash)
            if grid_map is None:
                grid_map = self._maps[ref.hash] = open_map(ref.path)
            self._maps.move_to_end(ref.hash)
            while len(self._maps) > keep:
                self._maps.popitem(last=False)
        return grid_map


# One a process: content-hashed and immutable, so it cannot matter who shares it.
_OPEN_MAPS = OpenMaps()


@dataclass(frozen=True, slots=True)
class SpecMaps:
    """The maps of one spec as the engine's map source."""

    refs: Sequence[MapRef]
    open_map: MapOpener
    keep: int

    def level_ids(self) -> tuple[str, ...]:
        """Levels the session may be on."""
        return tuple(ref.level_id for ref in self.refs)

    def grid_map(self, level_id: str) -> GridMap:
        """Map of one level."""
        for ref in self.refs:
            if ref.level_id == level_id:
                return _OPEN_MAPS.get(ref, self.open_map, max(self.keep, len(self.refs)))
        raise MapError(f"no map of level {level_id} came with the task")


@dataclass(frozen=True, slots=True)
class LocateSegment:
    """Takes one segment of a session, or a single one without a session."""

    open_map: MapOpener
    keep_maps: int = 16

    def __call__(self, spec: LocateSpec, progress: Progress) -> LocateResult:  # noqa: ARG002 - over too soon to tell
        """Advance the tracker by the segment; the same spec always gives the same result."""
        started = time.thread_time()
        tracker = create_tracker(spec.method, spec.parameters)
        state = tracker.start(spec.prior, seed=spec.seed) if spec.state is None else spec.state
        answer = tracker.answer(state, spec.segment, SpecMaps(spec.maps, self.open_map, self.keep_maps))
        learned = tracker.learned(answer.state)
        cpu_s = time.thread_time() - started
        return LocateResult(answer.state, answer.fixes, cpu_s=cpu_s, calibration=learned, lagged=answer.lagged)


@dataclass(frozen=True, slots=True)
class SmoothSession:
    """Smooths a session's trajectory over all its segments."""

    open_map: MapOpener
    keep_maps: int = 16

    def __call__(self, spec: SmoothSpec, progress: Progress) -> SmoothResult:  # noqa: ARG002 - somebody waits anyway
        """Go through all segments and back; the same spec always gives the same result."""
        started = time.thread_time()
        tracker = create_tracker(spec.method, spec.parameters)
        if not isinstance(tracker, ParticleTracker):
            raise InputError("method", f"{spec.method!r} has no smoother; only {ParticleTracker.method!r} has one")
        maps = SpecMaps(spec.maps, self.open_map, self.keep_maps)
        fixes = smooth_session(tracker, spec.prior, spec.segments, maps, seed=spec.seed)
        return SmoothResult(fixes=fixes, cpu_s=time.thread_time() - started)


@dataclass(frozen=True, slots=True)
class ContributeSession:
    """Smooths a session and takes from it what the maps of its levels can use."""

    open_map: MapOpener
    keep_maps: int = 16

    def __call__(self, spec: ContributeSpec, progress: Progress) -> ContributeResult:
        """One offer for each level the session was sure to be on; the same spec always gives the same result."""
        started = time.thread_time()
        fixes = SmoothSession(self.open_map, self.keep_maps)(spec.smooth, progress).fixes
        maps = SpecMaps(spec.smooth.maps, self.open_map, self.keep_maps)
        told = {fix.level_id for fix in fixes}
        levels = [level_id for level_id in maps.level_ids() if level_id in told] or list(maps.level_ids()[:1])
        offers = tuple(self._offer(spec, i, fixes, maps.grid_map(level_id)) for i, level_id in enumerate(levels))
        return ContributeResult(offers, cpu_s=time.thread_time() - started)

    @staticmethod
    def _offer(spec: ContributeSpec, index: int, fixes: Sequence[Fix], grid_map: GridMap) -> Offer:
        segments = spec.smooth.segments
        source = EvidenceSource(
            # a session on several levels offers to each map on its own
            id=spec.contribution_id if index == 0 else f"{spec.contribution_id}-{index}",
            kind=SourceKind.SESSION,
            contributor=spec.contributor,
            device=spec.device,
            t=float(segments[0].samples.t[0]) if segments else 0.0,
        )
        offered = contribute(source, fixes, segments, grid_map, calibration=spec.calibration)
        return Offer(grid_map.level_id, offered.evidence, offered.steps, offered.kept, offered.reasons())


@dataclass(frozen=True, slots=True)
class ReplaySession:
    """Takes all segments of a session once more, as they were taken one after the other."""

    open_map: MapOpener
    keep_maps: int = 16

    def __call__(self, spec: ReplaySpec, progress: Progress) -> ReplayResult:  # noqa: ARG002 - somebody waits anyway
        """Go from the prior through all segments; on the maps of then, the fixes of then."""
        started = time.thread_time()
        tracker = create_tracker(spec.method, spec.parameters)
        maps = SpecMaps(spec.maps, self.open_map, self.keep_maps)
        state = tracker.start(spec.prior, seed=spec.seed)
        fixes: list[Fix] = []
        for segment in spec.segments:
            answer = tracker.answer(state, segment, maps)
            state = answer.state
            fixes += answer.fixes
        return ReplayResult(fixes=tuple(fixes), cpu_s=time.thread_time() - started)


@dataclass(frozen=True, slots=True)
class BuildMap:
    """Builds a level's map from its survey walks, or brings one up to date."""

    open_map: MapOpener
    checkpoints: Checkpoints | None = None
    """Where a build goes on if it was interrupted; None: from the start."""

    def __call__(self, spec: BuildSpec, progress: Progress) -> BuildResult:
        """Build; the same spec always gives the same result."""
        started = time.thread_time()
        if spec.base is None:
            result = BuildResult(_built(spec, self.checkpoints, progress), cpu_s=0.0)
        else:
            result = _updated(spec, spec.base, self.open_map, progress)
        return replace(result, cpu_s=time.thread_time() - started)


def _built(spec: BuildSpec, checkpoints: Checkpoints | None, progress: Progress) -> MapBuild:
    walks = [new.walk for new in spec.walks]
    if checkpoints is None:
        build = build_map(spec.level_id, walks, spec.settings, progress, plan=spec.plan)
    else:
        with placed_once(checkpoints, walks, align=spec.settings.align, progress=progress) as placing:
            build = build_map(spec.level_id, walks, spec.settings, progress, plan=spec.plan, placing=placing)
    owners = {new.walk.walk_id: new for new in spec.walks}
    sources = tuple(
        replace(source, contributor=owners[source.id].contributor, device=owners[source.id].device)
        for source in build.evidence.sources
    )
    return replace(build, evidence=replace(build.evidence, sources=sources))


def _updated(spec: BuildSpec, base: UpdateBase, open_map: MapOpener, progress: Progress) -> BuildResult:
    model = MapModel.from_values(base.model)
    found: list[Weighed] = []

    def weighed(evidence: Evidence) -> Evidence:
        found.append(weigh(evidence, model=model, reputation=base.reputation))
        return found[-1].evidence

    update = update_map(
        open_map(base.map.path),
        base.evidence,
        model,
        walks=spec.walks,
        contributed=base.contributed,
        removed=base.removed,
        weigh=weighed,
        align=bool(base.model.get("align", True)),
        progress=progress,
    )
    build = MapBuild(
        grid_map=update.grid_map,
        walks=update.walks,
        n_samples=len(update.evidence) - len(base.evidence),
        length_scale_m=model.covariance.length_m,
        field_sd=tuple(float(sd) for sd in model.level.sd),
        evidence=update.evidence,
        model=dict(base.model),
    )
    verdicts = tuple(verdict for one in found for verdict in one.verdicts)
    return BuildResult(build, 0.0, base, verdicts, tuple(event for one in found for event in one.changes))
