"""Ingest tokens, recordings of phones and their messages, markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

from sqlalchemy import Row, bindparam, delete, insert, select, update

from app.engine.localization.codec import prior_from
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.readings import Annotation
from app.services.ingest.records import (
    BuildOnArrival,
    IngestApp,
    IngestToken,
    Marker,
    Purpose,
    RecordingInfo,
    RecordingState,
    Stored,
)
from app.services.records import Page
from app.storage.models import ingest_tokens, level_markers, recording_messages, recording_rests, recordings
from app.storage.repositories.base import Repository

_FIND_TOKEN = select(ingest_tokens).where(ingest_tokens.c.secret_hash == bindparam("hash"))
_OF_RECORDING = recording_messages.c.recording_id == bindparam("recording")
_HAS = select(recording_messages.c.number).where(_OF_RECORDING, recording_messages.c.number == bindparam("wanted"))
_INSERT_MESSAGE = insert(recording_messages)
_MESSAGES = (
    select(recording_messages)
    .where(_OF_RECORDING, recording_messages.c.readings.is_not(None))
    .order_by(recording_messages.c.number)
)
_REST = select(recording_rests.c.data).where(recording_rests.c.recording_id == bindparam("recording"))
_SET_REST = (
    update(recording_rests)
    .where(recording_rests.c.recording_id == bindparam("recording"))
    .values(data=bindparam("new_data"))
)
_SAVE = update(recordings).where(recordings.c.id == bindparam("recording"))


class SqlIngestRepository(Repository):
    """Port ``IngestRepository``."""

    def add_token(self, token: IngestToken, secret_hash: str) -> None:
        """Store a token by the hash of its secret."""
        values = {**asdict(token), "route": list(token.route), "secret_hash": secret_hash}
        self._write(insert(ingest_tokens).values(values))

    def get_token(self, token_id: str) -> IngestToken:
        """One token."""
        statement = select(ingest_tokens).where(ingest_tokens.c.id == token_id)
        return _token(self._one("ingest token", token_id, statement))

    def find_token(self, secret_hash: str) -> IngestToken | None:
        """The token of this secret, revoked or not."""
        row = self._read(_FIND_TOKEN, {"hash": secret_hash}).one_or_none()
        return None if row is None else _token(row)

    def list_tokens(self, *, device_id: str | None, cursor: str | None, limit: int) -> Page[IngestToken]:
        """Tokens, newest first."""
        statement = select(ingest_tokens)
        if device_id is not None:
            statement = statement.where(ingest_tokens.c.device_id == device_id)
        return self._newest_first(statement, ingest_tokens.c.id, _token, cursor=cursor, limit=limit)

    def revoke_token(self, token_id: str, now: datetime) -> IngestToken:
        """Note the time of revocation, the first one if there are several."""
        unrevoked = (ingest_tokens.c.id == token_id) & ingest_tokens.c.revoked_at.is_(None)
        self._write(update(ingest_tokens).where(unrevoked).values(revoked_at=now))
        return self.get_token(token_id)

    def touch_token(self, token_id: str, now: datetime) -> None:
        """Note that the token was used."""
        self._write(update(ingest_tokens).where(ingest_tokens.c.id == token_id).values(last_used_at=now))

    def add(self, recording: RecordingInfo) -> None:
        """Store a new recording."""
        self._write(insert(recordings).values(_values(recording)))

    def save(self, recording: RecordingInfo, rest: bytes | None) -> None:
        """Store a recording as it is now, with the readings that the next message needs (None: they stay)."""
        values = _values(recording)
        self._write(
            _SAVE.values({name: value for name, value in values.items() if name != "id"}), {"recording": values["id"]}
        )
        key = {"recording": recording.id}
        if rest is not None and not self._write(_SET_REST, {**key, "new_data": rest}).rowcount:
            self._write(insert(recording_rests).values(recording_id=recording.id, data=rest))

    def get(self, recording_id: str) -> RecordingInfo:
        """One recording."""
        statement = select(recordings).where(recordings.c.id == recording_id)
        return _recording(self._one("recording", recording_id, statement))

    def rest(self, recording_id: str) -> bytes:
        """Readings that the next message needs; empty: none."""
        found = self._read(_REST, {"recording": recording_id}).scalar()
        return b"" if found is None else bytes(found)

    def latest(self, token_id: str, app_session: str | None = None) -> RecordingInfo | None:
        """The newest recording of a token, or the newest part of one."""
        statement = select(recordings).where(recordings.c.token_id == token_id)
        if app_session is None:
            statement = statement.order_by(recordings.c.id.desc())
        else:
            statement = statement.where(recordings.c.app_session == app_session).order_by(recordings.c.part.desc())
        row = self._read(statement.limit(1)).one_or_none()
        return None if row is None else _recording(row)

    def list(
        self,
        *,
        token_id: str | None,
        device_id: str | None,
        purpose: Purpose | None,
        state: RecordingState | None,
        cursor: str | None,
        limit: int,
    ) -> Page[RecordingInfo]:
        """Recordings, newest first."""
        statement = select(recordings)
        wanted = {"token_id": token_id, "device_id": device_id, "purpose": purpose, "state": state}
        for name, value in wanted.items():
            if value is not None:
                statement = statement.where(recordings.c[name] == value)
        return self._newest_first(statement, recordings.c.id, _recording, cursor=cursor, limit=limit)

    def silent_since(self, then: datetime, *, limit: int) -> Sequence[str]:
        """Ids of open recordings whose last message came before."""
        is_open = recordings.c.state == RecordingState.OPEN.value
        statement = select(recordings.c.id).where(is_open, recordings.c.last_at < then)
        return tuple(self._read(statement.order_by(recordings.c.last_at).limit(limit)).scalars())

    def add_message(self, recording_id: str, message: Stored) -> bool:
        """Store a message; False if this number was stored before."""
        key = {"recording": recording_id, "wanted": message.number}
        if self._read(_HAS, key).first() is not None:
            return False
        values = {"recording_id": recording_id, "number": message.number, "readings": message.readings}
        self._write(_INSERT_MESSAGE, {**values, "received_at": message.received_at})
        return True

    def messages(self, recording_id: str) -> Sequence[Stored]:
        """Messages whose readings are kept, by number."""
        rows = self._read(_MESSAGES, {"recording": recording_id})
        return tuple(Stored(row.number, row.readings, row.received_at) for row in rows)

    def drop_readings(self, recording_id: str, numbers: Sequence[int] | None = None) -> None:
        """Forget the readings of messages (None: of all); that they came is remembered."""
        statement = update(recording_messages).where(recording_messages.c.recording_id == recording_id)
        if numbers is not None:
            statement = statement.where(recording_messages.c.number.in_(numbers))
        self._write(statement.values(readings=None))

    def markers(self, level_id: str) -> Sequence[Marker]:
        """Marked points of a level, by name."""
        rows = self._read(
            select(level_markers).where(level_markers.c.level_id == level_id).order_by(level_markers.c.name)
        )
        return tuple(Marker(row.name, row.x, row.y) for row in rows)

    def set_markers(self, level_id: str, markers: Sequence[Marker]) -> None:
        """Put these in place of what there was."""
        self._write(delete(level_markers).where(level_markers.c.level_id == level_id))
        if markers:
            self._write(insert(level_markers), [{"level_id": level_id, **asdict(marker)} for marker in markers])


def _values(recording: RecordingInfo) -> dict[str, Any]:
    return {
        **asdict(recording),
        "walk_ids": list(recording.walk_ids),
        "annotations": [[note.t_ns, note.text] for note in recording.annotations],
    }


def _token(row: Row[Any]) -> IngestToken:
    return IngestToken(
        id=row.id,
        name=row.name,
        app=IngestApp(row.app),
        purpose=Purpose(row.purpose),
        device_id=row.device_id,
        venue_id=row.venue_id,
        level_id=row.level_id,
        survey_id=row.survey_id,
        frame=PhoneFrame(row.frame),
        prior=None if row.prior is None else prior_from(row.prior),
        contribute=row.contribute,
        build=BuildOnArrival(row.build),
        route=tuple(row.route),
        key_id=row.key_id,
        created_at=row.created_at,
        last_used_at=row.last_used_at,
        revoked_at=row.revoked_at,
    )


def _recording(row: Row[Any]) -> RecordingInfo:
    return RecordingInfo(
        id=row.id,
        token_id=row.token_id,
        device_id=row.device_id,
        app_session=row.app_session,
        part=row.part,
        purpose=Purpose(row.purpose),
        venue_id=row.venue_id,
        level_id=row.level_id,
        session_id=row.session_id,
        survey_id=row.survey_id,
        walk_ids=tuple(row.walk_ids),
        state=RecordingState(row.state),
        next_number=row.next_number,
        until_ns=row.until_ns,
        started_ns=row.started_ns,
        annotations=tuple(Annotation(t_ns, text) for t_ns, text in row.annotations),
        n_messages=row.n_messages,
        n_samples=row.n_samples,
        n_late=row.n_late,
        problem=row.problem,
        opened_at=row.opened_at,
        last_at=row.last_at,
        closed_at=row.closed_at,
    )
