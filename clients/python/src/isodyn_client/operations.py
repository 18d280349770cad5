"""What operators ask: statistics, alarms, and the ground truth of sessions; models and calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from isodyn_client.calls import Call, Listing, as_bytes, as_model, nothing, present
from isodyn_client.encoding import json_body
from isodyn_client.models import Model, Page

_PAGE = 100


class StatsTable(Model):
    """Rows about a stretch of time; docs/operations.md lists the columns of each table.

    ``complete_since``: more was stored than one call reads, and what lies before is missing; None: nothing is.
    """

    since: datetime | None = None
    until: datetime | None = None
    bucket: str | None = None
    complete_since: datetime | None = None
    items: tuple[Mapping[str, Any], ...]


class LevelStats(Model):
    """A level: sessions opened on it in the window, its walks, its map."""

    level_id: str
    venue_id: str
    name: str
    sessions: int
    last_session_at: datetime | None = None
    walks: int
    last_walk_at: datetime | None = None
    map_id: str | None = None
    map_version: int | None = None
    map_created_at: datetime | None = None
    map_age_days: float | None = None
    map_behind: bool


class Alarm(Model):
    """A rule that found something; ``severity`` is ``critical``, ``warning`` or ``info``."""

    rule: str
    severity: str
    subject: str
    message: str
    since: datetime | None = None
    remedy: str


class Alarms(Model):
    """What is worth attention now, the most severe first."""

    items: tuple[Alarm, ...]


class Told(Model):
    """What was told at a known position; a ``normalized_error`` of 2.45 is the edge of the 95 % ellipse."""

    x: float
    y: float
    level_id: str
    apart_ms: float
    error_m: float
    normalized_error: float
    inside: bool
    sure: bool
    status: str


class TruthPoint(Model):
    """A known position; ``fix`` is None while none lies within a second, and for good once it is ``settled``."""

    number: int
    t_ms: float
    x: float
    y: float
    level_id: str | None = None
    sd_m: float
    created_at: datetime
    settled: bool
    fix: Told | None = None


def stats_table(
    name: str,
    *,
    since: datetime | None = None,
    until: datetime | None = None,
    bucket: str | None = None,
    venue_id: str | None = None,
    level_id: str | None = None,
    device_id: str | None = None,
    method: str | None = None,
    by: Sequence[str] = (),
) -> Call[StatsTable]:
    """One table: ``throughput``, ``latency``, ``backlog``, ``errors``, ``fixes``, ``accuracy`` or ``storage``.

    ``bucket`` is ``minute``, ``hour`` or ``day``; ``by`` names ``level``, ``device``, ``method``. Which filters a table
    takes is in docs/operations.md; the others do nothing.
    """
    params = _params(since, until, bucket, venue_id, level_id, device_id, method, by)
    return Call("GET", f"/v1/stats/{name}", as_model(StatsTable), params=params)


def stats_csv(
    name: str,
    *,
    since: datetime | None = None,
    until: datetime | None = None,
    bucket: str | None = None,
    venue_id: str | None = None,
    level_id: str | None = None,
    device_id: str | None = None,
    method: str | None = None,
    by: Sequence[str] = (),
) -> Call[bytes]:
    """A table of statistics as CSV; beside those of :func:`stats_table` also ``levels`` and ``alarms``."""
    params = {**_params(since, until, bucket, venue_id, level_id, device_id, method, by), "format": "csv"}
    return Call("GET", f"/v1/stats/{name}", as_bytes, params=params)


def level_stats(
    *,
    since: datetime | None = None,
    until: datetime | None = None,
    venue_id: str | None = None,
    level_id: str | None = None,
) -> Listing[LevelStats]:
    """Levels with their traffic, their last survey walk, their map and its age; newest first."""
    params = {**_params(since, until, None, venue_id, level_id, None, None, ()), "limit": _PAGE}
    return Listing(Call("GET", "/v1/stats/levels", as_model(Page[LevelStats]), params=params))


def alarms() -> Call[Alarms]:
    """What is worth attention now, the most severe first."""
    return Call("GET", "/v1/stats/alarms", as_model(Alarms))


def add_ground_truth(
    session_id: str,
    t_ms: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    *,
    level_id: Sequence[str | None] | None = None,
    sd_m: ArrayLike | None = None,
) -> Call[Page[TruthPoint]]:
    """Say where a session was at some times (at most 500 a call): each is compared with its fixes.

    ``t_ms`` is Unix milliseconds on the clock of the samples, ``x`` and ``y`` level metres, ``sd_m`` the standard
    deviation of the place itself. A point of the same time as an earlier one takes its place.
    """
    columns = {"t_ms": t_ms, "x": x, "y": y, "sd_m": sd_m}
    body = {
        name: None if column is None else np.atleast_1d(np.asarray(column, dtype=np.float64)).tolist()
        for name, column in columns.items()
    }
    body["level_id"] = None if level_id is None else list(level_id)
    path = f"/v1/sessions/{session_id}/ground-truth"
    return Call("POST", path, as_model(Page[TruthPoint]), body=json_body(present(body)))


def ground_truth(session_id: str) -> Listing[TruthPoint]:
    """Known positions of a session with what was told there, oldest first."""
    path = f"/v1/sessions/{session_id}/ground-truth"
    return Listing(Call("GET", path, as_model(Page[TruthPoint]), params={"limit": _PAGE}))


def forget_ground_truth(session_id: str) -> Call[None]:
    """Delete the known positions of a session."""
    return Call("DELETE", f"/v1/sessions/{session_id}/ground-truth", nothing)


def _params(
    since: datetime | None,
    until: datetime | None,
    bucket: str | None,
    venue_id: str | None,
    level_id: str | None,
    device_id: str | None,
    method: str | None,
    by: Sequence[str],
) -> dict[str, Any]:
    given = {
        "since": since and since.isoformat(),
        "until": until and until.isoformat(),
        "bucket": bucket,
        "venue_id": venue_id,
        "level_id": level_id,
        "device_id": device_id,
        "method": method,
        "by": list(by) or None,
    }
    return present(given)
