"""Server-sent events: a parser of the stream, and a reader that connects again where it was cut off.

The format is that of the HTML standard (section 9.2, "Server-sent events"); keys travel in headers, as in every call.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import httpx

from isodyn_client.calls import Call, nothing
from isodyn_client.errors import ConnectionFailedError, UnexpectedAnswerError, problem_from
from isodyn_client.retry import RetryPolicy, retry_after

if TYPE_CHECKING:
    from isodyn_client.client import Client

MEDIA_TYPE = "text/event-stream"
_PASSING = frozenset({408, 429, 500, 502, 503, 504})


@dataclass(frozen=True, slots=True)
class Event:
    """One event; ``id`` is the last one that the stream named, as a reconnection tells it."""

    name: str
    data: str
    id: str = ""


@dataclass(frozen=True, slots=True)
class Ping:
    """A comment: nothing happened, and the connection is alive."""


@dataclass(slots=True)
class EventParser:
    """Turns lines into events. ``last_id`` and ``retry_s`` outlive a connection."""

    last_id: str = ""
    retry_s: float | None = None
    _id: str = ""
    _name: str = ""
    _data: list[str] = field(default_factory=list)

    def feed(self, lines: Iterable[str]) -> Iterator[Event | Ping]:
        """Events and pings of the lines of one connection; what is unfinished at its end is dropped."""
        self._id, self._name, self._data = self.last_id, "", []
        for line in lines:
            if not line:
                self.last_id = self._id  # only now: an event that was cut off is asked for again
                if self._data:
                    yield Event(self._name or "message", "\n".join(self._data), self.last_id)
                self._name, self._data = "", []
            elif line.startswith(":"):
                yield Ping()
            else:
                self._field(line)

    def _field(self, line: str) -> None:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._name = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._id = value
        elif name == "retry" and value.isascii() and value.isdigit():
            self.retry_s = int(value) / 1000.0


def lines_of(chunks: Iterable[bytes]) -> Iterator[str]:
    r"""Lines of a stream that may be cut anywhere, also within a character or between \r and \n.

    ``str.splitlines`` is no help: it splits at characters that JSON may hold.
    """
    rest, returned = b"", False
    for chunk in chunks:
        fresh = chunk
        if returned and fresh:
            fresh, returned = fresh.removeprefix(b"\n"), False
        returned = fresh.endswith(b"\r") if fresh else returned
        *lines, rest = (rest + fresh).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            yield line.decode("utf-8", "replace").removeprefix("\ufeff")


def events(
    client: Client,
    path: str,
    *,
    params: Mapping[str, str | int] | None = None,
    policy: RetryPolicy | None = None,
    sleep: Callable[[float], None] = time.sleep,
    rng: random.Random | None = None,
) -> Iterator[Event | Ping]:
    """Events of a path for as long as the caller takes them.

    A connection that ends or fails is made again: with ``Last-Event-ID`` instead of ``params`` once an event had an id.

    Raises
    ------
    ProblemError
        The service refuses: no key, no such path.
    ConnectionFailedError
        ``policy.retries`` attempts in a row brought no event.
    """
    policy, rng = policy or RetryPolicy(retries=8), rng or random.Random()
    parser = EventParser()
    attempt = 0
    while True:
        call = Call("GET", path, nothing, params=params or {}, headers={"Accept": MEDIA_TYPE})
        if parser.last_id:
            call = replace(call, params={}, headers={**call.headers, "Last-Event-ID": parser.last_id})
        asked_for: float | None = None
        try:
            with client.stream(call) as response:
                asked_for = _accepted(response)
                if asked_for is None:
                    for event in parser.feed(lines_of(response.iter_bytes())):
                        attempt = 0
                        yield event
        except httpx.TransportError as error:
            if attempt >= policy.retries:
                raise ConnectionFailedError(f"GET {path}: {error or type(error).__name__}") from error
        if attempt >= policy.retries:
            raise ConnectionFailedError(f"GET {path}: the stream of events ended {attempt + 1} times without an event")
        sleep(max(policy.pause_s(attempt, rng, asked_for), parser.retry_s or 0.0))
        attempt += 1


def _accepted(response: httpx.Response) -> float | None:
    """None if events follow, else for how many seconds to stay away; raises what will not pass."""
    if response.is_success:
        if not response.headers.get("Content-Type", "").startswith(MEDIA_TYPE):
            raise UnexpectedAnswerError(f"{response.request.url} sends no events")
        return None
    asked_for = retry_after(response)
    response.read()
    if response.status_code in _PASSING:
        return asked_for or 1.0
    raise problem_from(response, asked_for)
