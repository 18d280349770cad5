"""Survey planning: quality of maps, suggested lines, forecasts of routes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from app.api.errors import RejectedError
from app.api.schemas.base import In, Metres, Number, Out, example
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.validation import FieldError
from app.engine.mapping.outlook import RouteOutlook, Trouble
from app.engine.mapping.quality import CoverageSummary
from app.engine.mapping.suggestions import Reason, Suggestion
from app.services.planning import ErrorSummary, MapQuality, QualityLayer, SurveyPlan
from app.services.records import Anchor

MAX_CORNERS = 1000

_ERROR = {"p50_m": 1.58, "p90_m": 2.41}
_QUALITY = {
    "map_id": MAP_ID,
    "coverage": {
        "by_plan": True,
        "walkable_m2": 6358.0,
        "mapped_m2": 4057.5,
        "mapped_share": 0.638,
        "support_p50_m": 0.91,
        "support_p90_m": 7.96,
        "regions": [
            {"x_min": 97.0, "y_min": 7.0, "x_max": 237.5, "y_max": 169.5, "area_m2": 5831.5, "mapped_share": 0.636}
        ],
    },
    "mean_error": _ERROR,
    "worst_error": {"p50_m": 1.71, "p90_m": 2.77},
    "by_heading": [{"heading_deg": 0, "p50_m": 1.62, "p90_m": 2.53}],
    "conflict": {"shared_cells": 669, "conflict_cells": 54},
}
_LINE = {
    "start": [193.2, 41.6],
    "end": [184.7, 50.0],
    "length_m": 12.0,
    "gain_m2": 35.4,
    "reasons": ["unmapped"],
    "words": "not mapped yet",
}
_SUGGESTIONS = {"map_id": MAP_ID, "unknown_before": 0.73, "unknown_after": 0.68, "suggestions": [_LINE]}
SUGGESTIONS_GEO_JSON: dict[str, Any] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": 0,
            "geometry": {"type": "LineString", "coordinates": [[11.5717, 48.1511], [11.5716, 48.1512]]},
            "properties": {"level_id": LEVEL_ID, **_LINE},
        }
    ],
}


class RegionOut(Out):
    """A connected part of the walkable space, in level metres."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    area_m2: float
    mapped_share: float


class CoverageSummaryOut(Out):
    """What of the walkable space is mapped."""

    by_plan: Annotated[
        bool, Field(description="Whether the floor plan says where people walk; else it is ground near what is mapped.")
    ]
    walkable_m2: float
    mapped_m2: float
    mapped_share: float
    support_p50_m: Annotated[float | None, Field(description="From walkable ground to the nearest survey sample.")]
    support_p90_m: float | None
    regions: Annotated[
        list[RegionOut], Field(description="Connected parts of at least 10 m2, largest first, up to 50.")
    ]

    @classmethod
    def of(cls, summary: CoverageSummary) -> Self:
        """Show a summary."""
        p50, p90 = summary.support_m if summary.walkable_m2 else (None, None)
        regions = [
            RegionOut(
                **dict(zip(("x_min", "y_min", "x_max", "y_max"), region.box, strict=True)),
                area_m2=region.area_m2,
                mapped_share=region.mapped_share,
            )
            for region in summary.regions
        ]
        return cls(
            by_plan=summary.by_plan,
            walkable_m2=summary.walkable_m2,
            mapped_m2=summary.mapped_m2,
            mapped_share=summary.mapped_share,
            support_p50_m=p50,
            support_p90_m=p90,
            regions=regions,
        )


class ErrorSummaryOut(Out):
    """Percentiles of the expected horizontal error over mapped, walkable ground; null where nothing is mapped."""

    p50_m: float | None
    p90_m: float | None

    @classmethod
    def of(cls, summary: ErrorSummary) -> Self:
        """Show a summary."""
        return cls(p50_m=summary.p50_m, p90_m=summary.p90_m)


class HeadingErrorOut(ErrorSummaryOut):
    """The same for one direction of travel, counter-clockwise from +x."""

    heading_deg: int


class ConflictSummaryOut(Out):
    """Cells of 1 m that several sources passed, and those in which they disagree beyond their noise."""

    shared_cells: int
    conflict_cells: int


