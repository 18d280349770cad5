"""Models of devices. An offset tells phones apart, so these calls are not for everybody who locates."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.device_models import DeviceModelDetailOut, DeviceModelOut, DeviceModelPage
from app.services.records import Scope

router = api_router("devices")


@router.get(
    "/v1/device-models",
    summary="List models of devices",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.INVALID),
)
def list_device_models(
    services: ServicesDep, paging: PagingDep, request: Request, response: Response
) -> DeviceModelPage:
    """Models that devices name, by name."""
    page = services.device_models.list(paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return DeviceModelPage(items=[DeviceModelOut.of(model) for model in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/device-models/{name:path}",
    summary="Read a model of devices",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(errors.NOT_FOUND, errors.INVALID),
)
def get_device_model(
    name: Annotated[str, Path(max_length=200, description="As devices name it, also with a slash in it.")],
    services: ServicesDep,
) -> DeviceModelDetailOut:
    """One model, with what its devices have in common: mean, spread among devices, and what a new device starts with.

    No single device is told: there is no estimate of fewer than 3 devices that taught something.
    """
    return DeviceModelDetailOut.with_estimate(services.device_models.get(name))
