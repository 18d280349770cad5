"""Ingest tokens: secrets in push URLs, for applications that can set no header."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace
from datetime import datetime

from app.exchange.phones.places import marker_key
from app.services.accounts import hash_secret
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.errors import InvalidError
from app.services.ids import new_id
from app.services.ingest.records import IngestToken, NewToken, Purpose
from app.services.ports import UnitOfWork
from app.services.records import Page, Survey


@dataclass(frozen=True, slots=True)
class MadeToken:
    """A token with its secret, which is told this once."""

    token: IngestToken
    secret: str


class IngestTokenService(Service):
    """Make, list and revoke tokens. A token belongs to one device and does one thing in one place."""

    def create(self, new: NewToken, key_id: str) -> MadeToken:
        """Make a token; one for surveys without a ``survey_id`` gets a survey of its own name."""
        now = self._clock()
        secret = f"isi_{secrets.token_urlsafe(24)}"
        with self._uow(write=True) as uow:
            uow.devices.get(new.device_id)
            token = _checked(uow, new, key_id, now)
            if token.purpose is Purpose.SURVEY and token.survey_id is None and token.level_id is not None:
                survey = Survey(new_id("srv", now), token.level_id, new.name, n_walks=0, created_at=now)
                uow.surveys.add(survey)
                token = replace(token, survey_id=survey.id)
            uow.ingest.add_token(token, hash_secret(secret))
        return MadeToken(token, secret)

    def get(self, token_id: str) -> IngestToken:
        """One token."""
        with self._uow() as uow:
            return uow.ingest.get_token(token_id)

    def list(
        self, device_id: str | None = None, cursor: str | None = None, limit: int = DEFAULT_LIMIT
    ) -> Page[IngestToken]:
        """Tokens, newest first, revoked ones too."""
        with self._uow() as uow:
            return uow.ingest.list_tokens(device_id=device_id, cursor=cursor, limit=check_limit(limit))

    def revoke(self, token_id: str) -> IngestToken:
        """Make a token useless at once; what it sent stays. Revoking again changes nothing."""
        with self._uow(write=True) as uow:
            return uow.ingest.revoke_token(token_id, self._clock())


def _checked(uow: UnitOfWork, new: NewToken, key_id: str, now: datetime) -> IngestToken:
    venue_id = _venue_of(uow, new)
    if new.purpose is Purpose.SURVEY:
        _check_survey(uow, new)
    elif new.survey_id is not None or new.route:
        field = "survey_id" if new.survey_id is not None else "route"
        raise InvalidError(field, "means nothing for the purpose locate", "leave it out, or make a token for a survey")
    elif new.prior is not None and new.prior.x is not None and new.level_id is None:
        raise InvalidError("prior.x", "means nothing without a level", "send level_id, or leave x and y out")
    return IngestToken(
        id=new_id("igt", now),
        name=new.name,
        app=new.app,
        purpose=new.purpose,
        device_id=new.device_id,
        venue_id=venue_id,
        level_id=new.level_id,
        survey_id=new.survey_id,
        frame=new.frame,
        prior=new.prior,
        contribute=new.contribute,
        build=new.build,
        route=new.route,
        key_id=key_id,
        created_at=now,
        last_used_at=None,
        revoked_at=None,
    )


def _venue_of(uow: UnitOfWork, new: NewToken) -> str:
    if new.level_id is not None and new.venue_id is None:
        return uow.levels.get(new.level_id).venue_id
    if new.venue_id is not None and new.level_id is None:
        return uow.venues.get(new.venue_id).id
    what = "is missing, and so is venue_id" if new.level_id is None else "is sent beside venue_id"
    raise InvalidError("level_id", what, "send level_id, or venue_id for any level of a venue")


def _check_survey(uow: UnitOfWork, new: NewToken) -> None:
    if new.level_id is None:
        raise InvalidError("level_id", "is missing", "a survey is of one level: send its level_id")
    if new.prior is not None or new.contribute:
        field = "prior" if new.prior is not None else "contribute"
        raise InvalidError(field, "means nothing for a survey", "leave it out, or make a token to locate")
    if new.survey_id is not None and uow.surveys.get(new.survey_id).level_id != new.level_id:
        raise InvalidError("survey_id", "is of another level", f"name a survey of level {new.level_id}")
    known = {marker_key(marker.name) for marker in uow.ingest.markers(new.level_id)}
    for i, name in enumerate(new.route):
        if marker_key(name) not in known:
            remedy = "name markers that GET /v1/levels/{level_id}/markers lists, or set them first"
            raise InvalidError(f"route.{i}", f"{name!r} is no marker of the level", remedy)
