"""``method=auto``: which method suits a trip, as one table, with the reason in words.

The rows follow the comparison of Lu et al. 2022, table 1 (doi:10.19306/j.cnki.2095-8110.2022.02.015: which method
suits which field, scale and sensor), as far as recorded walks and lines bear it out (``docs/benchmarks.md``): indoors
the particle filter is ahead of every batch method, because none of them carries a sensor's offset, a heading error and
unmapped ground along; over areas whose field changes over hundreds of metres, contour matching is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from app.engine.types import FeatureSet


class Scale(StrEnum):
    """Kind of venue: a building, a line, an area."""

    INDOOR = "indoor"
    ROUTE = "route"
    AREA = "area"


@dataclass(frozen=True, slots=True)
class Situation:
    """What is known of a trip when a method is chosen.

    Attributes
    ----------
    scale : Scale
        Kind of the venue.
    features : FeatureSet
        Of the map.
    has_routes : bool
        Whether the map has the lines it was surveyed along.
    prior : bool
        Whether the start is known.
    odometry : bool
        Whether steps or a speed tell the way; a vehicle without either has the shape of time alone.
    levels : int
        That the trip may be on.
    """

    scale: Scale
    features: FeatureSet
    has_routes: bool
    prior: bool
    odometry: bool
    levels: int = 1


@dataclass(frozen=True, slots=True)
class Choice:
    """A method's name and why it was chosen."""

    method: str
    why: str


@dataclass(frozen=True, slots=True)
class _Row:
    suits: Callable[[Situation], bool]
    method: str
    why: str


POLICY = (
    _Row(
        lambda s: s.levels > 1,
        "particle",
        "the level is not known: only the particle filter searches several levels at once",
    ),
    _Row(
        lambda s: s.scale is Scale.INDOOR,
        "particle",
        "indoors a phone's offset and heading are as uncertain as its place: the particle filter carries all of them",
    ),
    _Row(
        lambda s: s.scale is Scale.ROUTE and s.has_routes and not s.odometry and s.features is FeatureSet.VECTOR,
        "voting_dtw",
        "a line, three components and no odometry: time sequences are compared, two of three components must agree",
    ),
    _Row(
        lambda s: s.scale is Scale.ROUTE and s.has_routes,
        "subsequence_dtw",
        "a line: the sequence of readings along it needs no heading and forgives an unsteady pace",
    ),
    _Row(
        lambda s: s.scale is Scale.ROUTE,
        "particle",
        "a line whose map has not kept the way it was surveyed along: the particle filter needs none",
    ),
    _Row(
        lambda s: s.scale is Scale.AREA and s.prior,
        "icm",
        "an area and a start that is roughly known: contours hold back what dead reckoning drifts, point by point",
    ),
    _Row(
        lambda s: s.scale is Scale.AREA,
        "magcom",
        "an area and no start: only a search over all offsets is sure to meet the right one",
    ),
)


def choose(situation: Situation) -> Choice:
    """The first row of the policy that suits."""
    row = next(row for row in POLICY if row.suits(situation))
    return Choice(row.method, row.why)
