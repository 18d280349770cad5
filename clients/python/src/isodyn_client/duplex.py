"""What is known of a session over all connections of a stream (docs/live.md); no input or output of its own."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import httpx
from pydantic import ValidationError

from isodyn_client.aids import Aids
from isodyn_client.connection import Connection
from isodyn_client.encoding import samples_body
from isodyn_client.errors import ConnectionFailedError, IsodynError, UnexpectedAnswerError, problem_from
from isodyn_client.follow import PlanFix
from isodyn_client.live import Place
from isodyn_client.models import SessionInfo
from isodyn_client.results import PositionPage
from isodyn_client.retry import RetryPolicy
from isodyn_client.samples import Samples

_TOO_MANY = 429


@dataclass(slots=True)
class Exchange:
    """Segments that the service may not have yet, and how far its fixes were told.

    Attributes
    ----------
    closing : bool
        The session is to be closed behind the last segment.
    session : SessionInfo or None
        The session when it is over.
    """

    connection: Connection
    session_id: str
    place: Place
    policy: RetryPolicy
    rng: random.Random
    closing: bool = False
    session: SessionInfo | None = None
    _next_seq: int | None = None
    """Number of the next segment; None: the service is to say."""
    _pending: dict[int, bytes] = field(default_factory=dict)
    _sent_to: int = 0
    """Pending segments below were sent over this connection."""
    _close_sent: bool = False
    _attempt: int = 0
    """Connections in a row that brought nothing."""
    _pause_s: float | None = None

    @property
    def url(self) -> str:
        """Address of the next connection."""
        base = "ws" + self.connection.url.removeprefix("http")
        return f"{base}/v1/sessions/{self.session_id}/stream?after={self.place.after}"

    @property
    def options(self) -> dict[str, Any]:
        """Headers, and whether a proxy may stand between, as ``connect`` of websockets takes them."""
        told = self.connection.options()
        headers = {name: value for name, value in told["headers"].items() if name == "Authorization"}
        return {"additional_headers": headers, "proxy": True if told["trust_env"] else None}

    @property
    def waiting(self) -> int:
        """How many segments the service may not have yet."""
        return len(self._pending)

    def queue(self, samples: Samples, aids: Aids | None) -> int:
        """Give a segment its number, and keep it until the service has it."""
        if self._next_seq is None:
            raise IsodynError("the stream is not connected; use it in a with block")
        seq = self._next_seq
        self._pending[seq] = b"".join(samples_body({"seq": seq}, samples, aids=aids).chunks())
        self._next_seq += 1
        return seq

    def unsent(self) -> Iterator[bytes | str]:
        """Messages to send over this connection, in order; each counts as sent from here on."""
        while (seq := self._sent_to) in self._pending:
            self._sent_to += 1
            yield self._pending[seq]
        if self.closing and not self._close_sent:
            self._close_sent = True
            yield json.dumps({"type": "close"})

    def take(self, message: str | bytes) -> list[PlanFix]:
        """Fixes that are new in a message; raises a refusal that will not pass."""
        try:
            value = json.loads(message)
            return self._took(value["type"], value)
        except (ValueError, KeyError, TypeError, ValidationError) as error:
            raise UnexpectedAnswerError(f"a message of the stream is not as this client knows it: {error}") from error

    def _took(self, kind: str, value: dict[str, Any]) -> list[PlanFix]:
        if kind == "problem":
            self._refused(value)
            return []
        self._attempt = 0
        if kind == "ready":
            self._ready(int(value["next_seq"]))
        elif kind == "accepted":
            self._pending.pop(int(value["seq"]), None)
        elif kind == "fixes":
            return self.place.fresh_of(PositionPage.model_validate(value))
        elif kind == "session":
            self.session = SessionInfo.model_validate(value["session"])
        return []

    def _ready(self, next_seq: int) -> None:
        self._pending = {seq: body for seq, body in self._pending.items() if seq >= next_seq}
        self._next_seq = max([next_seq, *(seq + 1 for seq in self._pending)])
        self._sent_to, self._close_sent = next_seq, False

    def _refused(self, value: dict[str, Any]) -> None:
        problem = value["problem"]
        asked_for = value.get("retry_after_s")
        status = int(problem["status"])
        error = problem_from(httpx.Response(status, json=problem), asked_for)
        if (status >= 500 or status == _TOO_MANY) and self._attempt < self.policy.retries:
            self._pause_s = self.policy.pause_s(self._attempt, self.rng, asked_for)
            self._attempt += 1
            return
        self._pending.clear()
        self._next_seq = None
        raise error

    def cut(self, error: Exception) -> None:
        """A connection could not be made, or was cut; raises if that is one too many."""
        if self._attempt >= self.policy.retries:
            raise ConnectionFailedError(f"{self.url}: {error or type(error).__name__}") from error
        self._pause_s = self.policy.pause_s(self._attempt, self.rng)
        self._attempt += 1

    def pause(self) -> float | None:
        """Seconds to stay away before the next connection; None: this one is well. Told once."""
        pause, self._pause_s = self._pause_s, None
        return pause

    @property
    def well(self) -> bool:
        """Whether the connection may go on."""
        return self._pause_s is None and self.session is None
