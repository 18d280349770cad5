"""A session over one WebSocket: segments up, fixes down, each counted once whatever the line does.

Needs ``pip install isodyn-client[stream]``. Segments wait here until the service has them; after a cut the service says
which it expects, and fixes go on behind the last one that was told.

>>> with SegmentStream(client, session_id) as stream:                    # doctest: +SKIP
...     for piece in samples.split(1.0):
...         stream.send(piece)
...         for fix in stream.received():
...             print(fix)
...     for fix in stream.finish():
...         print(fix)
"""

from __future__ import annotations

import asyncio
import random
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Self

from isodyn_client.aids import Aids
from isodyn_client.duplex import Exchange
from isodyn_client.errors import IsodynError
from isodyn_client.follow import PlanFix
from isodyn_client.live import Place
from isodyn_client.models import SessionInfo
from isodyn_client.retry import RetryPolicy
from isodyn_client.samples import Samples

try:
    from websockets.asyncio.client import ClientConnection as AsyncConnection
    from websockets.asyncio.client import connect as async_connect
    from websockets.exceptions import ConnectionClosed, InvalidHandshake
    from websockets.sync.client import ClientConnection, connect
except ImportError as error:
    raise ImportError("streams need websockets: pip install isodyn-client[stream]") from error

if TYPE_CHECKING:
    from isodyn_client.aio import AsyncClient
    from isodyn_client.client import Client

OPEN_S = 10.0
"""Longest wait for a connection and its first message."""
CLOSE_S = 1.0
MAX_BYTES = 16 * 2**20
POLICY = RetryPolicy(retries=8)
_AWAY = (ConnectionClosed, InvalidHandshake, OSError, TimeoutError)
"""The line is dead, or could not be made."""


