"""Where sessions are, as it is told to watchers of many (``GET /v1/live``)."""

from __future__ import annotations

from collections.abc import Mapping

LIVE = "/v1/live"


def live_params(venue_id: str | None = None, level_id: str | None = None) -> Mapping[str, str]:
    """Query of a stream over the sessions of a venue or level."""
    given = {"venue_id": venue_id, "level_id": level_id}
    return {name: value for name, value in given.items() if value is not None}
