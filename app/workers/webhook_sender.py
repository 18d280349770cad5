"""Sends one message to one webhook: signed, within a time limit, to where it may go, and never further.

A name is looked up here, once a message, and the connection is made to the very address that was checked: a name that
means something else a moment later leads nowhere. The certificate is still that of the name.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import socket
import time
from collections.abc import Awaitable, Callable, Sequence
from types import TracebackType
from typing import Self

import httpx

from app.services.webhook_addresses import is_public
from app.services.webhook_records import Attempt, Delivery, Webhook

Resolve = Callable[[str, int], Awaitable[Sequence[str]]]
"""Addresses of a host name and port; OSError if there are none."""

SIGNATURE = "Isodyn-Signature"
_MAX_ADDRESSES = 3
_PORTS = {"http": 80, "https": 443}


class RefusedError(Exception):
    """The service's settings do not allow to send there."""


def signature(secret: str, t: int, body: bytes) -> str:
    """Value of the signature header: time in Unix seconds, and the HMAC-SHA256 of time, a dot and the body."""
    mac = hmac.new(secret.encode(), f"{t}.".encode() + body, hashlib.sha256)
    return f"t={t},v1={mac.hexdigest()}"


async def look_up(host: str, port: int) -> Sequence[str]:
    """Addresses of a host, in the system's order, each once."""
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(address[0]) for *_, address in found))


class WebhookSender:
    """Sends messages; used within one event loop, as a context.

    Parameters
    ----------
    private_networks : bool
        Whether plain http and addresses inside the service's own network are allowed.
    timeout_s : float
        For all of one attempt: looking up, connecting, sending, and the head of the answer.
    resolve, clock, transport
        For tests.
    """

    def __init__(
        self,
        *,
        private_networks: bool,
        timeout_s: float,
        resolve: Resolve = look_up,
        clock: Callable[[], float] = time.time,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self._private_networks = private_networks
        self._timeout_s = timeout_s
        self._resolve = resolve
        self._clock = clock
        self._transport = transport
        self._http: httpx.AsyncClient | None = None

    async def __aenter__(self) -> Self:
        # No connection is kept: it was made for one name, and another name at the same address may not use it.
        # No proxy of the environment: it would look names up by itself.
        self._http = httpx.AsyncClient(
            follow_redirects=False,
            trust_env=False,
            verify=httpx.create_ssl_context(),  # which asks the environment for certificates, as an operator expects
            timeout=self._timeout_s,
            limits=httpx.Limits(max_keepalive_connections=0),
            transport=self._transport,
        )
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._http is not None:
            await self._http.aclose()

    async def send(self, webhook: Webhook, delivery: Delivery) -> Attempt:
        """Send a message and say what came of it; anything but a 2xx answer is a failure."""
        try:
            async with asyncio.timeout(self._timeout_s):
                status = await self._post(webhook, delivery)
        except TimeoutError:
            return Attempt(None, f"no answer within {self._timeout_s:g} s")
        except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError, RefusedError) as error:
            return Attempt(None, f"{type(error).__name__}: {error}")
        if 300 <= status < 400:
            return Attempt(status, f"answered {status}: redirects are not followed, PATCH the webhook's url")
        return Attempt(status, None if 200 <= status < 300 else f"answered {status}")

    async def _post(self, webhook: Webhook, delivery: Delivery) -> int:
        url = httpx.URL(webhook.url)
        addresses = await self._allowed(url)
        for address in addresses[:-1]:
            try:
                return await self._post_to(address, url, webhook, delivery)
            except httpx.ConnectError:
                continue
        return await self._post_to(addresses[-1], url, webhook, delivery)

    async def _allowed(self, url: httpx.URL) -> Sequence[str]:
        host = url.raw_host.decode("ascii")
        addresses = await self._resolve(host, url.port or _PORTS.get(url.scheme, 443))
        if not self._private_networks:
            if url.scheme != "https":
                raise RefusedError("is not https")
            # one is enough: who answers with a public and a private address has a choice that is not his
            inside = [address for address in addresses if not is_public(address)]
            if inside:
                raise RefusedError(f"{host} leads to {inside[0]}, inside the service's own network")
        if not addresses:
            raise RefusedError(f"{host} has no address")
        return addresses[:_MAX_ADDRESSES]

    async def _post_to(self, address: str, url: httpx.URL, webhook: Webhook, delivery: Delivery) -> int:
        if self._http is None:
            raise RuntimeError("use the sender as a context: async with sender")
        body = delivery.body.encode()
        headers = {
            "Host": url.netloc.decode("ascii"),
            "User-Agent": "Isodyn-Webhooks",
            "Content-Type": "application/json",
            "Accept": "*/*",
            "Isodyn-Event": delivery.event.value,
            "Isodyn-Event-Id": delivery.event_id,
            "Isodyn-Delivery-Id": delivery.id,
            SIGNATURE: signature(webhook.secret, int(self._clock()), body),
        }
        name = url.raw_host.decode("ascii")
        extensions = {} if address == name.partition("%")[0] else {"sni_hostname": name}
        there = url.copy_with(host=address)
        # the status says it all: whatever body follows is not read, however long it is
        async with self._http.stream("POST", there, content=body, headers=headers, extensions=extensions) as answer:
            return answer.status_code
