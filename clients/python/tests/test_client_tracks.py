from __future__ import annotations

import asyncio

import httpx
from conftest import FakeService
from isodyn_client import Client, FixKind


def test_a_track_as_a_file(service: FakeService, client: Client) -> None:
    service.will(httpx.Response(200, content=b"<gpx/>"), httpx.Response(200, content=b"{}"))
    assert client.track("ses_1", format="gpx", kind=FixKind.SMOOTHED) == b"<gpx/>"
    request = service.requests[0]
    assert (request.method, request.url.path) == ("GET", "/v1/sessions/ses_1/track")
    assert dict(request.url.params) == {"format": "gpx", "kind": "smoothed"}
    client.track("ses_1")
    assert dict(service.requests[1].url.params) == {"format": "geojson"}


def test_a_track_awaited(service: FakeService) -> None:
    async def run() -> bytes:
        async with service.async_client() as client:
            return await client.track("ses_1", format="csv")

    service.will(httpx.Response(200, content=b"number,seq"))
    assert asyncio.run(run()) == b"number,seq"
