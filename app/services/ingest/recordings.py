"""Recordings of phones: messages taken, ends found, walks made of surveys."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from app.engine.types import Waypoints
from app.exchange.phones.places import marker_key
from app.services.base import DEFAULT_LIMIT, Service, check_limit
from app.services.clock import Clock
from app.services.errors import ConflictError, InvalidError, OverloadedError, SessionClosedError
from app.services.ingest.errors import IngestRefusedError
from app.services.ingest.ports import Extent, UploadChecks
from app.services.ingest.receiving import Effects, Receiver, known_token, recording_of, token_of
from app.services.ingest.records import (
    Incoming,
    IngestToken,
    Marker,
    Purpose,
    Received,
    RecordingInfo,
    RecordingState,
)
from app.services.ingest.surveying import finish_survey
from app.services.ingest.truth import keep_truth
from app.services.live import SessionListener
from app.services.open_sessions import close_session
from app.services.ports import JobListener, UnitOfWork, UnitOfWorkFactory
from app.services.records import Page

MAX_MARKERS = 5000
_AT_ONCE = 100


class RecordingService(Service):
    """Take what phones push, and read what became of it."""

    def __init__(
        self,
        *,
        uow: UnitOfWorkFactory,
        clock: Clock,
        checks: UploadChecks,
        listener: JobListener,
        watchers: SessionListener,
        max_queued: int,
    ) -> None:
        super().__init__(uow=uow, clock=clock)
        self._checks = checks
        self._listener = listener
        self._watchers = watchers
        self._max_queued = max_queued

    def check(self, secret: str) -> None:
        """UnknownTokenError if there is no token of this secret; writes nothing, so it waits for nobody."""
        with self._uow() as uow:
            known_token(uow, secret)

    def token(self, secret: str) -> IngestToken:
        """The token of a push URL; UnknownTokenError if there is none."""
        with self._uow(write=True) as uow:
            return token_of(uow, secret, self._clock())

    def latest(self, token_id: str) -> RecordingInfo | None:
        """The newest recording of a token."""
        with self._uow() as uow:
            return uow.ingest.latest(token_id)

    def receive(self, secret: str, message: Incoming) -> Received:
        """Store a message and cut what is complete; after this nothing of it is lost.

        IngestRefusedError says in words for the person with the phone why nothing was stored.
        """
        now = self._clock()
        effects = Effects()
        with self._uow(write=True) as uow:
            token = token_of(uow, secret, now)
            if not len(message.readings):
                return Received(None)
            recording = recording_of(uow, token, message, now, effects)
            receiver = self._receiver(uow, token, recording, now, effects)
            try:
                fresh = receiver.take(message)
            except SessionClosedError as error:
                raise IngestRefusedError("the session was closed: stop recording, and start again") from error
            received = Received(receiver.recording, not fresh, tuple(job.id for job in effects.jobs))
        self._tell(effects)
        return received

    def close(self, recording_id: str) -> RecordingInfo:
        """End a recording: its session is closed, or walks are made of it. Ending again changes nothing."""
        now = self._clock()
        effects = Effects()
        with self._uow(write=True) as uow:
            recording = self._finish(uow, uow.ingest.get(recording_id), now, effects)
        self._tell(effects)
        return recording

    def close_silent(self, silence: timedelta) -> Sequence[str]:
        """End the recordings that have been silent for so long; returns their ids.

        What the queue has no room for stays open until the next time, and holds up no other.
        """
        with self._uow() as uow:
            ids = uow.ingest.silent_since(self._clock() - silence, limit=_AT_ONCE)
        ended = []
        for recording_id in ids:
            with contextlib.suppress(OverloadedError):
                self.close(recording_id)
                ended.append(recording_id)
        return tuple(ended)

    def set_waypoints(self, recording_id: str, waypoints: Waypoints) -> RecordingInfo:
        """Make walks of a survey recording that waits for waypoints, with these."""
        now = self._clock()
        effects = Effects()
        with self._uow(write=True) as uow:
            recording = uow.ingest.get(recording_id)
            if recording.purpose is not Purpose.SURVEY:
                raise InvalidError("recording_id", "is no survey", "waypoints belong to recordings of a survey")
            if recording.state is RecordingState.CLOSED:
                raise ConflictError(f"recording {recording_id} has its walks already; delete these, and record again")
            token = uow.ingest.get_token(recording.token_id)
            recording, jobs = finish_survey(uow, self._checks, token, recording, now, waypoints)
            if not recording.walk_ids:
                raise InvalidError("waypoints", f"make no walk: {recording.problem}", "give at least two, of this walk")
            effects.jobs += jobs
            uow.ingest.save(recording, None)
        self._tell(effects)
        return recording

    def get(self, recording_id: str) -> RecordingInfo:
        """One recording."""
        with self._uow() as uow:
            return uow.ingest.get(recording_id)

    def list(
        self,
        *,
        token_id: str | None = None,
        device_id: str | None = None,
        purpose: Purpose | None = None,
        state: RecordingState | None = None,
        cursor: str | None = None,
        limit: int = DEFAULT_LIMIT,
    ) -> Page[RecordingInfo]:
        """Recordings, newest first."""
        with self._uow() as uow:
            return uow.ingest.list(
                token_id=token_id,
                device_id=device_id,
                purpose=purpose,
                state=state,
                cursor=cursor,
                limit=check_limit(limit),
            )

    def markers(self, level_id: str) -> Sequence[Marker]:
        """Marked points of a level, by name."""
        with self._uow() as uow:
            uow.levels.get(level_id)
            return uow.ingest.markers(level_id)

    def set_markers(self, level_id: str, markers: Sequence[Marker]) -> Sequence[Marker]:
        """Put these marked points in place of what the level had."""
        if len(markers) > MAX_MARKERS:
            raise InvalidError("markers", f"has {len(markers)} entries", f"send at most {MAX_MARKERS}")
        with self._uow(write=True) as uow:
            _check_markers(markers, uow.levels.get(level_id).extent)
            uow.ingest.set_markers(level_id, markers)
            return uow.ingest.markers(level_id)

    def _finish(self, uow: UnitOfWork, recording: RecordingInfo, now: datetime, effects: Effects) -> RecordingInfo:
        if recording.state is not RecordingState.OPEN:
            return recording
        token = uow.ingest.get_token(recording.token_id)
        if recording.purpose is Purpose.SURVEY:
            recording, jobs = finish_survey(uow, self._checks, token, recording, now)
            effects.jobs += jobs
        else:
            receiver = self._receiver(uow, token, recording, now, effects)
            session_id = recording.session_id or ""
            try:
                receiver.advance(final=True)
            except SessionClosedError:
                pass  # by hand, before the phone was done
            else:
                close_session(uow, session_id, now)
            recording = replace(receiver.recording, state=RecordingState.CLOSED, closed_at=now)
            keep_truth(uow, token, recording, now)
            effects.sessions.append(session_id)
        uow.ingest.save(recording, None)
        return recording

    def _receiver(
        self, uow: UnitOfWork, token: IngestToken, recording: RecordingInfo, now: datetime, effects: Effects
    ) -> Receiver:
        return Receiver(uow, self._checks, token, recording, now, self._max_queued, effects)

    def _tell(self, effects: Effects) -> None:
        for session_id in effects.sessions:
            self._watchers.session_changed(session_id)
        for job in effects.jobs:
            self._listener.job_queued(job)


def _check_markers(markers: Sequence[Marker], extent: Extent) -> None:
    x_min, y_min, x_max, y_max = extent
    seen: set[str] = set()
    for i, marker in enumerate(markers):
        key = marker_key(marker.name)  # as annotations are looked up
        if key in seen:
            raise InvalidError(f"markers.{i}.name", f"{marker.name!r} comes twice", "give each point its own name")
        seen.add(key)
        inside = {"x": x_min <= marker.x <= x_max, "y": y_min <= marker.y <= y_max}
        for axis in (axis for axis, ok in inside.items() if not ok):
            what = f"({marker.x:g}, {marker.y:g}) is outside the level"
            raise InvalidError(f"markers.{i}.{axis}", what, "give metres in the level's frame, within its extent")
