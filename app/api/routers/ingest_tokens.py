"""Ingest tokens."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import has_scope, needs
from app.api.deps import KeyDep, ServicesDep
from app.api.ingest import settings_of, url_of
from app.api.pagination import PagingDep, link_next
from app.api.qr_codes import qr_svg, qr_text
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.ingest import IngestTokenIn, IngestTokenOut, IngestTokenPage, NewIngestTokenOut
from app.services.errors import ForbiddenError
from app.services.ingest.records import Purpose
from app.services.records import Scope

router = api_router("ingest")


@router.post(
    "/v1/ingest-tokens",
    status_code=201,
    summary="Make an ingest token",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
)
def create_ingest_token(
    body: IngestTokenIn, request: Request, services: ServicesDep, key: KeyDep, response: Response
) -> NewIngestTokenOut:
    """Make the address that one phone pushes to; the secret in it is in this answer only.

    It lets this device send recordings for this purpose to this place, and nothing else. A token for surveys needs a
    key with `survey`.
    """
    if body.purpose is Purpose.SURVEY and not has_scope(key, Scope.SURVEY):
        raise ForbiddenError(Scope.SURVEY.value)
    made = services.ingest_tokens.create(body.new(), key.id)
    response.headers["Location"] = f"/v1/ingest-tokens/{made.token.id}"
    response.headers["Cache-Control"] = "no-store"
    shown = IngestTokenOut.of(made.token).model_dump()
    url = url_of(str(request.base_url), made.token.app, made.secret)
    told = {"token": made.secret, "url": url, "qr_svg": qr_svg(qr_text(made.token.app, url))}
    return NewIngestTokenOut(**shown, **told, settings=settings_of(made.token))


@router.get(
    "/v1/ingest-tokens",
    summary="List ingest tokens",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.INVALID),
)
def list_ingest_tokens(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    device_id: Annotated[str | None, Query(description="Of this device only.")] = None,
) -> IngestTokenPage:
    """Tokens without their secrets, newest first, revoked ones too."""
    page = services.ingest_tokens.list(device_id, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return IngestTokenPage(items=[IngestTokenOut.of(token) for token in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/ingest-tokens/{token_id}",
    summary="Read an ingest token",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def get_ingest_token(token_id: str, services: ServicesDep) -> IngestTokenOut:
    """One token without its secret."""
    return IngestTokenOut.of(services.ingest_tokens.get(token_id))


@router.delete(
    "/v1/ingest-tokens/{token_id}",
    status_code=204,
    summary="Revoke an ingest token",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def revoke_ingest_token(token_id: str, services: ServicesDep) -> None:
    """Make a token useless at once and for good; what it sent stays."""
    services.ingest_tokens.revoke(token_id)
