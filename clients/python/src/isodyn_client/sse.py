"""Server-sent events: a parser of the stream, and a reader that connects again where it was cut off.

The format is that of the HTML standard (section 9.2, "Server-sent events"); keys travel in headers, as in every call.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import httpx

from isodyn_client.calls import Call, nothing
from isodyn_client.errors import ConnectionFailedError, UnexpectedAnswerError, problem_from
from isodyn_client.retry import RetryPolicy, retry_after

if TYPE_CHECKING:
    from isodyn_client.aio import AsyncClient
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
        self.begin()
        for line in lines:
            yield from self.take(line)

    def begin(self) -> None:
        """Forget what the last connection left unfinished."""
        self._id, self._name, self._data = self.last_id, "", []

    def take(self, line: str) -> Iterator[Event | Ping]:
        """What a line completes."""
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


@dataclass(slots=True)
class LineSplitter:
    r"""Lines of a stream that may be cut anywhere, also within a character or between \r and \n.

    ``str.splitlines`` is no help: it splits at characters that JSON may hold.
    """

    _rest: bytes = b""
    _returned: bool = False

    def feed(self, chunk: bytes) -> list[str]:
        """The lines that a chunk completes."""
        if self._returned and chunk:
            chunk, self._returned = chunk.removeprefix(b"\n"), False
        self._returned = chunk.endswith(b"\r") if chunk else self._returned
        *lines, self._rest = (self._rest + chunk).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        return [line.decode("utf-8", "replace").removeprefix("\ufeff") for line in lines]


def lines_of(chunks: Iterable[bytes]) -> Iterator[str]:
    """Lines of the chunks of one connection."""
    splitter = LineSplitter()
    for chunk in chunks:
        yield from splitter.feed(chunk)


@dataclass(slots=True)
class _Reading:
    """What is known over all connections of one stream of events; has no input or output of its own."""

    path: str
    params: Mapping[str, str | int]
    policy: RetryPolicy
    rng: random.Random
    parser: EventParser = field(default_factory=EventParser)
    attempt: int = 0
    """Connections in a row that brought no event."""
    asked_for: float | None = None

    def call(self) -> Call[None]:
        """The next connection: with ``Last-Event-ID`` instead of the parameters once an event had an id."""
        self.asked_for = None
        self.parser.begin()
        headers = {"Accept": MEDIA_TYPE}
        if self.parser.last_id:
            return Call("GET", self.path, nothing, headers={**headers, "Last-Event-ID": self.parser.last_id})
        return Call("GET", self.path, nothing, params=self.params, headers=headers)

    def take(self, line: str) -> Iterator[Event | Ping]:
        for event in self.parser.take(line):
            self.attempt = 0
            yield event

    def failed(self, error: httpx.TransportError) -> None:
        """A connection could not be made, or was cut; raises if that is one too many."""
        if self.attempt >= self.policy.retries:
            raise ConnectionFailedError(f"GET {self.path}: {error or type(error).__name__}") from error

    def pause_s(self) -> float:
        """How long to stay away before the next connection; raises if there is to be none."""
        if self.attempt >= self.policy.retries:
            times = self.attempt + 1
            raise ConnectionFailedError(f"GET {self.path}: the stream of events ended {times} times without an event")
        pause = max(self.policy.pause_s(self.attempt, self.rng, self.asked_for), self.parser.retry_s or 0.0)
        self.attempt += 1
        return pause


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
    reading = _Reading(path, params or {}, policy or RetryPolicy(retries=8), rng or random.Random())
    while True:
        try:
            with client.stream(reading.call()) as response:
                if (again := _again(response)) is not None:
                    response.read()
                    reading.asked_for = _stay_away(response, again)
                else:
                    for line in lines_of(response.iter_bytes()):
                        yield from reading.take(line)
        except httpx.TransportError as error:
            reading.failed(error)
        sleep(reading.pause_s())


async def async_events(
    client: AsyncClient,
    path: str,
    *,
    params: Mapping[str, str | int] | None = None,
    policy: RetryPolicy | None = None,
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    rng: random.Random | None = None,
) -> AsyncIterator[Event | Ping]:
    """:func:`events`, awaited."""
    reading = _Reading(path, params or {}, policy or RetryPolicy(retries=8), rng or random.Random())
    while True:
        splitter = LineSplitter()
        try:
            async with client.stream(reading.call()) as response:
                if (again := _again(response)) is not None:
                    await response.aread()
                    reading.asked_for = _stay_away(response, again)
                else:
                    async for chunk in response.aiter_bytes():
                        for line in splitter.feed(chunk):
                            for event in reading.take(line):
                                yield event
        except httpx.TransportError as error:
            reading.failed(error)
        await sleep(reading.pause_s())


def _again(response: httpx.Response) -> float | None:
    """None if events follow, else for how many seconds the service asks to stay away (0: it does not say)."""
    if not response.is_success:
        return retry_after(response) or 0.0
    if not response.headers.get("Content-Type", "").startswith(MEDIA_TYPE):
        raise UnexpectedAnswerError(f"{response.request.url} sends no events")
    return None


def _stay_away(response: httpx.Response, asked_for: float) -> float:
    """Seconds to stay away; raises a refusal that will not pass."""
    if response.status_code in _PASSING:
        return asked_for or 1.0
    raise problem_from(response, asked_for or None)
