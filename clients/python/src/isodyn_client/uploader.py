"""Sends a spool's segments to the service, in order and each once, whatever the network does."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from isodyn_client.errors import (
    InvalidRequestError,
    IsodynError,
    NotFoundError,
    SequenceConflictError,
    SequenceGapError,
    SessionClosedError,
    TooLargeError,
)
from isodyn_client.follow import TROUBLE
from isodyn_client.models import SessionInfo, SessionStatus
from isodyn_client.results import SegmentResult
from isodyn_client.spool import Entry, Spool

if TYPE_CHECKING:
    from isodyn_client.client import Client

_RETRY_S, _MAX_RETRY_S = 1.0, 30.0
_IDLE_S = 0.05
_GOES_ON = (SequenceConflictError, SequenceGapError, SessionClosedError, NotFoundError)
"""The session is not as it was noted: ask where it stands."""


@dataclass(slots=True)
class Uploader:
    """Takes segments from a spool, opens a session for each trip in it, and closes it behind its last segment.

    The number that a segment was sent under is noted before it is sent, so that a process that was killed meanwhile
    sends the same segment under the same number again, which the service recognises.

    Attributes
    ----------
    client : Client
    spool : Spool
    open_session : callable
        Opens the session of a new trip.
    on_result : callable
        Told of each answer.
    on_trouble : callable
        Told of connections that fail, and of segments that are refused.
    wait_s : float
        How long each segment waits for its fixes.
    n_sent, n_refused : int
    """

    client: Client
    spool: Spool
    open_session: Callable[[], SessionInfo]
    on_result: Callable[[SegmentResult], None] = lambda _: None
    on_trouble: Callable[[IsodynError], None] = lambda _: None
    wait_s: float = 5.0
    n_sent: int = 0
    n_refused: int = 0
    _session_id: str | None = None
    _trip: int = -1
    _next_seq: int = 0
    _sending: str = ""
    _known: bool = field(default=False)

    def __post_init__(self) -> None:
        state = self.spool.read_state()
        self._session_id, self._trip = state.get("session_id"), state.get("trip", -1)
        self._next_seq, self._sending = state.get("seq", 0), state.get("sending", "")

    @property
    def session_id(self) -> str | None:
        """Session of the segments that are sent now."""
        return self._session_id

    def run(self, stopped: threading.Event, finished: threading.Event) -> None:
        """Send until ``stopped``, or until the spool is empty after ``finished`` was set; then close the session."""
        pause_s = _RETRY_S
        while not stopped.is_set():
            over = finished.is_set()  # asked before the spool: what is put before it is set is seen
            try:
                sent = self.step()
                if over and not sent:
                    self._close()
                    return
            except TROUBLE as error:
                self.on_trouble(error)
                stopped.wait(pause_s)
                pause_s = min(2 * pause_s, _MAX_RETRY_S)
            else:
                pause_s = _RETRY_S
                if not sent:
                    stopped.wait(_IDLE_S)

    def step(self) -> bool:
        """Send the oldest segment; False if there is none. Errors that pass are raised, and nothing is lost by them."""
        entry = self.spool.oldest()
        if entry is None:
            return False
        self._prepare(entry)
        try:
            result = self._send(entry)
        except (InvalidRequestError, TooLargeError) as error:
            self.n_refused += 1
            self.spool.refuse(entry.name)
            self.on_trouble(error)
            return True
        self.n_sent += 1
        self._next_seq = result.seq + 1
        self.spool.drop(entry.name)
        self.on_result(result)
        return True

    def _send(self, entry: Entry) -> SegmentResult:
        try:
            return self._post(entry)
        except _GOES_ON as error:
            self.on_trouble(error)
        self._known = False
        self._sending = ""
        self._prepare(entry)
        return self._post(entry)

    def _post(self, entry: Entry) -> SegmentResult:
        assert self._session_id is not None  # noqa: S101  # _prepare has seen to it
        return self.client.send_segment(
            self._session_id, self._next_seq, entry.samples, aids=entry.aids, wait=self.wait_s
        )

    def _prepare(self, entry: Entry) -> None:
        """See that there is an open session for the trip of a segment, and note the number it goes under."""
        if entry.trip != self._trip:
            self._close()
        if self._session_id is not None and not self._known and self._sending != entry.name:
            self._look()
        if self._session_id is None:
            info = self.open_session()
            self._session_id, self._next_seq, self._trip = info.id, info.next_seq, entry.trip
        self._known = True
        if self._sending != entry.name:
            self._sending = entry.name
            self._note()

    def _look(self) -> None:
        """Where the noted session stands; None if it takes no more segments."""
        assert self._session_id is not None  # noqa: S101
        try:
            info = self.client.session_info(self._session_id)
        except NotFoundError:
            self._session_id = None
            return
        self._next_seq = info.next_seq
        if info.status is SessionStatus.CLOSED:
            self._session_id = None

    def _close(self) -> None:
        if self._session_id is not None:
            try:
                self.client.close_session(self._session_id)
            except NotFoundError as error:
                self.on_trouble(error)
        self._session_id, self._sending, self._known = None, "", False
        self._note()

    def _note(self) -> None:
        state = {
            "session_id": self._session_id,
            "trip": self._trip,
            "seq": self._next_seq,
            "sending": self._sending,
        }
        self.spool.write_state(state)
