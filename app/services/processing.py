"""What the runner needs: claims, specs for workers, and results stored exactly once in effect."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import datetime

from app.engine.mapping import FloorPlan, NewWalk
from app.engine.types import DeviceCalibration, Evidence, Fix, SurveyWalk
from app.services.base import Service
from app.services.clock import Clock
from app.services.device_memory import remember_survey
from app.services.errors import ConflictError, InvalidError, NotSmoothableError
from app.services.geofencing import watch_fixes
from app.services.ground_truth import settle
from app.services.ids import new_id, seed_of
from app.services.jobs import record_failure
from app.services.level_frame import in_level_frame
from app.services.map_changes import box_of, changes_of, is_overtaken, queue_update
from app.services.map_refs import MapRefs
from app.services.ports import MapCache, UnitOfWork, UnitOfWorkFactory
from app.services.publishing import BUILT, UPDATED, publish
from app.services.records import (
    Carrier,
    Job,
    JobKind,
    JobState,
    MapInfo,
    MapKind,
    NewBuild,
    SessionStatus,
)
from app.services.reviews import contribution_of, news, reputation_of, verdict_of, whole_verdicts
from app.services.session_end import end_if_over
from app.services.stored_segments import load_segments
from app.services.tasks import (
    BuildResult,
    BuildSpec,
    ContributeResult,
    ContributeSpec,
    LocateResult,
    LocateSpec,
    SmoothSpec,
    UpdateBase,
)
from app.services.trajectories import check_smoothable

Outcome = dict[str, str | int | float]
MAX_ATTEMPTS = 3
_PROGRESS_STEP = 0.01


class ProcessingService(Service):
    """The life of jobs between queue and result.

    A claim is a promise that may be broken by a crash, so every way out of ``running`` checks in its own
    transaction that the job still runs *and* that it is the same attempt: of two answers for one job, one counts.
    """

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache) -> None:
        super().__init__(uow=uow, clock=clock)
        self._cache = cache
        self._refs = MapRefs(uow=uow, cache=cache)
        self._shown: dict[str, float] = {}

    def recover(self) -> int:
        """At start-up: queue again what was running when the process died; returns how many."""
        with self._uow(write=True) as uow:
            return uow.jobs.requeue_running()

    def claim(self, limit: int, kind: JobKind | None = None) -> Sequence[Job]:
        """Take up to ``limit`` jobs (of one kind, if named) to run now: oldest first, one per session or level."""
        with self._uow(write=True) as uow:
            return uow.jobs.claim(limit=limit, now=self._clock(), kind=kind)

    def locate_spec(self, job: Job) -> LocateSpec:
        """What a worker needs to take the job's segment."""
        session_id, seq = _segment_of(job)
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            (segment,) = in_level_frame(uow, session.venue_id, [uow.sessions.load_segment(session_id, seq)])
            state = uow.sessions.state(session_id)
        return LocateSpec(
            method=session.method,
            parameters=session.parameters,
            prior=session.prior,
            seed=seed_of(session_id),
            state=state,
            segment=segment,
            maps=self._refs.refs(session.maps),
        )

    def build_spec(self, job: Job) -> BuildSpec:
        """What a worker needs to build the job's map, or to bring the current one up to date."""
        with self._uow() as uow:
            build = uow.maps.get_build(job.id)
            if build.mode is MapKind.UPDATE:
                if is_overtaken(uow, job):
                    raise ConflictError("an older map was published since this update was queued; ask for it again")
                return self._update_spec(uow, build)
            walks = uow.surveys.load_walks(build.level_id, build.survey_ids)
            carriers = uow.surveys.carriers(build.level_id)
            drawn = uow.levels.vector_plan(build.level_id)
        plan = None if drawn is None else FloorPlan.from_geojson(json.loads(drawn))
        return BuildSpec(level_id=build.level_id, walks=_owned(walks, carriers), settings=build.settings, plan=plan)

    def _update_spec(self, uow: UnitOfWork, build: NewBuild) -> BuildSpec:
        map_id = uow.levels.get(build.level_id).current_map_id
        info = None if map_id is None else uow.maps.get(map_id)
        if info is None or info.model is None:
            raise InvalidError("level_id", "has no map that can be updated", "build a map of the level first")
        changes = changes_of(uow, build, info.id)
        walks = uow.surveys.load_walks(build.level_id, (), only=changes.walks)
        contributed = uow.contributions.load(info.features, changes.contributions) if changes.contributions else None
        box = box_of(info, walks, contributed, everything=bool(changes.removed))
        evidence = uow.maps.evidence(info.id, box)
        base = UpdateBase(
            map_id=info.id,
            map=self._refs.ref(info.id),
            evidence=evidence or Evidence.empty(info.features),
            box=box,
            model=info.model,
            removed=changes.removed,
            contributed=contributed,
            added=changes.contributions,
            reputation=reputation_of(uow.contributions.track_record(other_than=build.level_id)),
        )
        carriers = uow.surveys.carriers(build.level_id)
        return BuildSpec(level_id=build.level_id, walks=_owned(walks, carriers), settings=build.settings, base=base)

    def contribute_spec(self, job: Job) -> ContributeSpec:
        """What a worker needs to take from a session what maps can use."""
        session_id = str(job.subject["session_id"])
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            check_smoothable(session)
            segments = load_segments(uow, session, NotSmoothableError)
            learned = uow.sessions.learned(session_id)
        return ContributeSpec(
            contribution_id=new_id("ctr", self._clock()),
            contributor=session.contributor or "",
            device=session.device_id or "",
            calibration=learned or session.prior.calibration,
            smooth=SmoothSpec(
                method=session.method,
                parameters=session.parameters,
                prior=session.prior,
                seed=seed_of(session_id),
                segments=segments,
                maps=self._refs.refs(session.maps),
            ),
        )

    def complete_contribute(self, job: Job, result: ContributeResult) -> Job | None:
        """Store what the session offers to each level's map, and have these maps updated."""
        now = self._clock()
        session_id = str(job.subject["session_id"])
        outcome: Outcome = {"session_id": session_id, "n_rows": sum(len(offer.evidence) for offer in result.offers)}
        outcome["cpu_s"] = result.cpu_s
        with self._uow(write=True) as uow:
            if not uow.jobs.finish(job.id, JobState.DONE, now, result=outcome, attempts=job.attempts):
                return None
            session = uow.sessions.get(session_id)
            for offer in result.offers:
                uow.contributions.add(contribution_of(session, offer, now), offer.evidence)
                if len(offer.evidence):
                    queue_update(uow, offer.level_id, now, offered=True)
            return uow.jobs.get(job.id)

    def complete_locate(self, job: Job, result: LocateResult) -> Job | None:
        """Store fixes, new state, what was learned about the device and the job's end together.

        None if the job no longer runs in this attempt.

        A result with a value that is not finite fails the job: nobody could use it, and it must not stop the queue.
        """
        if not all(map(_is_finite, (*result.fixes, *result.lagged))):
            return self.fail(job, "the method answered with a position that is not finite")
        session_id, seq = _segment_of(job)
        now = self._clock()
        outcome: Outcome = {"session_id": session_id, "seq": seq, "n_fixes": len(result.fixes), "cpu_s": result.cpu_s}
        with self._uow(write=True) as uow:
            if not uow.jobs.finish(job.id, JobState.DONE, now, result=outcome, attempts=job.attempts):
                return None
            status = uow.sessions.record_result(
                session_id,
                seq,
                result.state,
                result.fixes,
                now,
                lagged=result.lagged,
                calibration=_usable(result.calibration),
            )
            settle(uow, session_id)
            watch_fixes(uow, session_id, seq, result.fixes, now)
            if status is SessionStatus.CLOSED:
                end_if_over(uow, session_id, now)
            return uow.jobs.get(job.id)

    def complete_build(self, job: Job, result: BuildResult, build_s: float) -> Job:
        """Store the map as the level's next version; publish it unless it is a draft. Its walks teach their devices."""
        now = self._clock()
        grid_map, base = result.build.grid_map, result.base
        with self._uow() as uow:
            # compressing takes long: not while holding the write lock
            packed = uow.maps.pack(grid_map, result.build.evidence)
        with self._uow(write=True) as uow:
            if base is not None and uow.levels.get(grid_map.level_id).current_map_id != base.map_id:
                # another version became current meanwhile: the update is done over again, on that one
                uow.jobs.requeue(job.id, attempts=job.attempts)
                return uow.jobs.get(job.id)
            info = _map_info(uow, job, result, packed.hash, build_s=build_s, now=now)
            outcome: Outcome = {"map_id": info.id, "version": info.version, "cpu_s": result.cpu_s}
            finished = uow.jobs.finish(job.id, JobState.DONE, now, result=outcome, attempts=job.attempts)
            if finished:
                order = uow.maps.get_build(job.id)
                aligned = order.settings.align if base is None else bool(base.model.get("align", True))
                remember_survey(uow, info.level_id, info.walks, now, aligned=aligned)
                uow.maps.add(info, packed, keep=None if base is None else base.box)
                uow.maps.finish_build(job.id, info.id)
                if order.publish:
                    publish(uow, info, now, key_id=order.key_id, note=BUILT if base is None else UPDATED)
                uow.contributions.decide([verdict_of(verdict) for verdict in whole_verdicts(uow, result)], now)
                uow.contributions.add_changes(news(uow, info, result.changes, now))
                if order.publish:  # a draft is no base for what comes after it
                    queue_update(uow, info.level_id, now)
            done = uow.jobs.get(job.id)
        self._shown.pop(job.id, None)
        if finished:
            self._cache.ref(info, lambda: grid_map)
        return done

    def fail(self, job: Job, error: str) -> Job:
        """Give the job up; its segment, if any, is marked and the session goes on with the state it had."""
        now = self._clock()
        self._shown.pop(job.id, None)
        with self._uow(write=True) as uow:
            failed = uow.jobs.finish(job.id, JobState.FAILED, now, error=error, attempts=job.attempts)
            stored = uow.jobs.get(job.id)
            if failed:
                record_failure(uow, stored, error)
        return stored

    def retry(self, job: Job) -> Job:
        """After its worker was lost: queue the job again, or give it up after three attempts."""
        if job.attempts >= MAX_ATTEMPTS:
            return self.fail(job, f"the worker died in each of {job.attempts} attempts")
        with self._uow(write=True) as uow:
            uow.jobs.requeue(job.id, attempts=job.attempts)
            return uow.jobs.get(job.id)

    def progress(self, job: Job, fraction: float, text: str) -> None:
        """Show how far a job is; steps below one per cent are not written."""
        if fraction - self._shown.get(job.id, -1.0) < _PROGRESS_STEP:
            return
        self._shown[job.id] = fraction
        with self._uow(write=True) as uow:
            uow.jobs.set_progress(job.id, fraction, text)