class QualityOut(Out):
    """How good a map is."""

    model_config = example(_QUALITY)

    map_id: str
    coverage: CoverageSummaryOut
    mean_error: Annotated[ErrorSummaryOut, Field(description="Root mean square over the headings that lead there.")]
    worst_error: Annotated[ErrorSummaryOut, Field(description="Largest over the headings that lead there.")]
    by_heading: list[HeadingErrorOut]
    conflict: Annotated[ConflictSummaryOut | None, Field(description="Null for maps stored without what they rest on.")]

    @classmethod
    def of(cls, quality: MapQuality) -> Self:
        """Show the quality of a map."""
        conflict = quality.conflict
        return cls(
            map_id=quality.info.id,
            coverage=CoverageSummaryOut.of(quality.coverage),
            mean_error=ErrorSummaryOut.of(quality.mean_error),
            worst_error=ErrorSummaryOut.of(quality.worst_error),
            by_heading=[
                HeadingErrorOut(heading_deg=deg, p50_m=error.p50_m, p90_m=error.p90_m)
                for deg, error in quality.by_heading
            ],
            conflict=conflict
            and ConflictSummaryOut(shared_cells=conflict.shared_cells, conflict_cells=conflict.conflict_cells),
        )


LAYER_WORDS: Mapping[QualityLayer, str] = {
    QualityLayer.MEAN_ERROR: "expected error, mean of the headings, m",
    QualityLayer.WORST_ERROR: "the same of the worst heading, m",
    QualityLayer.ERROR: "the same of one heading, m",
    QualityLayer.ALONG: "standard deviation along the way of one heading, m",
    QualityLayer.ACROSS: "standard deviation across it, m",
    QualityLayer.COVERAGE: "1 mapped, 0 walkable but not mapped",
    QualityLayer.CONFLICT: "variance between sources over their noise, 1 m cells",
    QualityLayer.SOURCES: "number of sources, 1 m cells",
    QualityLayer.AGE: "days from the newest evidence to the making of the map, 1 m cells",
}

Point = Annotated[list[float], Field(min_length=2, max_length=2, description="x, y in level metres.")]


class SuggestionOut(Out):
    """A straight line to walk."""

    start: Point
    end: Point
    length_m: float
    gain_m2: Annotated[
        float,
        Field(description="What it teaches: as much as so much unknown ground, known without error from then on."),
    ]
    reasons: list[Reason]
    words: str


class SuggestionsOut(Out):
    """Lines to survey next, best first; each counts those before it as walked."""

    model_config = example(_SUGGESTIONS)

    map_id: str
    unknown_before: Annotated[
        float, Field(description="Standard deviation of the map over walkable ground, over that of an unknown field.")
    ]
    unknown_after: Annotated[float, Field(description="The same after all of these lines.")]
    suggestions: list[SuggestionOut]


class LineStringOut(Out):
    """A line in WGS 84: longitude, latitude of each end."""

    type: Literal["LineString"]
    coordinates: list[list[float]]


class SuggestionFeatureOut(Out):
    """One line; level metres and everything else are in the properties."""

    type: Literal["Feature"]
    id: int
    geometry: LineStringOut
    properties: dict[str, Any]


class SuggestionCollection(Out):
    """Suggested lines as GeoJSON."""

    model_config = example(SUGGESTIONS_GEO_JSON)

    type: Literal["FeatureCollection"]
    features: list[SuggestionFeatureOut]


def suggestions_object(plan: SurveyPlan) -> dict[str, Any]:
    """Return suggestions as plain values, the shape of SuggestionsOut."""
    return {
        "map_id": plan.info.id,
        "unknown_before": round(plan.plan.before, 4),
        "unknown_after": round(plan.plan.after, 4),
        "suggestions": [_line(suggestion) for suggestion in plan.plan.suggestions],
    }


def suggestions_geo_json(plan: SurveyPlan, anchor: Anchor) -> dict[str, Any]:
    """Return suggestions as GeoJSON in WGS 84."""
    plane = anchor.plane()

    def degrees(point: tuple[float, float]) -> list[float]:
        longitude, latitude = plane.to_wgs84(*point)
        return [round(longitude, 8), round(latitude, 8)]

    features = [
        {
            "type": "Feature",
            "id": number,
            "geometry": {"type": "LineString", "coordinates": [degrees(one.start), degrees(one.end)]},
            "properties": {"level_id": plan.info.level_id, **_line(one)},
        }
        for number, one in enumerate(plan.plan.suggestions)
    ]
    return {"type": "FeatureCollection", "features": features}


