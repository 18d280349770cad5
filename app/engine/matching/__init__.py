"""Batch methods: a profile along a track is put in its place on a map (see :class:`Matcher`)."""

from app.engine.matching.conclude import JudgementPolicy, conclude
from app.engine.matching.entry import Bound, MatcherEntry
from app.engine.matching.field import MapReading, features_of, read_map, route_along
from app.engine.matching.problem import MatchProblem, Profile, Region, RouteMap, Track, common_features
from app.engine.matching.registry import MATCHERS
from app.engine.matching.result import Candidate, Evidence, LocatedTrack, Matcher, MatchResult

__all__ = [
    "MATCHERS",
    "Bound",
    "Candidate",
    "Evidence",
    "JudgementPolicy",
    "LocatedTrack",
    "MapReading",
    "MatchProblem",
    "MatchResult",
    "Matcher",
    "MatcherEntry",
    "Profile",
    "Region",
    "RouteMap",
    "Track",
    "common_features",
    "conclude",
    "features_of",
    "read_map",
    "route_along",
]
