"""A phone's message on its way into a session or a survey.

One transaction a message: stored, put in its turn, and as many samples cut as are complete. After that nothing is lost:
kill the service anywhere, and the next message goes on from what is stored.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import numpy as np

from app.engine.types import ImuSamples, PressureReadings
from app.exchange.phones.assembly import Assembled, assemble, in_frame
from app.exchange.phones.readings import NS, Annotation, Readings
from app.services.accounts import hash_secret
from app.services.aids import Aids, GnssReadings, to_level
from app.services.device_memory import starting_calibration
from app.services.errors import InvalidError, NoMapError, OverloadedError, SessionClosedError
from app.services.ids import new_id
from app.services.ingest.errors import IngestRefusedError, UnknownTokenError
from app.services.ingest.order import in_turn
from app.services.ingest.ports import UploadChecks
from app.services.ingest.records import Incoming, IngestToken, Purpose, RecordingInfo, RecordingState, Stored
from app.services.methods import AUTO
from app.services.open_sessions import RETRY_AFTER_S, NewSession, accept_segment, open_session
from app.services.ports import UnitOfWork
from app.services.records import Job, JobState, SessionStatus

TOUCH_EVERY = timedelta(minutes=1)
MIN_CUT_S = 0.5
"""Samples of less time wait for more: each segment costs a job."""
MAX_GAP_S = 1.0
MAX_SEGMENT_S = 30.0
MAX_SEGMENT_SAMPLES = 10_000
MAX_PIECES = 100
"""Segments that one message may become: minutes without a gap are two a minute."""
MAX_ANNOTATIONS = 2000
MAX_BEHIND_S = 60.0
"""Messages overtake each other by seconds; one that is older than what is done by more tells of a clock."""
CLOCK_SET_BACK = "the phone's clock was set back by {:.0f} s: stop recording, and start again"
MIN_HPA, MAX_HPA = 300.0, 1200.0
MAX_REST_BYTES = 8 * 2**20


@dataclass
class Effects:
    """What is to be told when the transaction is over."""

    jobs: list[Job] = field(default_factory=list)
    sessions: list[str] = field(default_factory=list)


def known_token(uow: UnitOfWork, secret: str) -> IngestToken:
    """The token of a secret; UnknownTokenError if there is none, or it was revoked."""
    token = uow.ingest.find_token(hash_secret(secret))
    if token is None or token.revoked_at is not None:
        raise UnknownTokenError
    return token


def token_of(uow: UnitOfWork, secret: str, now: datetime) -> IngestToken:
    """The token of a secret, with a note that it was used."""
    token = known_token(uow, secret)
    if token.last_used_at is None or now - token.last_used_at >= TOUCH_EVERY:
        uow.ingest.touch_token(token.id, now)
    return token


def recording_of(
    uow: UnitOfWork, token: IngestToken, message: Incoming, now: datetime, effects: Effects
) -> RecordingInfo:
    """The recording that a message belongs to: a new one if there is none, or if it goes on after it was closed."""
    latest = uow.ingest.latest(token.id, message.app_session)
    if latest is not None:
        old = message.number is not None and message.number < latest.next_number
        if latest.state is RecordingState.OPEN or old:
            return latest
    part = 0 if latest is None else latest.part + 1
    first = 0 if latest is None or message.number is None else message.number
    session_id = _open_session(uow, token, now, effects) if token.purpose is Purpose.LOCATE else None
    recording = RecordingInfo(
        id=new_id("rec", now),
        token_id=token.id,
        device_id=token.device_id,
        app_session=message.app_session,
        part=part,
        purpose=token.purpose,
        venue_id=token.venue_id,
        level_id=token.level_id,
        session_id=session_id,
        survey_id=token.survey_id,
        walk_ids=(),
        state=RecordingState.OPEN,
        next_number=first,
        until_ns=None if latest is None else latest.until_ns,
        started_ns=message.started_ns,
        annotations=(),
        n_messages=0,
        n_samples=0,
        n_late=0,
        problem="",
        opened_at=now,
        last_at=now,
        closed_at=None,
    )
    uow.ingest.add(recording)
    return recording


def _open_session(uow: UnitOfWork, token: IngestToken, now: datetime, effects: Effects) -> str:
    new = NewSession(
        level_id=token.level_id,
        venue_id=None if token.level_id is not None else token.venue_id,
        method=AUTO,
        prior=token.prior,
        device_id=token.device_id,
        contributor=token.key_id if token.contribute else None,
    )
    start = starting_calibration(uow, token.device_id, "")
    try:
        session = open_session(uow, new, start.calibration, now)
    except (NoMapError, InvalidError) as error:
        raise IngestRefusedError(f"Isodyn cannot locate here yet: {error}") from error
    effects.sessions.append(session.id)
    return session.id


@dataclass
class Receiver:
    """Takes what is stored of a recording as far as it is complete. Lives for one transaction."""

    uow: UnitOfWork
    checks: UploadChecks
    token: IngestToken
    recording: RecordingInfo
    now: datetime
    max_queued: int
    effects: Effects

    def take(self, message: Incoming) -> bool:
        """Store a message and go on; False if it was there already."""
        recording, purpose = self.recording, self.recording.purpose
        number = recording.next_number if message.number is None else message.number
        # a recording keeps no frame of its own: its end, and what is made of a survey, know the token's only
        told = self.token.frame if message.frame is None else message.frame
        readings = in_frame(message.readings, told, self.token.frame)
        in_turn_now = recording.state is RecordingState.OPEN and number >= recording.next_number
        stored = Stored(number, readings.pack(), self.now)
        if not self.uow.ingest.add_message(recording.id, stored):
            return False
        self.recording = replace(
            recording,
            n_messages=recording.n_messages + 1,
            n_late=recording.n_late + (purpose is Purpose.LOCATE and number < recording.next_number),
            last_at=self.now,
            annotations=_noted(recording.annotations, message.readings.annotations),
        )
        if in_turn_now and (behind_s := _behind_s(readings, recording.until_ns)) > MAX_BEHIND_S:
            self._note(CLOCK_SET_BACK.format(behind_s))
        if purpose is Purpose.SURVEY:
            self.recording = replace(self.recording, next_number=max(recording.next_number, number + 1))
        if recording.state is RecordingState.OPEN:
            self.advance()
            return True
        if recording.state is RecordingState.CLOSED:
            # too late for everything: that it came is all that is kept
            self.uow.ingest.drop_readings(recording.id, [number])
        self._save(None)
        return True

    def advance(self, *, final: bool = False) -> None:
        """Cut what is complete (``final``: all that can be had), and store how far that went."""
        if self.recording.purpose is Purpose.SURVEY:
            # messages are kept as they are until the walk ends: only the whole has waypoints
            self._save(None)
            return
        waiting = self.uow.ingest.messages(self.recording.id)
        turn, expected = in_turn(waiting, self.recording.next_number, self.now)
        if final:
            turn, expected = tuple(waiting), max([expected, *(one.number + 1 for one in waiting)])
        self.recording = replace(self.recording, next_number=expected)
        readings = self._readings(turn)
        cut = assemble(readings, self.token.frame, after_ns=self.recording.until_ns, final=final)
        rest = readings
        if (final or _long_enough(cut)) and self._segments(cut):
            self.recording = replace(self.recording, until_ns=cut.until_ns)
            rest = cut.rest
        elif final:
            raise OverloadedError(RETRY_AFTER_S)
        packed = rest.pack()
        if len(packed) > MAX_REST_BYTES:
            raise OverloadedError(RETRY_AFTER_S)
        self.uow.ingest.drop_readings(self.recording.id, [one.number for one in turn])
        self._save(packed)

    def _readings(self, turn: Iterable[Stored]) -> Readings:
        rest = self.uow.ingest.rest(self.recording.id)
        parts = [Readings.unpack(one.readings) for one in turn]
        return Readings.merged([Readings.unpack(rest), *parts] if rest else parts)

    def _segments(self, cut: Assembled) -> bool:
        """Take segments of what is complete; False if the queue is full: then it stays for the next message."""
        if cut.samples is None or self.recording.session_id is None:
            return True
        session = self.uow.sessions.get(self.recording.session_id)
        if session.status is SessionStatus.CLOSED:
            raise SessionClosedError(session.id)
        chosen = self._fewer(list(pieces(cut.samples)))
        if self.uow.jobs.count(JobState.QUEUED, JobState.RUNNING) + len(chosen) > self.max_queued:
            return False
        aids = self._aids(cut)
        for rows in chosen:
            samples = _rows(cut.samples, rows)
            try:
                new = self.checks.segment(session.next_seq, samples, between(aids, samples), self.now)
                accepted = accept_segment(self.uow, session, new, self.now, max_queued=self.max_queued)
            except InvalidError as error:
                self._note(f"{error.field} {error.message}: {error.remedy}")
                continue
            self.effects.jobs.append(accepted.job)
            session = replace(session, next_seq=session.next_seq + 1)
            self.recording = replace(self.recording, n_samples=self.recording.n_samples + len(samples))
        return True

    def _fewer(self, found: list[slice]) -> list[slice]:
        """The longest pieces, in order, where there are more than the queue could ever take at once."""
        most = min(MAX_PIECES, self.max_queued)
        if len(found) <= most:
            return found
        self._note(
            f"readings have {len(found) - 1} gaps of more than {MAX_GAP_S:g} s: the {most} longest pieces are taken"
        )
        longest = sorted(found, key=lambda rows: rows.start - rows.stop)[:most]
        return sorted(longest, key=lambda rows: rows.start)

    def _aids(self, cut: Assembled) -> Aids:
        gnss = None
        if cut.gnss is not None:
            told = cut.gnss
            # platforms tell a negative accuracy where there is no fix
            rows = (told.accuracy_m > 0.0) & (np.abs(told.latitude_deg) <= 90.0) & (np.abs(told.longitude_deg) <= 180.0)
            columns = (told.t, told.latitude_deg, told.longitude_deg, told.accuracy_m)
            gnss = GnssReadings(*(column[rows] for column in columns)) if rows.any() else None
        if gnss is not None:
            anchor = self.uow.venues.get(self.recording.venue_id).anchor
            try:
                to_level(gnss, None if anchor is None else anchor.plane())
            except InvalidError:
                # A phone tells where it is without being asked; a venue without an anchor has no use for that.
                gnss = None
        return Aids(gnss=gnss, pressure=_believed(cut.pressure), steps=cut.steps)

    def _note(self, problem: str) -> None:
        self.recording = replace(self.recording, problem=problem[:1000])

    def _save(self, rest: bytes | None) -> None:
        self.uow.ingest.save(self.recording, rest)


def _believed(pressure: PressureReadings | None) -> PressureReadings | None:
    """Pressures that can be on earth."""
    if pressure is None:
        return None
    rows = (pressure.hpa >= MIN_HPA) & (pressure.hpa <= MAX_HPA)
    return PressureReadings(pressure.t[rows], pressure.hpa[rows]) if rows.any() else None


def _noted(before: Sequence[Annotation], new: Sequence[Annotation]) -> tuple[Annotation, ...]:
    return tuple(sorted({*before, *new}))[:MAX_ANNOTATIONS]


def _behind_s(readings: Readings, until_ns: int | None) -> float:
    """By how much the newest reading is older than what was taken already."""
    if until_ns is None or not readings.series:
        return 0.0
    return (until_ns - max(int(one.t_ns[-1]) for one in readings.series.values())) / NS


def _long_enough(cut: Assembled) -> bool:
    return cut.samples is not None and float(cut.samples.t[-1] - cut.samples.t[0]) >= MIN_CUT_S


def pieces(samples: ImuSamples) -> Iterator[slice]:
    """Rows of segments: without gaps, none too long."""
    t = samples.t
    bounds = [0, *(np.flatnonzero(np.diff(t) > MAX_GAP_S) + 1).tolist(), len(t)]
    for begin, end in itertools.pairwise(bounds):
        start = begin
        while start < end:
            stop = min(end, start + MAX_SEGMENT_SAMPLES, int(np.searchsorted(t, t[start] + MAX_SEGMENT_S, "right")))
            if stop - start > 1:
                yield slice(start, stop)
            start = stop


def _rows(samples: ImuSamples, rows: slice) -> ImuSamples:
    return ImuSamples(samples.t[rows], samples.mag[rows], samples.acc[rows], samples.gyro[rows])


def between(aids: Aids, samples: ImuSamples) -> Aids:
    """The aids of a segment's time."""
    low, high = float(samples.t[0]) - MAX_GAP_S, float(samples.t[-1])
    parts = {}
    for name in ("gnss", "pressure", "steps"):
        aid = getattr(aids, name)
        if aid is None:
            continue
        rows = (aid.t > low) & (aid.t <= high)
        if rows.any():
            parts[name] = type(aid)(*(getattr(aid, column)[rows] for column in aid.__slots__))
    return Aids(**parts)