class SegmentStream:
    """A session's segments and fixes over one connection; use it in a ``with`` block, from one thread.

    Parameters
    ----------
    client : Client
        Whose address and key are used.
    session_id : str
    after : int
        Number of the last fix that is known already; -1: all are told.
    policy : RetryPolicy, optional
        How often, and when, a connection is made again that brought nothing.
    sleep : callable, optional
        For tests.
    """

    def __init__(
        self,
        client: Client,
        session_id: str,
        *,
        after: int = -1,
        policy: RetryPolicy = POLICY,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._exchange = Exchange(client.connection, session_id, Place(after), policy, random.Random())
        self._sleep = sleep
        self._line: ClientConnection | None = None
        self._lines = ExitStack()
        self._fixes: deque[PlanFix] = deque()

    def __enter__(self) -> Self:
        self._connected()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._hang_up()

    @property
    def session(self) -> SessionInfo | None:
        """The session as it is when it is over; None before that."""
        return self._exchange.session

    def send(self, samples: Samples, *, aids: Aids | None = None) -> int:
        """Send the next segment and return its number; from here on it is sent again whenever the line was cut.

        A refusal is raised here or where fixes are read: the refused segment and those sent behind it are dropped, and
        their numbers are free again.
        """
        self._connected()
        seq = self._exchange.queue(samples, aids)
        self._drain(0.0)
        return seq

    def received(self, wait_s: float = 0.0) -> Iterator[PlanFix]:
        """The fixes that have come, after waiting up to ``wait_s`` for the first."""
        self._drain(0.0 if self._fixes else wait_s)
        while self._fixes:
            yield self._fixes.popleft()

    def finish(self) -> Iterator[PlanFix]:
        """Close the session, and give all fixes up to its last."""
        self._exchange.closing = True
        yield from self

    def __iter__(self) -> Iterator[PlanFix]:
        """Fixes until the session is over, waiting for each."""
        while True:
            while self._fixes:
                yield self._fixes.popleft()
            if self._exchange.session is not None:
                return
            self._drain(None)

    def _drain(self, wait_s: float | None) -> None:
        """Send what waits, take what has come; if nothing has, wait so long (None: however long) for something."""
        while self._exchange.session is None:
            line = self._connected()
            try:
                for message in self._exchange.unsent():
                    line.send(message)
                self._take(line.recv(wait_s))
            except TimeoutError:
                return
            except _AWAY as error:
                self._exchange.cut(error)
                self._hang_up()
            else:
                wait_s = 0.0

    def _take(self, message: str | bytes) -> None:
        try:
            self._fixes.extend(self._exchange.take(message))
        except IsodynError:
            self._hang_up()  # answers to what was sent behind a refused segment are of no use
            raise
        if not self._exchange.well:
            self._hang_up()

    def _connected(self) -> ClientConnection:
        while self._line is None:
            if (pause := self._exchange.pause()) is not None:
                self._sleep(pause)
            try:
                line = self._lines.enter_context(self._connect())
                self._line = line
                self._take(line.recv(OPEN_S))
            except _AWAY as error:
                self._hang_up()
                self._exchange.cut(error)
        return self._line

    def _connect(self) -> ClientConnection:
        made: ClientConnection = connect(
            self._exchange.url,
            open_timeout=OPEN_S,
            close_timeout=CLOSE_S,
            max_size=MAX_BYTES,
            **self._exchange.options,
        )
        return made

    def _hang_up(self) -> None:
        self._line = None
        self._lines.close()


class AsyncSegmentStream:
    """:class:`SegmentStream`, awaited: one task sends, another (or the same in turn) reads.

    Examples
    --------
    >>> async with AsyncSegmentStream(client, session_id) as stream:         # doctest: +SKIP
    ...     asyncio.create_task(measure(stream.send))
    ...     async for fix in stream:
    ...         print(fix)
    """

    def __init__(
        self,
        client: AsyncClient,
        session_id: str,
        *,
        after: int = -1,
        policy: RetryPolicy = POLICY,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._exchange = Exchange(client.connection, session_id, Place(after), policy, random.Random())
        self._sleep = sleep
        self._line: AsyncConnection | None = None
        self._fixes: deque[PlanFix] = deque()
        self._connecting = asyncio.Lock()

    async def __aenter__(self) -> Self:
        await self._connected()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._hang_up()

    @property
    def session(self) -> SessionInfo | None:
        """The session as it is when it is over; None before that."""
        return self._exchange.session

    async def send(self, samples: Samples, *, aids: Aids | None = None) -> int:
        """Send the next segment and return its number; see :meth:`SegmentStream.send`."""
        await self._connected()
        seq = self._exchange.queue(samples, aids)
        await self._flush()
        return seq

    async def finish(self) -> AsyncIterator[PlanFix]:
        """Close the session, and give all fixes up to its last."""
        self._exchange.closing = True
        async for fix in self:
            yield fix

    async def __aiter__(self) -> AsyncIterator[PlanFix]:
        """Fixes until the session is over, waiting for each."""
        while True:
            while self._fixes:
                yield self._fixes.popleft()
            if self._exchange.session is not None:
                return
            line = await self._flush()
            try:
                await self._take(await line.recv())
            except _AWAY as error:
                await self._cut(line, error)

    async def _flush(self) -> AsyncConnection:
        while True:
            line = await self._connected()
            try:
                for message in self._exchange.unsent():
                    await line.send(message)
            except _AWAY as error:
                await self._cut(line, error)
            else:
                return line

    async def _take(self, message: str | bytes) -> None:
        try:
            self._fixes.extend(self._exchange.take(message))
        except IsodynError:
            await self._hang_up()
            raise
        if not self._exchange.well:
            await self._hang_up()

    async def _connected(self) -> AsyncConnection:
        async with self._connecting:
            while self._line is None:
                if (pause := self._exchange.pause()) is not None:
                    await self._sleep(pause)
                await self._connect()
            return self._line

    async def _connect(self) -> None:
        try:
            line = await async_connect(
                self._exchange.url,
                open_timeout=OPEN_S,
                close_timeout=CLOSE_S,
                max_size=MAX_BYTES,
                **self._exchange.options,
            )
        except _AWAY as error:
            self._exchange.cut(error)
            return
        try:
            # nobody else may send over it before the service has said which segment it expects
            await self._take(await asyncio.wait_for(line.recv(), OPEN_S))
        except _AWAY as error:
            self._exchange.cut(error)
        else:
            if self._exchange.well:
                self._line = line
                return
        await line.close()

    async def _cut(self, line: AsyncConnection, error: Exception) -> None:
        """A line is dead; whoever notices first says so."""
        if self._line is line:
            self._line = None
            self._exchange.cut(error)
            await line.close()

    async def _hang_up(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            await line.close()
