"""What ingest needs of the database and of the checks of uploads."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Protocol

from app.engine.types import ImuSamples, SurveyWalk
from app.services.aids import Aids
from app.services.ingest.records import IngestToken, Marker, Purpose, RecordingInfo, RecordingState, Stored
from app.services.records import NewSegment, NewWalk, Page

Extent = tuple[float, float, float, float]


class IngestRepository(Protocol):
    """Ingest tokens, recordings of phones with their messages, markers of levels."""

    def add_token(self, token: IngestToken, secret_hash: str) -> None: ...
    def get_token(self, token_id: str) -> IngestToken: ...
    def find_token(self, secret_hash: str) -> IngestToken | None:
        """The token of this secret, revoked or not."""
        ...

    def list_tokens(self, *, device_id: str | None, cursor: str | None, limit: int) -> Page[IngestToken]: ...
    def revoke_token(self, token_id: str, now: datetime) -> IngestToken: ...
    def touch_token(self, token_id: str, now: datetime) -> None: ...
    def add(self, recording: RecordingInfo) -> None:
        """Store a new recording."""
        ...

    def save(self, recording: RecordingInfo, rest: bytes | None) -> None:
        """Store a recording as it is now, with the readings that the next message needs (None: they stay)."""
        ...

    def get(self, recording_id: str) -> RecordingInfo: ...
    def rest(self, recording_id: str) -> bytes: ...
    def latest(self, token_id: str, app_session: str | None = None) -> RecordingInfo | None:
        """The newest recording of a token, or the newest part of one."""
        ...

    def list(
        self,
        *,
        token_id: str | None,
        device_id: str | None,
        purpose: Purpose | None,
        state: RecordingState | None,
        cursor: str | None,
        limit: int,
    ) -> Page[RecordingInfo]: ...
    def silent_since(self, then: datetime, *, limit: int) -> Sequence[str]:
        """Ids of open recordings whose last message came before."""
        ...

    def add_message(self, recording_id: str, message: Stored) -> bool:
        """Store a message; False if this number was stored before."""
        ...

    def messages(self, recording_id: str) -> Sequence[Stored]:
        """Messages whose readings are kept, by number."""
        ...

    def drop_readings(self, recording_id: str, numbers: Sequence[int] | None = None) -> None:
        """Forget the readings of messages (None: of all); that they came is remembered."""
        ...

    def markers(self, level_id: str) -> Sequence[Marker]:
        """Marked points of a level, by name."""
        ...

    def set_markers(self, level_id: str, markers: Sequence[Marker]) -> None:
        """Put these in place of what there was."""
        ...


class UploadChecks(Protocol):
    """The checks that every upload passes, also those of phones."""

    def segment(self, seq: int, samples: ImuSamples, aids: Aids, now: datetime) -> NewSegment:
        """A segment; InvalidError if no phone can have read that."""
        ...

    def walk(self, walk: SurveyWalk, device_id: str, extent: Extent, now: datetime) -> NewWalk:
        """A survey walk on a level of this extent; InvalidError likewise."""
        ...
