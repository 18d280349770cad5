"""The fixes of a session as they come: each once, in order, whatever the connection does.

Events (``GET /v1/sessions/{id}/events``) where the service has them, else its positions are asked for again and again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError

from isodyn_client import endpoints
from isodyn_client.errors import (
    ConnectionFailedError,
    IsodynError,
    ProblemError,
    RateLimitedError,
    ServiceFailedError,
    UnexpectedAnswerError,
)
from isodyn_client.models import SessionInfo, SessionStatus, Status
from isodyn_client.results import PositionPage
from isodyn_client.sse import Event, events

if TYPE_CHECKING:
    from isodyn_client.client import Client

M = TypeVar("M", PositionPage, SessionInfo)

POLL_S = 1.0
RETRY_S = 5.0
TROUBLE = (ConnectionFailedError, RateLimitedError, ServiceFailedError)
"""Errors that pass: the network, or the service, is away for now."""
_LOOK_BACK = 20
"""Segments that may be waiting to be processed when a bridge begins."""
_UNKNOWN = frozenset({404, 405, 406})


@dataclass(frozen=True, slots=True)
class PlanFix:
    """One fix on its level: ``t_ms`` Unix ms; ``x``, ``y`` m; covariance m^2; ``heading_deg`` counter-clockwise from
    +x, the direction of motion."""

    number: int
    t_ms: float
    x: float
    y: float
    cov_xx: float
    cov_xy: float
    cov_yy: float
    heading_deg: float
    status: Status
    sure: bool
    level_id: str


def plan_fixes(page: PositionPage) -> list[PlanFix]:
    """The rows of a page."""
    fixes = page.fixes
    names = ("t_ms", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading_deg")
    columns = [getattr(fixes, name).tolist() for name in names]
    rows = zip(page.number, *columns, fixes.status, fixes.sure.tolist(), fixes.level_id, strict=True)
    return [PlanFix(*row) for row in rows]


def newest_number(client: Client, info: SessionInfo) -> int:
    """Number of the fix before those of the newest segment that has any; -1 at the beginning."""
    for seq in range(info.next_seq - 1, max(-1, info.next_seq - 1 - _LOOK_BACK), -1):
        try:
            page = client.call(endpoints.position_page(info.id, seq=seq, limit=1))
        except ProblemError as error:
            if error.status not in _UNKNOWN:
                raise
            continue
        if page.number:
            return page.number[0] - 1
    return -1


@dataclass(slots=True)
class Follower:
    """Follows one session.

    Attributes
    ----------
    client : Client
    session_id : str
    after : int
        Number of the last fix that was told; those behind it are told from here on. -1: all.
    poll_s : float, s
        How often positions are asked for where there are no events.
    on_trouble : callable or None
        Told of a connection that is lost for now; following goes on. None: the error is raised.
    sleep : callable
        For tests.
    """

    client: Client
    session_id: str
    after: int = -1
    poll_s: float = POLL_S
    on_trouble: Callable[[IsodynError], None] | None = None
    sleep: Callable[[float], None] = time.sleep

    def batches(self) -> Iterator[list[PlanFix]]:
        """New fixes, in order; an empty list now and then while there are none, so that the caller can look around.

        Ends when the session is closed and its last fix is told.
        """
        while True:
            try:
                yield from self._once()
            except TROUBLE as error:
                if self.on_trouble is None:
                    raise
                self.on_trouble(error)
                self.sleep(RETRY_S)
            else:
                return

    def _once(self) -> Iterator[list[PlanFix]]:
        try:
            yield from self._streamed()
        except ProblemError as error:
            if error.status not in _UNKNOWN:
                raise
        yield from self._polled()

    def _streamed(self) -> Iterator[list[PlanFix]]:
        """Until the session is closed; what is processed after that is left to asking."""
        path = f"/v1/sessions/{self.session_id}/events"
        for event in events(self.client, path, params={"after": self.after}, sleep=self.sleep):
            if not isinstance(event, Event):
                yield []
            elif event.name == "fixes":
                yield from self._take(_read(PositionPage, event))
            elif event.name == "session" and _read(SessionInfo, event).status is SessionStatus.CLOSED:
                return

    def _polled(self) -> Iterator[list[PlanFix]]:
        while True:
            over = self._over()
            found = list(self._pages())
            yield from found
            if over:
                return
            if not found:
                yield []
                self.sleep(self.poll_s)

    def _take(self, page: PositionPage) -> Iterator[list[PlanFix]]:
        """What of a page is new; what is missing before it is fetched first."""
        if page.number and page.number[0] > self.after + 1:
            yield from self._pages(until=page.number[0])
        fresh = [fix for fix in plan_fixes(page) if fix.number > self.after]
        if fresh:
            self.after = fresh[-1].number
            yield fresh

    def _pages(self, until: int | None = None) -> Iterator[list[PlanFix]]:
        """All fixes behind the last one told, up to the number ``until``."""
        while until is None or self.after + 1 < until:
            cursor = None if self.after < 0 else str(self.after)
            page = self.client.call(endpoints.position_page(self.session_id, cursor=cursor))
            fresh = [fix for fix in plan_fixes(page) if until is None or fix.number < until]
            if not fresh:
                return
            self.after = fresh[-1].number
            yield fresh
            if page.next_cursor is None:
                return

    def _over(self) -> bool:
        """Whether the session is closed and all of its segments are done: nothing can come behind what is stored."""
        info = self.client.session_info(self.session_id)
        if info.status is not SessionStatus.CLOSED:
            return False
        return info.next_seq == 0 or self.client.segment(self.session_id, info.next_seq - 1).state.final


def newest_session(client: Client, device_id: str) -> SessionInfo | None:
    """The newest open session of a device."""
    return next(iter(client.sessions(device_id=device_id, status=SessionStatus.OPEN)), None)


def _read(model: type[M], event: Event) -> M:
    try:
        return model.model_validate_json(event.data)
    except ValidationError as error:
        raise UnexpectedAnswerError(f"an event {event.name!r} is not as this client knows it: {error}") from error
