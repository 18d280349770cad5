"""Small hand-made values for tests: samples, maps, fixes, jobs, and a service over a real database file."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from app.api.checks import Checks
from app.engine.types import (
    DeviceCalibration,
    Evidence,
    EvidenceSource,
    FeatureSet,
    Fix,
    FixKind,
    GridMap,
    ImuSamples,
    MapBuild,
    MapBuildSettings,
    PressureReadings,
    Progress,
    RadioMap,
    RadioScans,
    RouteLines,
    SourceKind,
    SpeedReadings,
    Status,
    StepCounts,
    TrackerState,
    WalkReport,
    Waypoints,
)
from app.services.aids import NO_AIDS, Aids, GnssReadings
from app.services.container import Services, build_services
from app.services.errors import InvalidError
from app.services.ports import WorkerLostError
from app.services.records import (
    Job,
    JobKind,
    JobState,
    Level,
    NewBuild,
    NewSegment,
    NewWalk,
    Session,
    VenueKind,
)
from app.services.tasks import BuildResult, LocateResult, LocateSpec, ReplayResult, ReplaySpec, SmoothResult, SmoothSpec
from app.storage import Database, FileMapCache
from app.workers.live import SessionHub

Spec = TypeVar("Spec")
Result = TypeVar("Result")

START = datetime(2026, 11, 22, 8, 0, tzinfo=UTC)
T0 = 1_790_000_000.0
SEGMENT_S = 5.0
RATE_HZ = 50.0


class SteppingClock:
    """A clock that goes on by a millisecond each time it is read."""

    def __init__(self, start: datetime = START) -> None:
        self.now = start

    def __call__(self) -> datetime:
        self.now += timedelta(milliseconds=1)
        return self.now


@dataclass
class RecordingListener:
    """Remembers what it was told."""

    queued: list[Job] = field(default_factory=list)
    finished: list[Job] = field(default_factory=list)

    def job_queued(self, job: Job) -> None:
        self.queued.append(job)

    def job_finished(self, job: Job) -> None:
        self.finished.append(job)


class CallingExecutor:
    """Runs tasks in the caller."""

    def submit(
        self,
        task: Callable[[Spec, Progress], Result],
        spec: Spec,
        *,
        affinity: str = "",
        on_progress: Progress | None = None,
    ) -> Future[Result]:
        future: Future[Result] = Future()
        try:
            future.set_result(task(spec, on_progress or (lambda fraction, text: None)))
        except WorkerLostError as error:
            future.set_exception(error)
        return future

    def close(self) -> None:
        pass


def samples(n: int = 250, *, t0: float = T0, rate_hz: float = RATE_HZ, seed: int = 0) -> ImuSamples:
    """Samples as a phone sends them: float32 values on Unix milliseconds."""
    rng = np.random.default_rng(seed)
    t_ms = np.round(t0 * 1000 + np.arange(n) * 1000 / rate_hz)
    return ImuSamples(
        t=t_ms / 1000,
        mag=_sensor(rng, n, (10.0, 20.0, -40.0), 3.0),
        acc=_sensor(rng, n, (0.0, 0.0, 9.81), 1.0),
        gyro=_sensor(rng, n, (0.0, 0.0, 0.0), 0.3),
    )


def _sensor(rng: np.random.Generator, n: int, mean: tuple[float, float, float], sd: float) -> np.ndarray:
    return rng.normal(mean, sd, size=(n, 3)).astype(np.float32).astype(np.float64)


def scans(n: int = 6, *, t0: float = T0) -> RadioScans:
    """Radio scans in which each access point comes twice."""
    address = tuple(f"02:00:00:00:00:{i % 3:02x}" for i in range(n))
    return RadioScans(t=t0 + np.linspace(0.0, 1.5, n), address=address, rssi=np.linspace(-40.0, -60.0, n))


def all_aids(*, t0: float = T0) -> Aids:
    """Every aid that may come with samples that begin at ``t0``: values as the API takes them."""
    t = t0 + np.array([0.25, 1.5, 4.125])
    wide = {name: getattr(scans(t0=t0), name) for name in ("t", "address", "rssi")}
    return Aids(
        wifi=RadioScans(**wide),
        ble=RadioScans(
            t, ("c0:ff:ee:00:00:01", "fda50693-10-7", "c0:ff:ee:00:00:01"), np.array([-70.5, -80.0, -71.25])
        ),
        gnss=GnssReadings(
            t,
            np.array([48.1507123456, 48.1508, 48.15091]),
            np.array([11.5691, 11.5692, 11.56930001]),
            _f32(4.1, 12.7, 8.0),
        ),
        pressure=PressureReadings(t, _f32(953.21, 953.19, 953.3)),
        speed=SpeedReadings(t, _f32(1.31, -0.2, 0.0)),
        steps=StepCounts(t, np.array([5120.0, 5120.0, 5126.0])),
    )


def _f32(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float32).astype(np.float64)


def calibration(offset: float = 3.0, sd: float = 1.5, stride: float = 1.05) -> DeviceCalibration:
    """What a session might have learned."""
    iron, iron_sd = (0.03, -0.05, 0.01, 0.02, -0.04, 0.0), (0.015, 0.014, 0.035, 0.012, 0.013, 0.013)
    return DeviceCalibration((offset, -offset, offset / 2), (sd, sd, 2 * sd), stride, 0.05, iron, iron_sd)


def new_segment(seq: int = 0, *, n: int = 250, seed: int | None = None, aids: Aids = NO_AIDS) -> NewSegment:
    """Segment ``seq`` of a walk in 5-s segments; another seed gives other content."""
    chunk = samples(n, t0=T0 + seq * SEGMENT_S, seed=seq if seed is None else seed)
    return NewSegment(seq, chunk, hash_of(chunk), aids)


def hash_of(chunk: ImuSamples) -> str:
    """Content hash of samples."""
    return hashlib.sha256(chunk.t.tobytes() + chunk.mag.tobytes()).hexdigest()


def new_walk(name: str = "walk", *, n: int = 500, seed: int = 0, wifi: RadioScans | None = None) -> NewWalk:
    """A survey walk along two legs of 3 and 4 metres."""
    chunk = samples(n, seed=seed)
    waypoints = Waypoints(
        t=np.linspace(chunk.t[0], chunk.t[-1], 3), x=np.array([0.0, 3.0, 3.0]), y=np.array([1.0, 1.0, 5.0])
    )
    return NewWalk(name, chunk, waypoints, hash_of(chunk), wifi)


def radio_map(n: int = 5, *, rows: int = 12, columns: int = 20, seed: int = 0) -> RadioMap:
    """A radio layer of ``n`` transmitters."""
    rng = np.random.default_rng(seed)
    shape = (n, rows, columns)
    return RadioMap(
        x0=-4.0,
        y0=2.0,
        cell_m=2.0,
        addresses=tuple(f"02:00:00:00:{i // 256:02x}:{i % 256:02x}" for i in range(n)),
        mean=rng.integers(-100, -40, shape).astype(np.int8),
        sd=rng.integers(20, 120, shape).astype(np.uint8),
        seen=rng.integers(0, 256, shape).astype(np.uint8),
    )


def grid_map(
    level_id: str = "lvl",
    *,
    rows: int = 70,
    columns: int = 130,
    seed: int = 0,
    features: FeatureSet = FeatureSet.HV,
    plan: bool = False,
    radio: RadioMap | None = None,
    routes: RouteLines | None = None,
) -> GridMap:
    """A map of more than one tile; its last row is unmapped."""
    rng = np.random.default_rng(seed)
    k = len(features.channels)
    support = rng.uniform(0, 1.5, (rows, columns)).astype(np.float32)
    support[-1] = 5.0
    return GridMap(
        level_id=level_id,
        features=features,
        x0=-3.5,
        y0=2.25,
        cell_m=0.5,
        mean=rng.normal(40, 8, (k, rows, columns)).astype(np.float32),
        sd=rng.uniform(0.5, 8, (k, rows, columns)).astype(np.float32),
        support=support,
        mapped_m=1.5,
        noise_sd=tuple(0.75 + 0.1 * i for i in range(k)),
        obstacle=rng.uniform(0, 2, (rows, columns)).astype(np.float32) if plan else None,
        radio=radio,
        routes=routes,
    )


def vector_plan() -> bytes:
    """A floor of one rectangle with one room in it, GeoJSON in level metres."""
    floor = [[-3.5, 2.25], [61.0, 2.25], [61.0, 36.75], [-3.5, 36.75], [-3.5, 2.25]]
    room = [[5.0, 5.0], [9.0, 5.0], [9.0, 8.0], [5.0, 5.0]]
    features = [
        {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
        for ring in (floor, room)
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


def map_build(
    level_id: str = "lvl",
    *,
    seed: int = 0,
    walk_ids: Sequence[str] = ("wlk_1", "wlk_2"),
    plan: bool = False,
    radio: RadioMap | None = None,
    strides: Mapping[str, float | None] | None = None,
    features: FeatureSet = FeatureSet.HV,
) -> MapBuild:
    """A finished build whose last walk was rejected; ``strides`` are the stride scales by walk, walks of their own."""
    reports = tuple(
        WalkReport(walk_id, 120, 80.0, (0.5, -1.0, 2.0), 0.9, "moved" if walk_id == walk_ids[-1] else None)
        for walk_id in walk_ids
    )
    reports += tuple(
        WalkReport(walk_id, 120, 80.0, (0.5, -1.0, 2.0), 0.9, stride_scale=scale)
        for walk_id, scale in (strides or {}).items()
    )
    built, channels = grid_map(level_id, seed=seed, plan=plan, radio=radio, features=features), len(features.channels)
    parts = [
        Evidence.of(
            features, EvidenceSource(one.walk_id, SourceKind.SURVEY), np.full((3, 2), i), np.ones((3, channels))
        )
        for i, one in enumerate(reports)
        if one.rejected is None
    ]
    evidence = Evidence.joined(parts) if parts else Evidence.empty(built.features)
    level = {"mean": [20.0, 40.0, 30.0][:channels], "sd": [5.0, 6.0, 7.0][:channels]}
    model = {"level": level, "covariance": {"length_m": 5.0}}
    return MapBuild(built, reports, 12_345, 2.5, (8.0, 7.5), evidence, model)


def fix(
    t: float = T0, *, level_id: str = "lvl", x: float = 1.0, y: float = 2.0, kind: FixKind = FixKind.FILTERED
) -> Fix:
    """An ordinary fix."""
    return Fix(t, level_id, x, y, 0.5, 0.1, 0.4, 0.3, Status.OK, 0.9, sure=True, kind=kind)


def locate_result(
    seq: int = 0,
    *,
    n_fixes: int = 3,
    n_lagged: int = 0,
    level_id: str = "lvl",
    payload: bytes | None = None,
    learned: DeviceCalibration | None = None,
) -> LocateResult:
    """What a worker might answer to segment ``seq``."""
    t0 = T0 + seq * SEGMENT_S
    fixes = tuple(fix(t0 + i, level_id=level_id, x=seq + i / 10) for i in range(n_fixes))
    back = t0 - SEGMENT_S
    lagged = tuple(fix(back + i, level_id=level_id, x=seq - i, kind=FixKind.FIXED_LAG) for i in range(n_lagged))
    state = TrackerState("particle", b"after %d" % seq if payload is None else payload, t0 + SEGMENT_S)
    return LocateResult(state, fixes, cpu_s=0.01, calibration=learned, lagged=lagged)


def queued_job(id_: str = "job_1", *, key: str = "ses_1", kind: JobKind = JobKind.LOCATE_SEGMENT, seq: int = 0) -> Job:
    """A job that waits."""
    subject: Mapping[str, str | int] = {"session_id": key, "seq": seq}
    return Job(id_, kind, JobState.QUEUED, key, subject, 0, 0.0, "", {}, None, START, None, None)


def answer_locate(spec: LocateSpec, progress: Progress) -> LocateResult:
    """A locate task without an engine: three fixes that carry the spec's seed, and two of them again one later."""
    chunk = spec.segment.samples
    level_id = spec.prior.level_id or spec.maps[0].level_id
    fixes = tuple(fix(float(t), level_id=level_id, x=spec.seed % 1000) for t in chunk.t[:3])
    told = json.loads(spec.state.payload) if spec.state else []
    lagged = tuple(fix(t, level_id=level_id, x=spec.seed % 1000 + 0.5, kind=FixKind.FIXED_LAG) for t in told)
    state = TrackerState(spec.method, json.dumps([f.t for f in fixes[:2]]).encode(), float(chunk.t[-1]))
    return LocateResult(state, fixes, cpu_s=0.0, lagged=lagged)


