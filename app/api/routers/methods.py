"""Methods: what the engine offers."""

from __future__ import annotations

from app.api import errors
from app.api.auth import any_key
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.methods import MethodOut, MethodPage
from app.engine.localization.registry import METHODS
from app.services.errors import NotFoundError

router = api_router("methods")


@router.get("/v1/methods", summary="List methods", dependencies=[any_key()], responses=guarded())
async def list_methods() -> MethodPage:
    """All positioning methods with their parameters."""
    return MethodPage(items=[MethodOut.of(method) for method in METHODS.values()])


@router.get(
    "/v1/methods/{name}", summary="Read a method", dependencies=[any_key()], responses=guarded(errors.NOT_FOUND)
)
async def get_method(name: str) -> MethodOut:
    """One method: what it needs, its parameters with types, ranges and defaults, its reference."""
    method = METHODS.get(name)
    if method is None:
        raise NotFoundError("method", name)
    return MethodOut.of(method)
