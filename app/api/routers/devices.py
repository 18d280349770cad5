"""Devices."""

from __future__ import annotations

from fastapi import Request, Response

from app.api import errors
from app.api.auth import needs
from app.api.deps import ServicesDep
from app.api.idempotency import IDEMPOTENCY_PARAMETER, CreationDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.devices import DeviceDetailOut, DeviceIn, DeviceOut, DevicePage
from app.services.records import Scope

router = api_router("devices")


@router.post(
    "/v1/devices",
    status_code=201,
    summary="Register a device",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(*OBJECT, errors.IDEMPOTENCY_REUSE),
    openapi_extra={"parameters": [IDEMPOTENCY_PARAMETER]},
)
def create_device(body: DeviceIn, services: ServicesDep, creation: CreationDep, response: Response) -> DeviceOut:
    """Register one physical sensor carrier; sessions and walks may name it."""
    device = creation.once(lambda: services.devices.create(body.name, body.model), services.devices.get)
    response.headers["Location"] = f"/v1/devices/{device.id}"
    return DeviceOut.of(device)


@router.get(
    "/v1/devices", summary="List devices", dependencies=[needs(Scope.LOCATE)], responses=guarded(errors.INVALID)
)
def list_devices(services: ServicesDep, paging: PagingDep, request: Request, response: Response) -> DevicePage:
    """Devices, newest first."""
    page = services.devices.list(paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return DevicePage(items=[DeviceOut.of(device) for device in page.items], next_cursor=page.next_cursor)


@router.get(
    "/v1/devices/{device_id}",
    summary="Read a device",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def get_device(device_id: str, services: ServicesDep) -> DeviceDetailOut:
    """One device, with what its closed sessions and survey walks taught about its magnetometer and carrier.

    `next_session` says what its next session starts with, and whether that comes from the device or from its model.
    """
    devices = services.devices
    return DeviceDetailOut.with_memories(
        devices.get(device_id), devices.memories(device_id), devices.next_start(device_id)
    )


@router.delete(
    "/v1/devices/{device_id}/calibrations",
    status_code=204,
    summary="Forget a device's calibrations",
    dependencies=[needs(Scope.LOCATE)],
    responses=guarded(errors.NOT_FOUND),
)
def forget_calibrations(device_id: str, services: ServicesDep) -> None:
    """Forget what sessions taught: the next session starts as with a new device.

    Sessions that are open keep what they started with; what they find out beyond it is remembered when they close.
    """
    services.devices.forget(device_id)
