"""Positions as they come: of one session without gaps, or where all sessions are; for both clients."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError

from isodyn_client.calls import present
from isodyn_client.errors import IsodynError, UnexpectedAnswerError
from isodyn_client.follow import RETRY_S, TROUBLE, Follower, PlanFix, plan_fixes
from isodyn_client.models import Model, SessionStatus, Status
from isodyn_client.results import PositionPage
from isodyn_client.sse import Event, Ping, async_events, events

if TYPE_CHECKING:
    from isodyn_client.aio import AsyncClient
    from isodyn_client.client import Client

M = TypeVar("M", bound=Model)
LIVE = "/v1/live"


class LastKnown(Model):
    """Where a session is: its last fix, or None from ``t_ms`` on while nothing is known.

    ``t_ms`` Unix ms; ``x``, ``y`` m on the level; covariance m^2; ``heading_deg`` counter-clockwise from +x.
    """

    session_id: str
    device_id: str | None = None
    venue_id: str
    level_id: str | None = None
    t_ms: float | None = None
    x: float | None = None
    y: float | None = None
    cov_xx: float | None = None
    cov_xy: float | None = None
    cov_yy: float | None = None
    heading_deg: float | None = None
    status: Status | None = None
    sure: bool | None = None
    number: int | None = None


class SessionChange(Model):
    """A session was opened, or closed."""

    id: str
    status: SessionStatus


class _Snapshot(Model):
    sessions: tuple[LastKnown, ...]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All open sessions, as a stream begins, and again each time its connection had to be made anew."""

    sessions: tuple[LastKnown, ...]


Live = Snapshot | LastKnown | SessionChange
"""What a stream over many sessions tells: the state first, then what changes."""


def follow(
    client: Client, session_id: str, *, after: int = -1, on_trouble: Callable[[IsodynError], None] | None = None
) -> Iterator[PlanFix]:
    """The fixes of a session as they come, each once and in order, until the session is closed and its last is told.

    ``after`` is the number of the last fix that is known already (-1: none). A connection that is cut is made again;
    ``on_trouble`` is told when that does not help for long, and following goes on; without it the error is raised.
    """
    for batch in Follower(client, session_id, after, on_trouble=on_trouble).batches():
        yield from batch


def follow_all(client: Client, *, venue_id: str | None = None, level_id: str | None = None) -> Iterator[Live]:
    """Where all open sessions (of a venue, of a level) are: a snapshot, then what changes, for as long as it is taken.

    A state, not a record: of several fixes between two events the last is told. :meth:`follow` tells them all.
    """
    for event in events(client, LIVE, params=live_params(venue_id, level_id)):
        yield from _live(event)


async def async_follow(
    client: AsyncClient, session_id: str, *, after: int = -1, on_trouble: Callable[[IsodynError], None] | None = None
) -> AsyncIterator[PlanFix]:
    """:func:`follow`, awaited."""
    position = Place(after)
    while True:
        path = f"/v1/sessions/{session_id}/events"
        try:
            async for event in async_events(client, path, params={"after": position.after}):
                for fix in position.fresh(event):
                    yield fix
                if isinstance(event, Event) and event.name == "session":
                    return
        except TROUBLE as error:
            if on_trouble is None:
                raise
            on_trouble(error)
            await asyncio.sleep(RETRY_S)


async def async_follow_all(
    client: AsyncClient, *, venue_id: str | None = None, level_id: str | None = None
) -> AsyncIterator[Live]:
    """:func:`follow_all`, awaited."""
    async for event in async_events(client, LIVE, params=live_params(venue_id, level_id)):
        for one in _live(event):
            yield one


@dataclass(slots=True)
class Place:
    """How far a session's fixes were told; what comes twice is told once."""

    after: int = -1

    def fresh(self, event: Event | Ping) -> list[PlanFix]:
        """The fixes of an event that are new."""
        if not isinstance(event, Event) or event.name != "fixes":
            return []
        return self.fresh_of(_read(PositionPage, event.data))

    def fresh_of(self, page: PositionPage) -> list[PlanFix]:
        """The fixes of a page that are new."""
        found = [fix for fix in plan_fixes(page) if fix.number > self.after]
        if found:
            self.after = found[-1].number
        return found


def live_params(venue_id: str | None = None, level_id: str | None = None) -> Mapping[str, str]:
    """Query of a stream over the sessions of a venue or level."""
    return present({"venue_id": venue_id, "level_id": level_id})


def _live(event: Event | Ping) -> list[Live]:
    if not isinstance(event, Event):
        return []
    if event.name == "snapshot":
        return [Snapshot(_read(_Snapshot, event.data).sessions)]
    if event.name == "fix":
        return [_read(LastKnown, event.data)]
    if event.name == "session":
        return [_read(SessionChange, event.data)]
    return []  # of a newer service


def _read(model: type[M], data: str) -> M:
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        raise UnexpectedAnswerError(f"an event is not as this client knows it: {error}") from error
