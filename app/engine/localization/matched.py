"""Any matcher as a tracker: the last steps are matched with every segment, dead reckoning carries on between."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from app.engine.errors import StateError
from app.engine.inertial import PedestrianState, StepEvents, advance, gap_before, settled_until
from app.engine.inertial.stride import SPREAD
from app.engine.localization import codec
from app.engine.localization.compass import start_heading
from app.engine.localization.initial import WALKING_M_S
from app.engine.localization.window import Window, problem_of, reckon, routes_of
from app.engine.matching import LocatedTrack, Matcher, MatchResult, RouteMap
from app.engine.types import (
    Answer,
    DeviceCalibration,
    Fix,
    FixKind,
    Float64Array,
    GridMap,
    Hypothesis,
    MapSource,
    Prior,
    Segment,
    SpeedReadings,
    Status,
    TrackerState,
)

LEAST_STEPS = 8
"""Fewer are not matched: whatever fits them fits elsewhere, too."""
_DRIFT = 0.2
"""Error of dead reckoning since the last match, of the way."""
_MAX_HYPOTHESES = 5
_SCALES = (0.6, 1.6)
_PACE_S = 0.5
_REACH_M = 3.0
_WALK_ON_M = 5.0
_CHI2_999 = 13.8
_COVARIANCE = 1.7
"""Of a match's covariance, so that 95 % ellipses hold what they claim on left-out survey walks."""
_ROUTES: WeakKeyDictionary[GridMap, tuple[RouteMap, ...]] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class _Told:
    """Several places, heaviest first, and the covariance about the first that holds all of them, shape (2, 2), m^2."""

    hypotheses: tuple[Hypothesis, ...]
    cov: Float64Array


@dataclass(slots=True)
class _Session:
    """A session under way.

    Attributes
    ----------
    offset : float, rad
        Takes free azimuth to the level frame.
    scale : float
        Stride of this walker over the stride model's.
    cov : array, shape (2, 2), m^2
        Of the newest step's place.
    base : array, shape (2, 2), m^2
        Of the place where the last match, or the prior, left off.
    since_m : float, m
        Way from there on.
    status : Status
        Of the newest match.
    walk_on_m : float or None
    weight : float
        Of the newest match's first hypothesis; 0 without one.
    told : _Told or None
        What the newest match says if it names several places: steps are not moved for it.
    """

    pedestrian: PedestrianState
    window: Window
    offset: float
    scale: float
    cov: Float64Array
    base: Float64Array
    since_m: float
    heading: float
    status: Status
    walk_on_m: float | None
    weight: float
    told: _Told | None = None


class MatcherTracker:
    """Serves a batch method segment by segment.

    Steps within a segment are told by dead reckoning from the last match on, so that a ``filtered`` fix uses nothing
    from after its time; the fix at the segment's end is the match of the last steps. The segment's steps as the match
    places them are told as ``fixed_lag``. No fix is called sure: that flag is calibrated for the particle filter.
    """

    def __init__(
        self,
        method: str,
        matcher: Matcher,
        *,
        needs_routes: bool = False,
        needs_region: bool = False,
        needs_odometry: bool = True,
    ) -> None:
        self.method = method
        self.matcher = matcher
        self.needs_routes = needs_routes
        self.needs_region = needs_region
        self.needs_odometry = needs_odometry

    @property
    def parameters(self) -> object:
        """Parameters of the matcher."""
        return getattr(self.matcher, "parameters", None)

    def start(self, prior: Prior, *, seed: int) -> TrackerState:
        """State before the first segment."""
        values = {"prior": codec.prior_values(prior), "seed": seed, "session": None}
        return TrackerState(self.method, codec.pack(values))

    def step(
        self, state: TrackerState, segment: Segment, map_source: MapSource
    ) -> tuple[TrackerState, tuple[Fix, ...]]:
        """Advance by one segment."""
        answer = self.answer(state, segment, map_source)
        return answer.state, answer.fixes

    def learned(self, state: TrackerState) -> DeviceCalibration | None:  # noqa: ARG002 - the contract
        """Nothing: a match tells where, not what is wrong with the device."""
        return None

    def answer(self, state: TrackerState, segment: Segment, map_source: MapSource) -> Answer:
        """Advance by one segment; its steps are told a second time as the match at its end places them."""
        if state.method != self.method:
            raise StateError(f"state belongs to method {state.method!r}, not {self.method!r}")
        values = codec.unpack(state.payload)
        prior = codec.prior_from(values["prior"])
        level_id = map_source.level_ids()[0] if prior.level_id is None else prior.level_id
        grid_map = map_source.grid_map(level_id)
        before = None if values["session"] is None else _session_from(values["session"])
        known = None if before is None else before.pedestrian
        gap = 0.0 if known is None else gap_before(known, segment.samples)
        speed = segment.speed
        if speed is None and segment.steps is None and not self.needs_odometry:
            speed = _any_pace(segment)
        pedestrian, events = advance(known, segment.samples, speed=speed, steps=segment.steps)
        session = _begin(prior, pedestrian, events, grid_map) if before is None else before
        session.pedestrian = pedestrian
        if gap > 0.0:
            _resume(session, gap, _begin(prior, pedestrian, events, grid_map))
        fixes = _walk(session, events, level_id)
        lagged: tuple[Fix, ...] = ()
        if len(events) and len(session.window.events) >= LEAST_STEPS:
            result = self._match(session, prior, grid_map, values["seed"])
            lagged = _settle(session, result, len(events), level_id)
        last_t, settled_t = float(segment.samples.t[-1]), settled_until(segment.samples.t)
        fixes.append(_fix(session, settled_t, level_id, *session.window.here, session.cov, told=session.told))
        after = {"prior": values["prior"], "seed": values["seed"], "session": _session_values(session)}
        return Answer(TrackerState(self.method, codec.pack(after), last_t), tuple(fixes), lagged)

    def _match(self, session: _Session, prior: Prior, grid_map: GridMap, seed: int) -> MatchResult | None:
        """None where the method cannot be asked: without a place to search about, or without lines to compare with."""
        if self.needs_region and not session.window.located:
            return None
        routes: tuple[RouteMap, ...] = ()
        if self.needs_routes:
            routes = _ROUTES.get(grid_map) or _ROUTES.setdefault(grid_map, routes_of(grid_map))
            if not routes:
                return None
        problem = problem_of(
            session.window,
            grid_map,
            session.offset,
            session.scale,
            calibration=prior.calibration,
            routes=routes,
            seed=seed,
        )
        return self.matcher.match(problem)