def answer_smooth(spec: SmoothSpec, progress: Progress) -> SmoothResult:
    """A smoothing task without an engine: one fix per segment that carries the spec's seed."""
    level_id = spec.prior.level_id or spec.maps[0].level_id
    fixes = tuple(
        fix(float(s.samples.t[0]), level_id=level_id, x=spec.seed % 1000, kind=FixKind.SMOOTHED) for s in spec.segments
    )
    return SmoothResult(fixes, cpu_s=0.0)


def answer_replay(spec: ReplaySpec, progress: Progress) -> ReplayResult:
    """A replay task without an engine: what ``answer_locate`` tells of each segment."""
    state, fixes = None, []
    for segment in spec.segments:
        part = LocateSpec(spec.method, spec.parameters, spec.prior, spec.seed, state, segment, spec.maps)
        result = answer_locate(part, progress)
        state = result.state
        fixes += result.fixes
    return ReplayResult(tuple(fixes), cpu_s=0.0)


def check_known_method(method: str, parameters: Mapping[str, object]) -> None:
    """A method check without an engine."""
    if method not in ("particle", "dead_reckoning", "auto"):
        raise InvalidError("method", f"{method!r} is unknown", "choose one of dead_reckoning, particle")
    for name in parameters.keys() - {"n_particles"}:
        raise InvalidError(f"parameters.{name}", "is unknown", "see GET /v1/methods/particle")


