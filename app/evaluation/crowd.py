"""What a map gains by its users: a third of the survey, the rest of the walks as sessions, and the whole survey.

The train walks of a level are shared out by chance. A third is surveyed, waypoints and all. The others come without
their waypoints: sessions of users who opted in, each of whom began within 3 m of a known place. They are located on the
map of the third, contribute where they are sure, are weighed against one another, and the map is kriged anew; then all
of that again on the better map, each session on a map without its own fold, so that none confirms itself. Test walks
are tracked on the three maps.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.engine.calibration import unknown_device
from app.engine.errors import EngineError, InputError
from app.engine.inertial import detect_steps
from app.engine.localization import DEFAULT_METHOD, create_tracker, warm_up
from app.engine.mapping import FloorPlan, build_map, krige_grid
from app.engine.mapping.crowd import ContributionPolicy, TrustPolicy, Weighed, contribute, weigh
from app.engine.mapping.crowd.lookup import read_field
from app.engine.mapping.crowd.offsets import expected_of, fit_offset
from app.engine.mapping.model import MapModel, field_samples
from app.engine.mapping.samples import place_samples
from app.engine.types import (
    Evidence,
    EvidenceSource,
    GridMap,
    MapBuild,
    MapBuildSettings,
    Progress,
    SourceKind,
    SurveyWalk,
    Tracker,
)
from app.evaluation.datasets.ilc20 import Ilc20Level, open_ilc20
from app.evaluation.datasets.walks import RecordedWalk
from app.evaluation.drivers import EngineDriver, GridMaps, smooth_in_engine
from app.evaluation.errors import OptionsError
from app.evaluation.metrics import StepScores, Summary, score_steps, summarize
from app.evaluation.protocol import Aids, Scenario, Trip, make_trip, walk_seed
from app.evaluation.tables import layout, length_cell
from app.evaluation.truth import MIN_STEPS, truth_at_steps

FOLDS = 4
NO_AIDS = Aids()
_NEIGHBOURS = 64
_SUPPORT_CAP_M = 50.0


@dataclass(frozen=True, slots=True)
class CrowdOptions:
    """What to evaluate, and how.

    Attributes
    ----------
    data : Path
    levels : tuple of str
        Empty: all that are found.
    rounds : int
        Times that the sessions are located anew on the map they made.
    aids : Aids
        Readings that survey and sessions bring besides; test walks are tracked without.
    left_out : float or None
        Score this share of the train walks, left out of all maps, in place of the test walks: for trying things out.
    limit : int or None
        Walks scored at most.
    seed : int
        Of the sharing out.
    contributions : ContributionPolicy
    trust : TrustPolicy
    """

    data: Path
    levels: tuple[str, ...] = ()
    rounds: int = 2
    aids: Aids = NO_AIDS
    left_out: float | None = None
    limit: int | None = None
    seed: int = 0
    contributions: ContributionPolicy = field(default_factory=ContributionPolicy)
    trust: TrustPolicy = field(default_factory=TrustPolicy)

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise OptionsError("rounds", f"needs at least 1, got {self.rounds}")
        if self.left_out is not None and not 0.0 < self.left_out < 1.0:
            raise OptionsError("left_out", f"is a share between 0 and 1, got {self.left_out}")


@dataclass(frozen=True, slots=True)
class CrowdLevel:
    """Figures of one level.

    Attributes
    ----------
    third, crowd, full : Summary
        Tracking errors on the map of a third of the walks, of these and the sessions of the others, of all walks.
    residual_variance : float or None
        Of the scored walks' readings about the crowd's map over what it claims, their offsets taken off: 1 if true.
        None where no scored walk touches mapped ground.
    mapped_m2 : tuple of three floats
        Mapped ground of the three maps.
    sessions, contributed : int
        Sessions, and those with rows in use.
    shares : mapping of str to float
        Share of the contributed cells by action.
    """

    third: Summary
    crowd: Summary
    full: Summary
    residual_variance: float | None
    mapped_m2: tuple[float, float, float]
    sessions: int
    contributed: int
    shares: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        summaries = {name: getattr(self, name).as_dict() for name in ("third", "crowd", "full")}
        return {
            **summaries,
            "residual_variance": None if self.residual_variance is None else round(self.residual_variance, 4),
            "mapped_m2": dict(zip(("third", "crowd", "full"), self.mapped_m2, strict=True)),
            "sessions": self.sessions,
            "contributed": self.contributed,
            "actions": {name: round(share, 4) for name, share in self.shares.items()},
        }


@dataclass(frozen=True, slots=True)
class CrowdReport:
    """Figures of all levels."""

    levels: Mapping[str, CrowdLevel]

    def to_json(self) -> str:
        """``{level: {"third": ..., "crowd": ..., "full": ..., "residual_variance": ...}}``."""
        return json.dumps({name: level.as_dict() for name, level in self.levels.items()}, indent=1)

    def table(self) -> str:
        """For people: errors in metres."""
        rows = [("level", "map", "walks", "p50 m", "p90 m", "mapped m2", "residual variance")]
        for name, level in self.levels.items():
            for i, which in enumerate(("third", "crowd", "full")):
                s: Summary = getattr(level, which)
                variance = length_cell(level.residual_variance) if which == "crowd" else ""
                cells = (length_cell(s.p50), length_cell(s.p90), f"{level.mapped_m2[i]:.0f}", variance)
                rows.append((name, which, str(s.n_walks), *cells))
        return "\n".join(layout(rows, left=2))


@dataclass(frozen=True, slots=True)
class Parts:
    """Walks of a level by what they are for."""

    third: tuple[RecordedWalk, ...]
    sessions: tuple[RecordedWalk, ...]
    scored: tuple[RecordedWalk, ...]


def run_crowd(options: CrowdOptions, progress: Progress | None = None) -> CrowdReport:
    """Evaluate the crowd's maps on a data set in the ilc20 folder format.

    Raises
    ------
    DataSetError
        The data are not there or not in the format.
    OptionsError
        A level has too few walks to be shared out.
    """
    say = progress or _silent
    data = open_ilc20(options.data)
    names = options.levels or data.levels()
    warm_up()
    levels = {}
    for i, name in enumerate(names):
        levels[name] = evaluate_level(data.level(name), options, _part_of(say, i, len(names)))
    say(1.0, "done")
    return CrowdReport(levels)


def evaluate_level(level: Ilc20Level, options: CrowdOptions, say: Progress) -> CrowdLevel:
    """Figures of one level; walks of the train split are shared out by :func:`share_out`."""
    parts = share_out(level, options)
    plan = None if level.vector_plan is None else FloorPlan.from_geojson(level.vector_plan)
    say(0.0, "map of all walks")
    survey = {
        which: tuple(_aided(walk.survey_walk(), options.aids) for walk in walks)
        for which, walks in (("third", parts.third), ("full", parts.third + parts.sessions))
    }
    full = build_map(level.name, survey["full"], plan=plan).grid_map
    say(0.3, "map of a third")
    third = build_map(level.name, survey["third"], MapBuildSettings(extent=full.extent), plan=plan)
    tracker = create_tracker(DEFAULT_METHOD, {})
    crowd, weighed = crowd_map(third, parts.sessions, tracker, options, lambda f, what: say(0.4 + 0.5 * f, what))
    say(0.9, "tracking")
    maps = (third.grid_map, crowd, full)
    on_third, on_crowd, on_full = (summarize(_track(replace(one, radio=None), parts.scored, tracker)) for one in maps)
    actions = [(action, n) for verdict in weighed.verdicts for action, n in verdict.cells]
    total = max(sum(n for _, n in actions), 1)
    return CrowdLevel(
        on_third,
        on_crowd,
        on_full,
        residual_variance=residual_variance(crowd, parts.scored),
        mapped_m2=(_mapped_m2(third.grid_map), _mapped_m2(crowd), _mapped_m2(full)),
        sessions=len(parts.sessions),
        contributed=sum(any(action.used for action, _ in verdict.cells) for verdict in weighed.verdicts),
        shares={name: sum(n for a, n in actions if a == name) / total for name in dict.fromkeys(a for a, _ in actions)},
    )


def _mapped_m2(grid_map: GridMap) -> float:
    return float(grid_map.mapped.sum()) * grid_map.cell_m**2


def share_out(level: Ilc20Level, options: CrowdOptions) -> Parts:
    """Walks to survey, to locate and to score: none of the scored ones is in any map."""
    walks = level.walks("train")
    order = [walks[i] for i in np.random.default_rng([options.seed, walk_seed(level.name)]).permutation(len(walks))]
    held = round(len(order) * options.left_out) if options.left_out else 0
    scored = tuple(order[:held]) if held else level.walks("test")
    rest = order[held:]
    if len(rest) < 3 or not scored:
        raise OptionsError("levels", f"{level.name} has {len(walks)} train walks, too few to share out")
    third = len(rest) // 3
    return Parts(tuple(rest[:third]), tuple(rest[third:]), tuple(scored)[: options.limit])


def _aided(walk: SurveyWalk, aids: Aids) -> SurveyWalk:
    """A survey walk with the readings that are asked for."""
    return replace(walk, wifi=walk.wifi if aids.wifi else None, ble=walk.ble if aids.ble else None)


def crowd_map(
    surveyed: MapBuild, walks: Sequence[RecordedWalk], tracker: Tracker, options: CrowdOptions, say: Progress
) -> tuple[GridMap, Weighed]:
    """The map that sessions make of a surveyed one."""
    model = MapModel.from_values(surveyed.model)
    level_id = surveyed.grid_map.level_id
    trips = [make_trip(walk, level_id, Scenario.TRACKING, aids=options.aids) for walk in walks]
    parts: dict[int, Evidence] = {}
    for done in range(options.rounds):
        found: dict[int, Evidence] = {}
        for fold in range(FOLDS if parts else 1):
            say((done + fold / FOLDS) / options.rounds, f"sessions, round {done + 1} of {options.rounds}")
            mine = [i for i in range(len(trips)) if not parts or i % FOLDS == fold]
            others = [part for i, part in parts.items() if i not in set(mine)]
            current = rebuilt(surveyed, weigh_all(surveyed, others, model, options), model) if others else None
            for i in mine:
                part = _contribution(tracker, trips[i], current or surveyed.grid_map, options)
                if len(part):
                    found[i] = part
        parts = found
    weighed = weigh_all(surveyed, list(parts.values()), model, options)
    return rebuilt(surveyed, weighed, model), weighed


def weigh_all(surveyed: MapBuild, parts: Sequence[Evidence], model: MapModel, options: CrowdOptions) -> Weighed:
    """Survey and sessions, weighed."""
    return weigh(Evidence.joined([surveyed.evidence, *parts]), options.trust, model=model)


def rebuilt(surveyed: MapBuild, weighed: Weighed, model: MapModel) -> GridMap:
    """The surveyed map with its field kriged from all evidence in use."""
    grid = surveyed.grid_map
    rows, columns = grid.shape
    x = grid.x0 + grid.cell_m * np.arange(columns, dtype=np.float64)
    y = grid.y0 + grid.cell_m * np.arange(rows, dtype=np.float64)
    samples = field_samples(weighed.evidence, model)
    mean, sd = krige_grid(samples, model.level, model.covariance, x, y, neighbours=_NEIGHBOURS)
    nodes = np.stack([axis.ravel() for axis in np.meshgrid(x, y)], axis=1)
    distance, _ = cKDTree(samples.xy).query(nodes, distance_upper_bound=_SUPPORT_CAP_M)
    support = np.minimum(distance, _SUPPORT_CAP_M).reshape(rows, columns)
    return replace(grid, mean=mean.astype(np.float32), sd=sd.astype(np.float32), support=support.astype(np.float32))


def _contribution(tracker: Tracker, trip: Trip, grid_map: GridMap, options: CrowdOptions) -> Evidence:
    """What one session brings; every walk is of another user."""
    source = EvidenceSource(trip.walk_id, SourceKind.SESSION, trip.walk_id, t=trip.start_t)
    try:
        fixes = smooth_in_engine(tracker, trip, GridMaps({trip.level_id: grid_map})) or ()
    except EngineError:
        fixes = ()
    return contribute(source, fixes, trip.segments, grid_map, policy=options.contributions).evidence


def _track(grid_map: GridMap, walks: Sequence[RecordedWalk], tracker: Tracker) -> list[StepScores]:
    """Scores of tracked walks."""
    driver = EngineDriver(tracker, GridMaps({grid_map.level_id: grid_map}))
    scores = []
    for walk in walks:
        truth = truth_at_steps(detect_steps(walk.samples), walk.waypoints, even_pace=walk.even_pace)
        trip = make_trip(walk, grid_map.level_id, Scenario.TRACKING)
        if len(truth) < MIN_STEPS or not trip.segments:
            continue
        fixes = driver.replay(trip).fixes
        one = score_steps(truth, fixes, start_t=trip.start_t, level_id=grid_map.level_id, prior=trip.prior)
        if len(one):
            scores.append(one)
    return scores


def residual_variance(grid_map: GridMap, walks: Sequence[RecordedWalk]) -> float | None:
    """Variance of labelled readings about the map over the claimed one (map and repeatability), on mapped ground."""
    prior, noise = expected_of(unknown_device()), np.array(grid_map.noise_sd)
    ratios = [np.empty((0, len(noise)))]
    for walk in walks:
        try:
            placed = place_samples(walk.survey_walk())
        except InputError:
            continue
        offset = fit_offset(placed, grid_map, prior, np.zeros(len(placed)))
        there = read_field(grid_map, placed.xy)
        residual = (offset.field(placed) - there.mean)[there.mapped]
        ratios.append(residual**2 / (there.sd[there.mapped] ** 2 + noise**2))
    ratio = np.concatenate(ratios)
    return float(ratio.mean()) if len(ratio) else None


def _part_of(say: Progress, i: int, n: int) -> Progress:
    """Progress of the ``i``-th of ``n`` equal parts."""

    def said(fraction: float, what: str) -> None:
        say((i + fraction) / n, f"{what} ({i + 1} of {n})")

    return said


def _silent(_fraction: float, _what: str) -> None:
    return