def _any_pace(segment: Segment) -> SpeedReadings:
    """A speed of one, for a method that takes readings by time: nothing but their order is made of it."""
    t = np.arange(segment.samples.t[0], segment.samples.t[-1] + _PACE_S, _PACE_S)
    return SpeedReadings(t, np.ones(t.shape))


def _begin(prior: Prior, pedestrian: PedestrianState, events: StepEvents, grid_map: GridMap) -> _Session:
    heading, turn_sd, free = start_heading(prior, pedestrian, events, grid_map)
    if prior.x is not None and prior.y is not None:
        x, y, variance = prior.x, prior.y, 0.25 * prior.radius_m**2  # a disc's variance per axis
        cov = variance * np.eye(2)
    else:
        x_min, y_min, x_max, y_max = grid_map.extent
        x, y, variance = 0.5 * (x_min + x_max), 0.5 * (y_min + y_max), np.inf
        cov = np.diag([(x_max - x_min + 1.0) ** 2, (y_max - y_min + 1.0) ** 2]) / 12.0
    return _Session(
        pedestrian=pedestrian,
        window=Window.start(x, y, variance, turn_sd),
        offset=heading - free,
        scale=1.0 if prior.calibration is None else prior.calibration.stride_scale,
        cov=cov,
        base=cov,
        since_m=0.0,
        heading=heading,
        status=Status.INSUFFICIENT,
        walk_on_m=5.0,
        weight=0.0,
    )


def _resume(session: _Session, gap_s: float, fresh: _Session) -> None:
    """After a gap: heading anew, steps forgotten, and the distance that may lie between."""
    variance = float(np.trace(session.cov)) / 2.0 + (WALKING_M_S * gap_s) ** 2 / 4.0
    known = variance if session.window.located else np.inf
    session.cov = session.cov + (WALKING_M_S * gap_s) ** 2 / 4.0 * np.eye(2)
    session.base, session.since_m = session.cov, 0.0
    session.window = Window.start(*session.window.here, known, fresh.window.turn_sd)
    session.offset, session.status, session.told = fresh.offset, Status.INSUFFICIENT, None


def _walk(session: _Session, events: StepEvents, level_id: str) -> list[Fix]:
    """Fixes of new steps by dead reckoning from the newest place on."""
    x, y = reckon(events, session.offset, session.scale, *session.window.here)
    fixes = []
    for i in range(len(events)):
        session.heading = float(events.motion_heading[i]) + session.offset
        session.since_m += float(events.stride[i])
        # heading and stride err alike from step to step: what they add up to goes with the way, not with its root
        session.cov = session.base + (_DRIFT * session.since_m) ** 2 * np.eye(2)
        fixes.append(_fix(session, float(events.t[i]), level_id, float(x[i]), float(y[i]), session.cov))
    session.window = session.window.walked(events, x, y)
    return fixes