def _line(one: Suggestion) -> dict[str, Any]:
    return {
        "start": [round(v, 3) for v in one.start],
        "end": [round(v, 3) for v in one.end],
        "length_m": round(one.length_m, 2),
        "gain_m2": round(one.gain_m2, 2),
        "reasons": [reason.value for reason in one.reasons],
        "words": one.words,
    }


class RouteIn(In):
    """Corners of a route in level metres, as columns of one length."""

    x: Annotated[list[Metres], Field(min_length=2, max_length=MAX_CORNERS)]
    y: Annotated[list[Metres], Field(min_length=2, max_length=MAX_CORNERS)]


class ForecastIn(In):
    """A route to look ahead on, straight from corner to corner, at most 2 km."""

    model_config = example({"route": {"x": [120.0, 150.0, 150.0], "y": [60.0, 60.0, 85.0]}, "known_m": 3.0})

    route: RouteIn
    known_m: Annotated[
        Number, Field(ge=0.1, le=100.0, description="Standard deviation of the position at the start, per axis.")
    ] = 3.0

    def corners(self) -> list[tuple[float, float]]:
        """Return the corners; RejectedError if the columns differ in length."""
        x, y = self.route.x, self.route.y
        if len(x) != len(y):
            fault = FieldError("route.y", f"has {len(y)} values, x has {len(x)}", "send columns of one length")
            raise RejectedError([fault])
        return list(zip(x, y, strict=True))


class StretchOut(Out):
    """A part of the route where the position will be poor."""

    trouble: Annotated[
        Trouble,
        Field(
            description=(
                "`unmapped`: only dead reckoning. `lost`: the expected error is above 5 m. `ambiguous`: the 40 m before"
                " look like another place, where a session that starts on the way may be put."
            )
        ),
    ]
    from_m: float
    to_m: float
    rival_m: Annotated[float | None, Field(description="With `ambiguous`: how far off that place is.")]


class ForecastOut(Out):
    """What to expect along a route. Columns about every metre of the way, from the start to the end."""

    model_config = example(
        {
            "map_id": MAP_ID,
            "length_m": 55.0,
            "mapped_share": 0.93,
            "mean_m": 1.6,
            "p90_m": 2.4,
            "stretches": [{"trouble": "unmapped", "from_m": 41.5, "to_m": 45.0, "rival_m": None}],
            "way_m": [0.0, 1.0],
            "x": [120.0, 121.0],
            "y": [60.0, 60.0],
            "mapped": [True, True],
            "along_m": [2.8, 2.1],
            "across_m": [2.9, 2.5],
            "error_m": [4.0, 3.3],
        }
    )

    map_id: str
    length_m: float
    mapped_share: float
    mean_m: Annotated[float, Field(description="Of the expected error along the way.")]
    p90_m: float
    stretches: list[StretchOut]
    way_m: list[float]
    x: list[float]
    y: list[float]
    mapped: list[bool]
    along_m: Annotated[list[float], Field(description="Standard deviation along the way.")]
    across_m: list[float]
    error_m: Annotated[list[float], Field(description="Root mean square horizontal error.")]


def forecast_object(map_id: str, outlook: RouteOutlook) -> dict[str, Any]:
    """Return a forecast as plain values, the shape of ForecastOut."""
    forecast = outlook.forecast
    metre = sorted({*range(0, len(forecast), 2), len(forecast) - 1})  # points lie half a metre apart

    def column(values: Any) -> list[float]:
        return [round(float(values[i]), 3) for i in metre]

    return {
        "map_id": map_id,
        "length_m": round(float(forecast.way[-1]), 3),
        "mapped_share": round(outlook.mapped_share, 4),
        "mean_m": round(outlook.mean_m, 3),
        "p90_m": round(outlook.p90_m, 3),
        "stretches": [
            {
                "trouble": stretch.trouble.value,
                "from_m": round(stretch.from_m, 2),
                "to_m": round(stretch.to_m, 2),
                "rival_m": stretch.rival_m and round(stretch.rival_m, 1),
            }
            for stretch in outlook.stretches
        ],
        "way_m": column(forecast.way),
        "x": column(forecast.xy[:, 0]),
        "y": column(forecast.xy[:, 1]),
        "mapped": [bool(forecast.mapped[i]) for i in metre],
        "along_m": column(forecast.along),
        "across_m": column(forecast.across),
        "error_m": column(forecast.error),
    }
