"""What both clients know about the service: address, key, timeouts; and what a call looks like on the wire."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Self

import httpx

from isodyn_client.calls import Call

DEFAULT_URL = "http://127.0.0.1:8080"
_LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})


def _user_agent() -> str:
    try:
        return f"isodyn-client/{version('isodyn-client')}"
    except PackageNotFoundError:  # run from the source tree
        return "isodyn-client"


@dataclass(frozen=True, slots=True)
class Connection:
    """Address, key and timeout of a service."""

    url: str
    key: str | None
    timeout_s: float

    @classmethod
    def choose(cls, url: str | None, key: str | None, timeout_s: float) -> Self:
        """What was given, else ``ISODYN_URL`` and ``ISODYN_KEY``, else the service's default address."""
        return cls(
            url=(url or os.environ.get("ISODYN_URL") or DEFAULT_URL).rstrip("/"),
            key=key or os.environ.get("ISODYN_KEY") or None,
            timeout_s=timeout_s,
        )

    def __repr__(self) -> str:
        return f"Connection({self.url!r}, key={'set' if self.key else 'not set'})"

    def options(self) -> dict[str, Any]:
        """Arguments of an httpx client."""
        headers = {"User-Agent": _user_agent(), "Accept": "application/json"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        # A proxy of the environment cannot mean this very machine.
        beyond = httpx.URL(self.url).host not in _LOOPBACK
        return {"base_url": self.url, "headers": headers, "timeout": self.timeout_s, "trust_env": beyond}

    def request(self, call: Call[Any]) -> dict[str, Any]:
        """Arguments of a request, without its body."""
        body_headers = call.body.headers if call.body is not None else {}
        return {
            "method": call.method,
            "url": call.path,
            "params": dict(call.params) or None,
            "headers": {**body_headers, **call.headers},
            "timeout": httpx.Timeout(self.timeout_s, read=self.timeout_s + call.wait_s),
        }
