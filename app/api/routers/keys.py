"""API keys."""

from __future__ import annotations

from fastapi import Request, Response

from app.api import errors
from app.api.auth import any_key, needs
from app.api.deps import ContextDep, KeyDep, ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.keys import KeyIn, KeyOut, KeyPage, NewKeyOut
from app.services.records import Scope

router = api_router("keys")


@router.post(
    "/v1/keys",
    status_code=201,
    summary="Create a key",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(*OBJECT),
)
def create_key(body: KeyIn, services: ServicesDep, response: Response) -> NewKeyOut:
    """Create a key. Its secret is in this answer only: what is stored is its hash."""
    key, secret = services.accounts.create_key(body.name, body.scopes)
    response.headers["Location"] = f"/v1/keys/{key.id}"
    response.headers["Cache-Control"] = "no-store"
    return NewKeyOut(**KeyOut.of(key).model_dump(), secret=secret)


@router.get("/v1/keys", summary="List keys", dependencies=[needs(Scope.ADMIN)], responses=guarded(errors.INVALID))
def list_keys(services: ServicesDep, paging: PagingDep, request: Request, response: Response) -> KeyPage:
    """Keys without their secrets, newest first, revoked ones too."""
    page = services.accounts.list(paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return KeyPage(items=[KeyOut.of(key) for key in page.items], next_cursor=page.next_cursor)


@router.get("/v1/keys/current", summary="Read the key of the call", dependencies=[any_key()], responses=guarded())
def current_key(key: KeyDep) -> KeyOut:
    """The key that this call was made with, without its secret: what may a client do with the key it was given?"""
    return KeyOut.of(key)


@router.get(
    "/v1/keys/{key_id}",
    summary="Read a key",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def get_key(key_id: str, services: ServicesDep) -> KeyOut:
    """One key without its secret."""
    return KeyOut.of(services.accounts.get(key_id))


@router.delete(
    "/v1/keys/{key_id}",
    status_code=204,
    summary="Revoke a key",
    dependencies=[needs(Scope.ADMIN)],
    responses=guarded(errors.NOT_FOUND),
)
def revoke_key(key_id: str, context: ContextDep) -> None:
    """Make a key useless at once and for good; it stays in the list."""
    context.services.accounts.revoke(key_id)
    context.keys.forget_all()
