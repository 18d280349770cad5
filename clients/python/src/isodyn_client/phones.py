"""Phones that push: tokens, recordings, markers of levels; models and calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from isodyn_client.calls import Call, Listing, as_model, nothing, present
from isodyn_client.encoding import json_body
from isodyn_client.models import Model, Page

_TOKENS = "/v1/ingest-tokens"
_RECORDINGS = "/v1/recordings"
_PAGE = 100


class IngestToken(Model):
    """What one phone may send to where."""

    id: str
    name: str
    app: str
    purpose: str
    device_id: str
    venue_id: str
    level_id: str | None = None
    survey_id: str | None = None
    frame: str
    contribute: bool
    build: str
    route: tuple[str, ...]
    created_at: datetime
    last_used_at: datetime | None = None
    revoked_at: datetime | None = None


class NewIngestToken(IngestToken):
    """A token just made: ``token`` and ``url`` are told this once; ``settings`` are what to choose in the app."""

    token: str
    url: str
    qr_svg: str
    settings: tuple[str, ...]


class PhoneRecording(Model):
    """One recording of a phone: where it stands, what is wrong with it, what was made of it."""

    id: str
    token_id: str
    device_id: str
    purpose: str
    level_id: str | None = None
    session_id: str | None = None
    survey_id: str | None = None
    walk_ids: tuple[str, ...]
    state: str
    problem: str
    n_messages: int
    n_samples: int
    annotations: tuple[Mapping[str, Any], ...]
    opened_at: datetime
    last_at: datetime
    closed_at: datetime | None = None


class Marker(Model):
    """A named point of a level, m."""

    name: str
    x: float
    y: float


class Markers(Model):
    """The named points of a level."""

    markers: tuple[Marker, ...]


def create_ingest_token(
    name: str,
    *,
    app: str,
    device_id: str,
    purpose: str = "locate",
    venue_id: str | None = None,
    level_id: str | None = None,
    survey_id: str | None = None,
    frame: str = "android",
    build: str | None = None,
    route: Sequence[str] = (),
) -> Call[NewIngestToken]:
    """Make the address that one phone pushes to; of ``app`` ``sensor-logger``, ``phyphox`` or ``mqtt``."""
    places = {"venue_id": venue_id, "level_id": level_id, "survey_id": survey_id, "build": build}
    said = {"name": name, "app": app, "purpose": purpose, "device_id": device_id, "frame": frame, "route": list(route)}
    body = json_body({**said, **present(places)})
    return Call("POST", _TOKENS, as_model(NewIngestToken), body=body, repeatable=False)


def ingest_tokens(device_id: str | None = None) -> Listing[IngestToken]:
    """Tokens without their secrets, newest first."""
    params = present({"device_id": device_id, "limit": _PAGE})
    return Listing(Call("GET", _TOKENS, as_model(Page[IngestToken]), params=params))


def ingest_token(token_id: str) -> Call[IngestToken]:
    """One token without its secret."""
    return Call("GET", f"{_TOKENS}/{token_id}", as_model(IngestToken))


def revoke_ingest_token(token_id: str) -> Call[None]:
    """Make a token useless, at once and for good."""
    return Call("DELETE", f"{_TOKENS}/{token_id}", nothing)


def recordings(
    *, token_id: str | None = None, device_id: str | None = None, purpose: str | None = None, state: str | None = None
) -> Listing[PhoneRecording]:
    """Recordings of phones, newest first."""
    wanted = {"token_id": token_id, "device_id": device_id, "purpose": purpose, "state": state, "limit": _PAGE}
    return Listing(Call("GET", _RECORDINGS, as_model(Page[PhoneRecording]), params=present(wanted)))


def recording(recording_id: str) -> Call[PhoneRecording]:
    """Where a recording stands."""
    return Call("GET", f"{_RECORDINGS}/{recording_id}", as_model(PhoneRecording))


def close_recording(recording_id: str) -> Call[PhoneRecording]:
    """End a recording now: its session is closed, or survey walks are made of it."""
    return Call("POST", f"{_RECORDINGS}/{recording_id}/close", as_model(PhoneRecording))


def set_recording_waypoints(recording_id: str, t_ms: ArrayLike, x: ArrayLike, y: ArrayLike) -> Call[PhoneRecording]:
    """Say where the phone was when: for a survey recording that waits for it."""
    columns = {
        name: np.asarray(values, dtype=np.float64).tolist()
        for name, values in zip(("t_ms", "x", "y"), (t_ms, x, y), strict=True)
    }
    return Call("PUT", f"{_RECORDINGS}/{recording_id}/waypoints", as_model(PhoneRecording), body=json_body(columns))


def markers(level_id: str) -> Call[Markers]:
    """Named points of a level."""
    return Call("GET", f"/v1/levels/{level_id}/markers", as_model(Markers))


def set_markers(level_id: str, points: Mapping[str, tuple[float, float]]) -> Call[Markers]:
    """Put these named points (name to x, y in metres) in place of what the level had."""
    rows = [{"name": name, "x": x, "y": y} for name, (x, y) in points.items()]
    return Call("PUT", f"/v1/levels/{level_id}/markers", as_model(Markers), body=json_body({"markers": rows}))
