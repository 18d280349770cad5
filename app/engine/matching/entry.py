"""What a matcher can do: the row of the table that each module fills in for its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from app.engine.matching.result import Matcher
from app.engine.types import FeatureSet

ALL_FEATURES = (FeatureSet.VECTOR, FeatureSet.HV, FeatureSet.TOTAL)


@dataclass(frozen=True, slots=True)
class Bound:
    """Range of a numeric parameter, both ends included."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class MatcherEntry:
    """A matcher and what it can do.

    Attributes
    ----------
    name, summary, reference : str
    parameters : type
        Frozen dataclass with defaults.
    create : callable
        Takes the parameters, returns the matcher.
    bounds : mapping
        Range of each numeric parameter.
    features : tuple of FeatureSet
    needs_heading : bool
        Whether a start heading that is off by more than some degrees spoils it.
    needs_odometry : bool
    needs_region : bool
        Whether it can only search about a prior.
    needs_routes : bool
        Whether it compares with lines of the map.
    dimensions : int
        2 over an area, 1 along a line.
    scales : tuple of str
        ``indoor``, ``route``, ``area``: kinds of venue that it suits.
    """

    name: str
    summary: str
    reference: str
    parameters: type
    create: Callable[[Any], Matcher]
    bounds: Mapping[str, Bound] = field(default_factory=dict)
    features: tuple[FeatureSet, ...] = ALL_FEATURES
    needs_heading: bool = False
    needs_odometry: bool = True
    needs_region: bool = False
    needs_routes: bool = False
    dimensions: int = 2
    scales: tuple[str, ...] = ("indoor", "route", "area")
