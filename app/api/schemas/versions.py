"""Versions of a level's map: what is published, who contributed, what changed."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Annotated, Any, Self

from pydantic import Field

from app.api.schemas.base import IdRef, In, Out, PageOut, Time, example
from app.api.schemas.devices import DEVICE_ID
from app.api.schemas.levels import LEVEL_ID, ExtentOut
from app.api.schemas.maps import MAP_ID
from app.api.schemas.surveys import SURVEY_ID, WALK_ID
from app.api.validation import LINE_PATTERN
from app.engine.mapping.diff import ChangeStatistics, Component, DiffSummary
from app.engine.types import FeatureSet, SourceKind
from app.services import records

OLDER_MAP_ID = "map_019ab2a0d1e07f3a9b2c4d5e6f"
MAX_SHOWN_SOURCES = 100
_PUBLICATION = {
    "id": "pub_019ab2c4d1e07f3a9b2c4d5e6f",
    "level_id": LEVEL_ID,
    "map_id": MAP_ID,
    "from_map_id": OLDER_MAP_ID,
    "key_id": "key_019ab2c4d1e07f3a9b2c4d5e6f",
    "note": "after the second survey",
    "created_at": "2026-11-22T09:30:00.000Z",
}
_SOURCE = {
    "id": WALK_ID,
    "kind": "survey",
    "survey_id": SURVEY_ID,
    "device_id": DEVICE_ID,
    "contributor": None,
    "n_samples": 236,
    "n_used": 236,
    "rejected": None,
}
_CHANGE = {"component": "all", "mean": 1.4, "rms": 2.1, "p95": 4.4, "largest": 14.9}
DIFF_EXAMPLE: dict[str, Any] = {
    "map_id": MAP_ID,
    "against": OLDER_MAP_ID,
    "identical": False,
    "features": "vector",
    "cell_m": 0.5,
    "least_ut": 1.0,
    "compared": {"nodes": 19840, "area_m2": 4960.0},
    "changed": {"nodes": 120, "area_m2": 30.0},
    "significant": {"nodes": 96, "area_m2": 24.0},
    "newly_mapped": {"nodes": 400, "area_m2": 100.0},
    "no_longer_mapped": {"nodes": 0, "area_m2": 0.0},
    "box": {"x_min": 12.0, "y_min": 4.0, "x_max": 21.5, "y_max": 9.0},
    "change": [_CHANGE],
    "tiles": {"shared": 12, "new": 3, "gone": 3},
    "sources": {"n_added": 1, "n_removed": 0, "added": [WALK_ID], "removed": []},
    "settings": [{"name": "mapped_m", "now": 1.5, "then": 2.0}],
}


class PublicationIn(In):
    """A version to publish on a level."""

    model_config = example({"map_id": MAP_ID, "note": "after the second survey"})

    map_id: Annotated[IdRef, Field(description="Any version of the level; an older one rolls back.")]
    note: Annotated[str, Field(max_length=500, pattern=LINE_PATTERN, description="Why, for the log.")] = ""


class PublicationOut(Out):
    """A version became the one that new sessions on its level use."""

    model_config = example(_PUBLICATION)

    id: str
    level_id: str
    map_id: str
    from_map_id: Annotated[str | None, Field(description="The version before; null for a level's first.")]
    key_id: Annotated[str | None, Field(description="Who published it; null: the service, unasked.")]
    note: Annotated[str, Field(description="`built` if its build published it.")]
    created_at: Time

    @classmethod
    def of(cls, publication: records.Publication) -> Self:
        """Show a publication."""
        return cls(**asdict(publication))


class PublicationPage(PageOut):
    """Publications of a level, newest first."""

    model_config = example({"items": [_PUBLICATION], "next_cursor": None})

    items: list[PublicationOut]


class MapSourceOut(Out):
    """Who contributed to a map version."""

    model_config = example(_SOURCE)

    id: Annotated[str, Field(description="Of the survey walk or the contribution.")]
    kind: SourceKind
    survey_id: Annotated[str | None, Field(description="Null if the walk was deleted since.")]
    device_id: str | None
    contributor: Annotated[str | None, Field(description="The key that answers for a session's contribution.")]
    n_samples: Annotated[int | None, Field(description="Placed field samples; null in maps of before they were kept.")]
    n_used: Annotated[int | None, Field(description="Of these, how many have some weight in the map.")]
    rejected: Annotated[str | None, Field(description="Why it was left out, if it was.")]

    @classmethod
    def of(cls, source: records.MapSource) -> Self:
        """Show a source."""
        return cls(**asdict(source))


class MapSourcePage(PageOut):
    """Sources of a map version, in the order of its evidence."""

    model_config = example({"items": [_SOURCE], "next_cursor": None})

    items: list[MapSourceOut]


class AreaOut(Out):
    """So many nodes, and the area they stand for."""

    nodes: int
    area_m2: float

    @classmethod
    def of(cls, nodes: int, cell_m: float) -> Self:
        """Nodes ``cell_m`` apart."""
        return cls(nodes=nodes, area_m2=round(nodes * cell_m**2, 3))


class ChangeOut(Out):
    """Change of one component where both versions are mapped, uT (new minus old)."""

    component: Annotated[Component, Field(description="`all`: the length of the vector of all channels.")]
    mean: float
    rms: float
    p95: Annotated[float, Field(description="95 % of the nodes changed by less.")]
    largest: float

    @classmethod
    def of(cls, change: ChangeStatistics) -> Self:
        """Show the statistics of a component."""
        numbers = {item.name: round(getattr(change, item.name), 4) for item in fields(change)[1:]}
        return cls(component=change.component, **numbers)


class TileCountsOut(Out):
    """Stored tiles by content: equal ones are stored once."""

    shared: int
    new: int
    gone: int


class SourceChangeOut(Out):
    """Sources in use that came and went; `GET /v1/maps/{map_id}/sources` lists all."""

    n_added: int
    n_removed: int
    added: Annotated[list[str], Field(description=f"The first {MAX_SHOWN_SOURCES}.")]
    removed: Annotated[list[str], Field(description=f"The first {MAX_SHOWN_SOURCES}.")]

    @classmethod
    def of(cls, change: records.Change[str]) -> Self:
        """Show what came and went."""
        return cls(
            n_added=len(change.added),
            n_removed=len(change.removed),
            added=list(change.added[:MAX_SHOWN_SOURCES]),
            removed=list(change.removed[:MAX_SHOWN_SOURCES]),
        )


class SettingChangeOut(Out):
    """A setting in which the builds differ."""

    name: str
    now: Any
    then: Any


class DiffOut(Out):
    """What differs between a version and another one of its level, in the features that both tell."""

    model_config = example(DIFF_EXAMPLE)

    map_id: str
    against: Annotated[str, Field(description="The version that it is compared with.")]
    identical: Annotated[bool, Field(description="Whether both have the same content.")]
    features: FeatureSet
    cell_m: float
    least_ut: Annotated[float, Field(description="A node is changed if its field moved by more than this.")]
    compared: Annotated[AreaOut, Field(description="Mapped in both versions.")]
    changed: AreaOut
    significant: Annotated[
        AreaOut, Field(description="Of these, changed by more than two combined standard deviations.")
    ]
    newly_mapped: AreaOut
    no_longer_mapped: AreaOut
    box: Annotated[ExtentOut | None, Field(description="Encloses all that differs; null: nothing does.")]
    change: list[ChangeOut]
    tiles: TileCountsOut
    sources: SourceChangeOut
    settings: list[SettingChangeOut]

    @classmethod
    def of(cls, diff: records.VersionDiff) -> Self:
        """Show a difference."""
        summary = diff.field
        return cls(
            map_id=diff.map_id,
            against=diff.against,
            identical=diff.identical,
            features=summary.features,
            cell_m=summary.cell_m,
            least_ut=summary.least_ut,
            **{name: AreaOut.of(getattr(summary, name), summary.cell_m) for name in _AREAS},
            box=_box(summary),
            change=[ChangeOut.of(one) for one in summary.change],
            tiles=TileCountsOut(**asdict(diff.tiles)),
            sources=SourceChangeOut.of(diff.sources),
            settings=[SettingChangeOut(**asdict(one)) for one in diff.settings],
        )


_AREAS = ("compared", "changed", "significant", "newly_mapped", "no_longer_mapped")


def _box(summary: DiffSummary) -> ExtentOut | None:
    if summary.box is None:
        return None
    x_min, y_min, x_max, y_max = summary.box
    return ExtentOut(x_min=x_min, y_min=y_min, x_max=x_max, y_max=y_max)
