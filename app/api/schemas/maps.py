"""Maps: requests to build them, versions, coverage."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import IdRef, In, Number, Out, PageOut, Time, example
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.surveys import SURVEY_ID, WALK_ID
from app.engine.types import FeatureSet, MapBuildSettings, WalkReport
from app.services import records
from app.services.records import MapKind

MAP_ID = "map_019ab2c4d1e07f3a9b2c4d5e6f"
_DEFAULTS = MapBuildSettings()
_REPORT = {
    "walk_id": WALK_ID,
    "n_steps": 118,
    "length_m": 71.3,
    "offset": [1.2, -0.4, 2.1],
    "residual_rms": 2.9,
    "rejected": None,
    "stride_scale": 1.04,
}
_MAP = {
    "id": MAP_ID,
    "level_id": LEVEL_ID,
    "version": 3,
    "parent_id": None,
    "hash": "5f0c9a2d0d8a9e1d9a0a2b3c4d5e6f708192a3b4c5d6e7f8091a2b0b1a6f0f5f",
    "features": "vector",
    "x0": -5.0,
    "y0": -5.0,
    "cell_m": 0.5,
    "rows": 181,
    "columns": 261,
    "mapped_m": 1.5,
    "noise_sd": [2.1, 2.2, 2.6],
    "mapped_share": 0.42,
    "mapped_area_m2": 4960.0,
    "n_walks": 12,
    "n_samples": 31200,
    "length_scale_m": 3.4,
    "field_sd": [5.9, 6.1, 7.2],
    "walks": [_REPORT],
    "build_s": 1.9,
    "kind": "build",
    "added": [WALK_ID],
    "removed": [],
    "n_transmitters": 214,
    "radio_cell_m": 2.0,
    "n_routes": 12,
    "origin": None,
    "created_at": "2026-11-22T09:30:00.000Z",
}
COVERAGE_EXAMPLE: dict[str, Any] = {
    "map_id": MAP_ID,
    "rows": 2,
    "columns": 4,
    "x0": 0.0,
    "y0": 0.0,
    "cell_m": 0.5,
    "mapped_m": 1.5,
    "mapped_share": 0.5,
    "mapped_area_m2": 1.0,
    "runs": [1, 3, 3, 1],
}


class MapIn(In):
    """A map to build."""

    model_config = example({"level_id": LEVEL_ID, "survey_ids": [SURVEY_ID], "features": "vector", "cell_m": 0.5})

    level_id: IdRef
    survey_ids: Annotated[
        tuple[IdRef, ...], Field(max_length=1000, description="Surveys to build from; empty: all of the level.")
    ] = ()
    features: Annotated[FeatureSet, Field(description="Field components the map holds.")] = _DEFAULTS.features
    cell_m: Annotated[Number, Field(ge=0.1, le=10, description="Distance of nodes.")] = _DEFAULTS.cell_m
    mapped_m: Annotated[
        Number, Field(ge=0.1, le=20, description="A node with a survey sample this near counts as mapped.")
    ] = _DEFAULTS.mapped_m
    mode: Annotated[
        MapKind,
        Field(
            description="`build`: from all walks at once. `update`: add to the current map the walks that it lacks "
            "and take out those deleted since; only what they touch is computed anew, with the current map's settings."
        ),
    ] = MapKind.BUILD
    align: Annotated[
        bool,
        Field(
            strict=True,
            description="Estimate each walk's hard iron, carrying angle and label errors against the other walks. Not "
            "for calibrated devices along lines that hardly cross: there what differs between walks is the field.",
        ),
    ] = _DEFAULTS.align
    publish: Annotated[
        bool,
        Field(
            strict=True,
            description="Whether new sessions use the version once it is built. False: a draft, to be looked at and "
            "published with `PUT /v1/levels/{level_id}/map`.",
        ),
    ] = True


class MapOriginOut(Out):
    """Where a map came from that was not built here."""

    source: Annotated[str, Field(description="`import`.")]
    format: Annotated[str, Field(description="Of the file.")]
    file_hash: Annotated[str, Field(description="SHA-256 of the file.")]
    title: str
    licence: str
    attribution: str
    assumed: Annotated[list[str], Field(description="What the file did not tell and was taken instead.")]

    @classmethod
    def of(cls, origin: records.MapOrigin) -> Self:
        """Show where a map came from."""
        return cls(
            source=origin.source,
            format=origin.format,
            file_hash=origin.file_hash,
            title=origin.title,
            licence=origin.licence,
            attribution=origin.attribution,
            assumed=list(origin.assumed),
        )


class WalkReportOut(Out):
    """What map building found out about one survey walk."""

    walk_id: str
    n_steps: int
    length_m: float
    offset: Annotated[list[float], Field(description="Estimated field offset of the walk, body frame, uT.")]
    residual_rms: Annotated[float, Field(description="uT.")]
    rejected: Annotated[str | None, Field(description="Why the walk was left out, if it was.")]
    stride_scale: Annotated[
        float | None, Field(description="Stride of the walker over the model's; null if the walk does not tell.")
    ]

    @classmethod
    def of(cls, report: WalkReport) -> Self:
        """Show a report."""
        return cls(
            walk_id=report.walk_id,
            n_steps=report.n_steps,
            length_m=report.length_m,
            offset=list(report.offset),
            residual_rms=report.residual_rms,
            rejected=report.rejected,
            stride_scale=report.stride_scale,
        )


class MapOut(Out):
    """A finished map version, without its cells. Node `[r, c]` lies at `(x0 + c*cell_m, y0 + r*cell_m)`."""

    model_config = example(_MAP)

    id: str
    level_id: str
    version: int
    parent_id: str | None
    hash: Annotated[str, Field(description="Of the content: equal maps have equal hashes.")]
    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    rows: int
    columns: int
    mapped_m: float
    noise_sd: Annotated[list[float], Field(description="Repeatability of the field per channel, uT.")]
    mapped_share: float
    mapped_area_m2: float
    n_walks: int
    n_samples: int
    length_scale_m: float
    field_sd: list[float]
    walks: list[WalkReportOut]
    build_s: float
    kind: Annotated[MapKind, Field(description="Built from all walks, or its parent brought up to date.")]
    added: Annotated[
        list[str], Field(description="Walks that went into it (of an update: that its parent lacked), fit or not.")
    ]
    removed: Annotated[list[str], Field(description="Walks of its parent that an update took out.")]
    n_transmitters: Annotated[
        int | None, Field(description="Access points and beacons of the radio layer; null without radio in the survey.")
    ]
    radio_cell_m: Annotated[float | None, Field(description="Distance of the radio layer's nodes.")]
    n_routes: Annotated[
        int | None, Field(description="Survey lines kept with the map; sequence methods compare with them.")
    ]
    origin: Annotated[
        MapOriginOut | None, Field(description="Of an imported map; null for maps built from surveys.")
    ] = None
    created_at: Time

    @classmethod
    def of(cls, info: records.MapInfo) -> Self:
        """Show a map version."""
        plain = {item.name: getattr(info, item.name) for item in fields(info) if item.name != "model"}
        lists = {
            "noise_sd": list(info.noise_sd),
            "added": list(info.added),
            "removed": list(info.removed),
            "field_sd": list(info.field_sd),
            "walks": [WalkReportOut.of(report) for report in info.walks],
            "origin": None if info.origin is None else MapOriginOut.of(info.origin),
        }
        return cls(**{**plain, **lists})


class MapPage(PageOut):
    """Map versions, newest first."""

    model_config = example({"items": [_MAP], "next_cursor": None})

    items: list[MapOut]


class CoverageOut(Out):
    """Which nodes are mapped. `runs` are lengths of alternating runs, row by row from row 0, unmapped first."""

    model_config = example(COVERAGE_EXAMPLE)

    map_id: str
    rows: int
    columns: int
    x0: float
    y0: float
    cell_m: float
    mapped_m: float
    mapped_share: float
    mapped_area_m2: float
    runs: list[int]
