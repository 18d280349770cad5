"""How good a map is, where to survey next, what to expect along a route."""

from __future__ import annotations

from isodyn_client.models import Model


class Region(Model):
    """A connected part of the walkable space, in level metres."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    area_m2: float
    mapped_share: float


class CoverageSummary(Model):
    """What of the walkable space is mapped; ``by_plan``: whether a floor plan says where people walk."""

    by_plan: bool
    walkable_m2: float
    mapped_m2: float
    mapped_share: float
    support_p50_m: float | None = None
    support_p90_m: float | None = None
    regions: tuple[Region, ...] = ()


class ErrorSummary(Model):
    """Percentiles of the expected horizontal error over mapped ground, m; None where nothing is mapped."""

    p50_m: float | None = None
    p90_m: float | None = None


class HeadingError(ErrorSummary):
    """The same for one direction of travel, counter-clockwise from +x."""

    heading_deg: int


class ConflictSummary(Model):
    """Cells of 1 m that several sources passed, and those in which they disagree beyond their noise."""

    shared_cells: int
    conflict_cells: int


class MapQuality(Model):
    """How good a map is; ``conflict`` is None for maps stored without what they rest on."""

    map_id: str
    coverage: CoverageSummary
    mean_error: ErrorSummary
    worst_error: ErrorSummary
    by_heading: tuple[HeadingError, ...]
    conflict: ConflictSummary | None = None


class Suggestion(Model):
    """A straight line to walk, ``start`` and ``end`` in level metres."""

    start: tuple[float, float]
    end: tuple[float, float]
    length_m: float
    gain_m2: float
    reasons: tuple[str, ...]
    words: str


class Suggestions(Model):
    """Lines to survey next, best first; ``unknown_before`` and ``unknown_after`` all of them: standard deviation of the
    map over walkable ground, over that of an unknown field."""

    map_id: str
    unknown_before: float
    unknown_after: float
    suggestions: tuple[Suggestion, ...]


class Stretch(Model):
    """A part of a route where the position will be poor: ``unmapped``, ``lost`` or ``ambiguous``."""

    trouble: str
    from_m: float
    to_m: float
    rival_m: float | None = None


class RouteForecast(Model):
    """What to expect along a route; columns about every metre of the way."""

    map_id: str
    length_m: float
    mapped_share: float
    mean_m: float
    p90_m: float
    stretches: tuple[Stretch, ...]
    way_m: tuple[float, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    mapped: tuple[bool, ...]
    along_m: tuple[float, ...]
    across_m: tuple[float, ...]
    error_m: tuple[float, ...]
