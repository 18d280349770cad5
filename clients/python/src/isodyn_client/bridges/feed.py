"""What a bridge reads: the fixes of a session, or of whatever session a device is in."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from isodyn_client.errors import BridgeError, IsodynError
from isodyn_client.follow import POLL_S, TROUBLE, Follower, PlanFix, newest_number, newest_session
from isodyn_client.models import Anchor, SessionInfo

if TYPE_CHECKING:
    from isodyn_client.client import Client

LOOK_S = 5.0
"""How often a device is asked for a newer session."""


@dataclass(frozen=True, slots=True)
class Told:
    """A fix, with the session and the anchor of its venue (None: the venue has none)."""

    session: SessionInfo
    anchor: Anchor | None
    fix: PlanFix


@dataclass(slots=True)
class SessionFeed:
    """Fixes of one session.

    Attributes
    ----------
    client : Client
    session_id : str
    from_start : bool
        Tell all fixes of the session; else from those of its newest segment on.
    poll_s : float, s
    on_trouble : callable or None
        Told of connections that are lost for now; None: their errors are raised.
    """

    client: Client
    session_id: str
    from_start: bool = False
    poll_s: float = POLL_S
    on_trouble: Callable[[IsodynError], None] | None = None
    sleep: Callable[[float], None] = time.sleep

    def batches(self) -> Iterator[list[Told]]:
        """New fixes, each once and in order; an empty list now and then. Ends with the session."""
        info = self.client.session_info(self.session_id)
        anchor = self.client.venue(info.venue_id).anchor
        after = -1 if self.from_start else newest_number(self.client, info)
        follower = Follower(self.client, info.id, after, self.poll_s, self.on_trouble, self.sleep)
        for batch in follower.batches():
            yield [Told(info, anchor, fix) for fix in batch]


@dataclass(slots=True)
class DeviceFeed:
    """Fixes of the newest open session of a device; when it opens another one, of that. Never ends by itself."""

    client: Client
    device_id: str
    from_start: bool = False
    poll_s: float = POLL_S
    on_trouble: Callable[[IsodynError], None] | None = None
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic

    def batches(self) -> Iterator[list[Told]]:
        """New fixes, each once and in order; an empty list now and then."""
        self.client.device(self.device_id)  # an unknown one is an error, one without a session is not
        last: SessionInfo | None = None
        from_start = self.from_start
        while True:
            info = self._newer(last)
            if info is None:
                yield []
                self.sleep(self.poll_s)
            else:
                feed = SessionFeed(self.client, info.id, from_start, self.poll_s, self.on_trouble, self.sleep)
                yield from self._until_replaced(feed, info)
                last = info
            from_start = True  # what opens from now on is new from its first fix

    def _until_replaced(self, feed: SessionFeed, info: SessionInfo) -> Iterator[list[Told]]:
        next_look = self.clock() + LOOK_S
        for batch in feed.batches():
            yield batch
            if not batch and self.clock() >= next_look:
                if self._newer(info) is not None:
                    return
                next_look = self.clock() + LOOK_S

    def _newer(self, last: SessionInfo | None) -> SessionInfo | None:
        """The newest open session, if it was opened after the last one: older ones that nobody closed are over."""
        try:
            newest = newest_session(self.client, self.device_id)
        except TROUBLE as error:
            if self.on_trouble is None:
                raise
            self.on_trouble(error)
            return None
        return newest if newest is not None and (last is None or newest.created_at > last.created_at) else None


def anchored(told: Told) -> Anchor:
    """The anchor of a fix's venue.

    Raises
    ------
    BridgeError
        There is none.
    """
    if told.anchor is None:
        raise BridgeError(
            f"venue {told.session.venue_id} has no anchor, so its positions have no latitude and longitude; "
            "set one with PATCH /v1/venues/{venue_id}"
        )
    return told.anchor