def _segment_of(job: Job) -> tuple[str, int]:
    return str(job.subject["session_id"]), int(job.subject["seq"])


def _is_finite(fix: Fix) -> bool:
    values = (fix.t, fix.x, fix.y, fix.cov_xx, fix.cov_xy, fix.cov_yy, fix.heading, fix.quality, fix.walk_on_m or 0.0)
    places = (value for h in fix.hypotheses for value in (h.x, h.y, h.cov_xx, h.cov_xy, h.cov_yy, h.weight))
    return all(map(math.isfinite, (*values, *places)))


def _usable(calibration: DeviceCalibration | None) -> DeviceCalibration | None:
    """None for a calibration that is not finite: nothing is learned from it, and the positions stand without it."""
    if calibration is None:
        return None
    spreads = (*calibration.offset_sd, calibration.stride_scale_sd, *calibration.soft_iron_sd)
    values = (*calibration.offset, calibration.stride_scale, *calibration.soft_iron, *spreads)
    return calibration if all(map(math.isfinite, values)) and min(spreads) >= 0.0 else None


def _map_info(
    uow: UnitOfWork, job: Job, result: BuildResult, content_hash: str, *, build_s: float, now: datetime
) -> MapInfo:
    build = result.build
    grid_map = build.grid_map
    level_id = str(job.subject["level_id"])
    rows, columns = grid_map.shape
    mapped = grid_map.mapped
    base, reports = result.base, build.walks
    before = None if base is None else uow.maps.get(base.map_id)
    removed = () if base is None else base.removed
    placed = sum(walk.rejected is None for walk in reports)
    return MapInfo(
        id=new_id("map", now),
        level_id=level_id,
        version=uow.maps.next_version(level_id),
        parent_id=uow.levels.get(level_id).current_map_id,
        hash=content_hash,
        features=grid_map.features,
        x0=grid_map.x0,
        y0=grid_map.y0,
        cell_m=grid_map.cell_m,
        rows=rows,
        columns=columns,
        mapped_m=grid_map.mapped_m,
        noise_sd=grid_map.noise_sd,
        mapped_share=float(mapped.mean()),
        mapped_area_m2=float(mapped.sum()) * grid_map.cell_m**2,
        n_walks=placed if before is None else before.n_walks + placed - _placed_of(uow, before.id, removed),
        n_samples=build.n_samples if before is None else before.n_samples + build.n_samples,
        length_scale_m=build.length_scale_m,
        field_sd=build.field_sd,
        walks=build.walks,
        build_s=build_s,
        created_at=now,
        has_obstacle=grid_map.obstacle is not None,
        n_transmitters=None if grid_map.radio is None else len(grid_map.radio.addresses),
        radio_cell_m=None if grid_map.radio is None else float(grid_map.radio.cell_m),
        n_routes=None if grid_map.routes is None else len(grid_map.routes.first),
        kind=MapKind.BUILD if base is None else MapKind.UPDATE,
        added=(*(report.walk_id for report in reports), *(() if base is None else base.added)),
        removed=removed,
        model=build.model,
    )


def _placed_of(uow: UnitOfWork, map_id: str, removed: Sequence[str]) -> int:
    """How many of the sources are walks that the map rests on; the others are contributions, or were left out."""
    if not removed:
        return 0
    reports = uow.maps.reports(map_id)
    return sum(one in reports and reports[one].rejected is None for one in removed)


def _owned(walks: Sequence[SurveyWalk], carriers: Mapping[str, Carrier]) -> tuple[NewWalk, ...]:
    return tuple(
        NewWalk(walk, device=carriers[walk.walk_id].device_id if walk.walk_id in carriers else "") for walk in walks
    )