@cache
def empty_database() -> bytes:
    """A migrated database file: migrating anew takes longer than most tests."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database.at(Path(folder) / "empty.db")
        database.migrate()
        database.close()  # the last connection to leave moves the log into the file
        return (Path(folder) / "empty.db").read_bytes()


def database_at(path: Path) -> Database:
    """Open a database file, migrated if it is new."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(empty_database())
    return Database.at(path)


@dataclass
class World:
    """All services over a database file, and what tests look at beside them."""

    database: Database
    cache: FileMapCache
    clock: SteppingClock
    listener: RecordingListener
    services: Services

    @classmethod
    def at(cls, folder: Path, *, max_queued: int = 1000) -> World:
        """Open (or create) the world in a folder; opening it again is what a restart does."""
        path = folder / "isodyn.db"
        database = database_at(path)
        map_cache = FileMapCache(folder / "maps")
        clock, listener = SteppingClock(), RecordingListener()
        services = build_services(
            uow=database,
            clock=clock,
            executor=CallingExecutor(),
            cache=map_cache,
            listener=listener,
            watchers=SessionHub(),
            checks=Checks(),
            locate_task=answer_locate,
            smooth_task=answer_smooth,
            replay_task=answer_replay,
            max_queued=max_queued,
            check=check_known_method,
        )
        return cls(database, map_cache, clock, listener, services)

    def close(self) -> None:
        self.database.close()

    def level(self) -> Level:
        """A level without a map."""
        venue = self.services.venues.create("House", VenueKind.INDOOR, None)
        return self.services.venues.create_level(venue.id, "1", 0, (-3.5, 2.25, 61.0, 36.75))

    def surveyed_level(self) -> Level:
        """A level with one survey walk and no map."""
        level = self.level()
        survey = self.services.surveys.create(level.id, "survey")
        self.services.surveys.add_walk(survey.id, new_walk())
        return level

    def mapped_level(self, *, seed: int = 0) -> Level:
        """A level with a current map."""
        level = self.surveyed_level()
        self.build(level.id, seed=seed)
        return self.services.venues.get_level(level.id)

    def venue(self, *ordinals: int, unmapped: int | None = None) -> tuple[str, list[Level]]:
        """A venue with a mapped level for each ordinal (and one without a map), created in this order."""
        venue_id = self.services.venues.create("Tower", VenueKind.INDOOR, None).id
        levels = []
        for ordinal in (*ordinals, *(() if unmapped is None else (unmapped,))):
            level = self.services.venues.create_level(venue_id, str(ordinal), ordinal, (-3.5, 2.25, 61.0, 36.75))
            if ordinal != unmapped:
                survey = self.services.surveys.create(level.id, "survey")
                self.services.surveys.add_walk(survey.id, new_walk())
                self.build(level.id, seed=ordinal + 100)
                levels.append(self.services.venues.get_level(level.id))
        return venue_id, levels

    def build(
        self,
        level_id: str,
        *,
        seed: int = 0,
        radio: RadioMap | None = None,
        strides: Mapping[str, float | None] | None = None,
        align: bool = True,
    ) -> Job:
        """Request a map and complete the job by hand."""
        requested = self.services.maps.request_build(NewBuild(level_id, MapBuildSettings(align=align)))
        (job,) = self.services.processing.claim(1, JobKind.BUILD_MAP)
        assert job.id == requested.id
        build = map_build(level_id, seed=seed, radio=radio, strides=strides)
        return self.services.processing.complete_build(job, BuildResult(build, 0.5), 0.6)

    def session(self, level_id: str | None = None) -> Session:
        """An open session, on a new mapped level unless one is named."""
        level_id = self.mapped_level().id if level_id is None else level_id
        return self.services.sessions.create(level_id, "particle", {})
