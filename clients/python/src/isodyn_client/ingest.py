"""Phones that push: their tokens, what they recorded, and the markers of levels; models, and the calls of the API."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike

from isodyn_client.calls import Call, Listing, as_model, nothing, present
from isodyn_client.encoding import json_body
from isodyn_client.models import Model, Page, Prior

_TOKENS = "/v1/ingest-tokens"
_RECORDINGS = "/v1/recordings"
_PAGE = 100


class IngestToken(Model):
    """What lets one device push recordings for one purpose to one place; the secret is told once, when it is made.

    ``app`` is ``sensor-logger`` or ``phyphox``, ``purpose`` ``locate`` or ``survey``, ``frame`` (signs of the
    accelerometer) ``android``, ``ios`` or ``standardised``, ``build`` (what follows a survey walk) ``none``, ``draft``
    or ``publish``.
    """

    id: str
    name: str
    app: str
    purpose: str
    device_id: str
    venue_id: str
    level_id: str | None = None
    survey_id: str | None = None
    frame: str
    prior: Prior | None = None
    contribute: bool
    build: str
    route: tuple[str, ...] = ()
    created_at: datetime
    last_used_at: datetime | None = None
    revoked_at: datetime | None = None


class NewIngestToken(IngestToken):
    """A token just made: the only time its secret is told, alone and within the ``url`` that the phone is given."""

    token: str
    url: str
    settings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"NewIngestToken(id={self.id!r}, name={self.name!r}, token='...')"


class Annotation(Model):
    """What the person with the phone noted at a moment."""

    t_ms: float
    text: str


class Recording(Model):
    """One recording of a phone; ``state`` is ``open``, ``closed``, or ``waiting`` (a survey without waypoints).

    ``problem`` says in words what is wrong; empty: nothing.
    """

    id: str
    token_id: str
    device_id: str
    app_session: str
    purpose: str
    venue_id: str
    level_id: str | None = None
    session_id: str | None = None
    survey_id: str | None = None
    walk_ids: tuple[str, ...] = ()
    state: str
    problem: str = ""
    n_messages: int
    n_late: int
    n_samples: int
    annotations: tuple[Annotation, ...] = ()
    opened_at: datetime
    last_at: datetime
    closed_at: datetime | None = None


class Marker(Model):
    """A marked point of a level; metres, level frame."""

    name: str
    x: float
    y: float


class Markers(Model):
    """The marked points of a level, by name."""

    markers: tuple[Marker, ...] = ()


def create_ingest_token(
    name: str,
    device_id: str,
    *,
    app: str = "sensor-logger",
    level_id: str | None = None,
    venue_id: str | None = None,
    purpose: str | None = None,
    survey_id: str | None = None,
    frame: str | None = None,
    prior: Prior | None = None,
    contribute: bool | None = None,
    build: str | None = None,
    route: Sequence[str] | None = None,
) -> Call[NewIngestToken]:
    """Make the address that one phone pushes to, on a level or (to locate) anywhere in a venue.

    For a survey without a ``survey_id`` a survey is made; ``route`` names markers in the order in which they are
    walked. Not sent again when an answer is lost: a token nobody knows does no harm, and can be revoked.
    """
    fields = present(
        {
            "app": app,
            "level_id": level_id,
            "venue_id": venue_id,
            "purpose": purpose,
            "survey_id": survey_id,
            "frame": frame,
            "prior": None if prior is None else prior.model_dump(exclude_none=True),
            "contribute": contribute,
            "build": build,
            "route": None if route is None else list(route),
        }
    )
    body = json_body({"name": name, "device_id": device_id, **fields})
    return Call("POST", _TOKENS, as_model(NewIngestToken), body=body, repeatable=False)


def ingest_token(token_id: str) -> Call[IngestToken]:
    """One token, without its secret."""
    return Call("GET", f"{_TOKENS}/{token_id}", as_model(IngestToken))


def ingest_tokens(*, device_id: str | None = None) -> Listing[IngestToken]:
    """All tokens (of one device) without their secrets, newest first, revoked ones too."""
    params = present({"device_id": device_id, "limit": _PAGE})
    return Listing(Call("GET", _TOKENS, as_model(Page[IngestToken]), params=params))


def revoke_ingest_token(token_id: str) -> Call[None]:
    """Make a token useless at once and for good; what it sent stays."""
    return Call("DELETE", f"{_TOKENS}/{token_id}", nothing)


def recordings(
    *,
    token_id: str | None = None,
    device_id: str | None = None,
    purpose: str | None = None,
    state: str | None = None,
) -> Listing[Recording]:
    """What phones pushed, newest first."""
    wanted = {"token_id": token_id, "device_id": device_id, "purpose": purpose, "state": state, "limit": _PAGE}
    return Listing(Call("GET", _RECORDINGS, as_model(Page[Recording]), params=present(wanted)))


def recording(recording_id: str) -> Call[Recording]:
    """Where a recording stands, and what is wrong with it."""
    return Call("GET", f"{_RECORDINGS}/{recording_id}", as_model(Recording))


def close_recording(recording_id: str) -> Call[Recording]:
    """End a recording now: its session is closed, or survey walks are made of it. Ending again changes nothing."""
    return Call("POST", f"{_RECORDINGS}/{recording_id}/close", as_model(Recording))


def set_recording_waypoints(recording_id: str, t_ms: ArrayLike, x: ArrayLike, y: ArrayLike) -> Call[Recording]:
    """Say where the phone was when: for a survey recording that is ``waiting``, in place of its annotations.

    ``t_ms`` Unix milliseconds; ``x``, ``y`` metres on the level.
    """
    named = (("t_ms", t_ms), ("x", x), ("y", y))
    columns = {name: np.asarray(column, dtype=np.float64).tolist() for name, column in named}
    path = f"{_RECORDINGS}/{recording_id}/waypoints"
    return Call("PUT", path, as_model(Recording), body=json_body(columns))


def markers(level_id: str) -> Call[Markers]:
    """The marked points of a level, by name."""
    return Call("GET", f"/v1/levels/{level_id}/markers", as_model(Markers))


def set_markers(level_id: str, markers: Iterable[Marker | tuple[str, float, float]]) -> Call[Markers]:
    """Put marked points (name, x, y in level metres) in place of what the level had.

    An annotation with a marker's name is a waypoint there; names are the same whatever their case.
    """
    rows = [(one.name, one.x, one.y) if isinstance(one, Marker) else one for one in markers]
    body = json_body({"markers": [{"name": name, "x": float(x), "y": float(y)} for name, x, y in rows]})
    return Call("PUT", f"/v1/levels/{level_id}/markers", as_model(Markers), body=body)
