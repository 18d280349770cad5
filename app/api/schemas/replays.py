"""Replays of sessions on other map versions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from pydantic import Field

from app.api.schemas.base import IdRef, In, Out, example
from app.api.schemas.fixes import FIXES_EXAMPLE, FixesOut, fix_columns
from app.api.schemas.levels import LEVEL_ID
from app.api.schemas.maps import MAP_ID
from app.api.schemas.places import LevelMapOut, MapIdOut, MapsOut, maps_object
from app.api.schemas.sessions import SESSION_ID
from app.api.schemas.versions import OLDER_MAP_ID
from app.engine.localization.comparison import Distances, FixComparison
from app.engine.localization.registry import DEFAULT_METHOD
from app.engine.types import Status
from app.services.places import MAX_LEVELS
from app.services.records import Replay

_DISTANCES = {"n": 118, "p50": 0.4, "p90": 1.3, "largest": 2.2}
_COMPARISON: dict[str, Any] = {
    "n_then": 120,
    "n_now": 120,
    "n_compared": 120,
    "n_other_level": 0,
    "distance": _DISTANCES,
    "sure_distance": _DISTANCES | {"n": 90},
    "status_then": {"ok": 0.8, "insufficient": 0.2},
    "status_now": {"ok": 0.9, "insufficient": 0.1},
    "sure_then": 0.75,
    "sure_now": 0.85,
}


class ReplayIn(In):
    """Map versions to replay on; without any, the current ones."""

    model_config = example({"map_id": OLDER_MAP_ID})

    map_id: Annotated[IdRef | None, Field(description="A version of a level of the session.")] = None
    map_ids: Annotated[
        tuple[IdRef, ...],
        Field(max_length=MAX_LEVELS, description="Or several, at most one a level; other levels keep the map of then."),
    ] = ()


class DistancesOut(Out):
    """Distances of pairs of fixes, m."""

    n: int
    p50: float
    p90: float
    largest: float


class FixComparisonOut(Out):
    """What was told then and what is told now, fix by fix where their times agree. Shares are 0 to 1."""

    n_then: int
    n_now: int
    n_compared: Annotated[int, Field(description="Pairs of one time.")]
    n_other_level: Annotated[int, Field(description="Pairs on different levels: they have no distance.")]
    distance: Annotated[DistancesOut | None, Field(description="Of pairs on one level; null without any.")]
    sure_distance: Annotated[DistancesOut | None, Field(description="Of those that are sure on both maps.")]
    status_then: Annotated[dict[Status, float], Field(description="Share of the fixes by status.")]
    status_now: dict[Status, float]
    sure_then: float
    sure_now: float


class ReplayOut(Out):
    """A session's fixes on other maps, and how they compare with those that were told then."""

    model_config = example(
        {
            "session_id": SESSION_ID,
            "map_id": OLDER_MAP_ID,
            "maps": [{"level_id": LEVEL_ID, "map_id": OLDER_MAP_ID}],
            "maps_then": [{"level_id": LEVEL_ID, "map_id": MAP_ID}],
            "method": DEFAULT_METHOD,
            "fixes": FIXES_EXAMPLE,
            "comparison": _COMPARISON,
        }
    )

    session_id: str
    map_id: MapIdOut
    maps: MapsOut
    maps_then: Annotated[list[LevelMapOut], Field(description="The map versions that the session is pinned to.")]
    method: str
    fixes: Annotated[FixesOut, Field(description="As `positions` of the kind `filtered` would be.")]
    comparison: FixComparisonOut


def replay_object(replay: Replay) -> dict[str, Any]:
    """Return the answer as plain values, the shape of ReplayOut."""
    return {
        "session_id": replay.session_id,
        **maps_object(replay.level_id, replay.maps),
        "maps_then": [{"level_id": one.level_id, "map_id": one.map_id} for one in replay.maps_then],
        "method": replay.method,
        "fixes": fix_columns(replay.fixes),
        "comparison": _comparison_object(replay.comparison),
    }


def _comparison_object(comparison: FixComparison) -> dict[str, Any]:
    counts = {name: getattr(comparison, name) for name in ("n_then", "n_now", "n_compared", "n_other_level")}
    return {
        **counts,
        "distance": _distances_object(comparison.distance),
        "sure_distance": _distances_object(comparison.sure_distance),
        "status_then": _shares(comparison.status_then),
        "status_now": _shares(comparison.status_now),
        "sure_then": round(comparison.sure_then, 4),
        "sure_now": round(comparison.sure_now, 4),
    }


def _distances_object(distances: Distances | None) -> dict[str, float] | None:
    return None if distances is None else {name: round(value, 3) for name, value in asdict(distances).items()}


def _shares(shares: Mapping[Status, float]) -> dict[str, float]:
    return {status.value: round(share, 4) for status, share in shares.items()}