def _settle(session: _Session, result: MatchResult | None, new: int, level_id: str) -> tuple[Fix, ...]:
    """Take over what a match says; fixed-lag fixes of the newest ``new`` steps if it says anything."""
    session.told = None
    if result is None or not result.matches or result.status in (Status.INSUFFICIENT, Status.OFF_MAP):
        session.status = Status.INSUFFICIENT if result is None else result.status
        session.walk_on_m = None if result is None else result.walk_on_m
        session.weight = 0.0
        return ()
    matches = tuple(replace(match, cov=_COVARIANCE * match.cov) for match in result.matches)
    best = matches[0]
    session.status, session.walk_on_m, session.weight = result.status, result.walk_on_m, best.weight
    if result.status is Status.AMBIGUOUS:  # nothing is settled: the next match is asked as widely as this one
        places = tuple(_hypothesis(match, level_id) for match in matches[:_MAX_HYPOTHESES])
        session.told = _Told(places, _of_all(matches))
        return ()
    if session.window.located and _beyond_belief(session, best):
        session.status, session.walk_on_m, session.weight = Status.INSUFFICIENT, _WALK_ON_M, 0.0
        return ()
    session.cov = session.base = best.cov
    session.since_m = 0.0
    _move(session, best)
    events = session.window.events
    return tuple(
        _fix(session, float(events.t[i]), level_id, float(best.x[i]), float(best.y[i]), best.cov, FixKind.FIXED_LAG)
        for i in range(max(len(events) - new, 0), len(events))
    )


def _beyond_belief(session: _Session, best: LocatedTrack) -> bool:
    """Whether a match lies where dead reckoning, with what it may err by, cannot have come."""
    x, y = session.window.here
    away = np.array([best.x[-1] - x, best.y[-1] - y])
    return float(away @ np.linalg.solve(session.cov + best.cov, away)) > _CHI2_999


def _move(session: _Session, best: LocatedTrack) -> None:
    """Put the window's steps where the match has them, and turn what is to come."""
    window = session.window
    session.offset += best.rotation
    session.scale = float(np.clip(session.scale * best.scale, *_SCALES))
    session.heading += best.rotation
    heading, stride = float(window.events.motion_heading[0]) + session.offset, float(window.events.stride[0])
    x0, y0 = float(best.x[0]) - stride * np.cos(heading), float(best.y[0]) - stride * np.sin(heading)
    way = float(window.events.stride.sum())
    # The next window holds most of these steps again: what they have told may bound its search, not bear it out.
    variance = float(np.trace(best.cov)) / 2.0 + (0.5 * SPREAD * way) ** 2 / 4.0 + _REACH_M**2
    session.window = window.placed(best.x.copy(), best.y.copy(), float(x0), float(y0), variance)


def _of_all(matches: tuple[LocatedTrack, ...]) -> Float64Array:
    """Covariance about the first match's last point that holds all others, m^2."""
    total = np.zeros((2, 2))
    for match in matches:
        away = np.array([match.x[-1] - matches[0].x[-1], match.y[-1] - matches[0].y[-1]])
        total += match.weight * (match.cov + np.outer(away, away))
    cov: Float64Array = total / sum(match.weight for match in matches)
    return cov


def _hypothesis(match: LocatedTrack, level_id: str) -> Hypothesis:
    cov = match.cov
    return Hypothesis(
        level_id,
        float(match.x[-1]),
        float(match.y[-1]),
        float(cov[0, 0]),
        float(cov[0, 1]),
        float(cov[1, 1]),
        match.weight,
    )


def _fix(
    session: _Session,
    t: float,
    level_id: str,
    x: float,
    y: float,
    cov: Float64Array,
    kind: FixKind = FixKind.FILTERED,
    *,
    told: _Told | None = None,
) -> Fix:
    if told is not None:
        x, y, cov = told.hypotheses[0].x, told.hypotheses[0].y, told.cov
    spread = float(np.trace(cov)) / 2.0
    asks = session.status in (Status.INSUFFICIENT, Status.AMBIGUOUS)
    return Fix(
        t=t,
        level_id=level_id,
        x=x,
        y=y,
        cov_xx=float(cov[0, 0]) + 0.01,
        cov_xy=float(cov[0, 1]),
        cov_yy=float(cov[1, 1]) + 0.01,
        heading=session.heading,
        status=session.status,
        quality=float(session.weight / (1.0 + spread / 9.0)),
        sure=False,
        walk_on_m=session.walk_on_m if asks else None,
        hypotheses=() if told is None else told.hypotheses,
        kind=kind,
    )


def _session_values(session: _Session) -> dict[str, Any]:
    return {
        "pedestrian": codec.pedestrian_values(session.pedestrian),
        "window": session.window.values(),
        "rest": [
            session.offset,
            session.scale,
            session.heading,
            str(session.status),
            session.walk_on_m,
            session.weight,
        ],
        "cov": session.cov,
        "base": session.base,
        "since_m": session.since_m,
        "told": None
        if session.told is None
        else {"places": [list(astuple(one)) for one in session.told.hypotheses], "cov": session.told.cov},
    }


def _session_from(values: dict[str, Any]) -> _Session:
    offset, scale, heading, status, walk_on_m, weight = values["rest"]
    told = values["told"]
    return _Session(
        pedestrian=codec.pedestrian_state(values["pedestrian"]),
        window=Window.of(values["window"]),
        offset=offset,
        scale=scale,
        heading=heading,
        status=Status(status),
        walk_on_m=walk_on_m,
        weight=weight,
        cov=values["cov"],
        base=values["base"],
        since_m=values["since_m"],
        told=None if told is None else _Told(tuple(Hypothesis(*one) for one in told["places"]), told["cov"]),
    )
