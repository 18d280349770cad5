"""The samples of a session as they came, and the field that they hold beside what the map says along the track."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from app.engine.inertial.attitude import Attitude
from app.engine.localization.field_profile import FieldProfile, FieldReadings, field_profile, read_field
from app.engine.types import DeviceCalibration, ImuSamples
from app.services.base import MAX_LIMIT, Service
from app.services.clock import Clock
from app.services.map_refs import MapRefs
from app.services.ports import MapCache, UnitOfWorkFactory
from app.services.records import Page, Position, SegmentInfo, Session

PROFILE_S = 1800.0
"""A profile is of the last half hour: somebody waits for it."""


@dataclass(frozen=True, slots=True)
class NumberedSamples:
    """The samples of one segment; seconds, microtesla, m/s^2, rad/s; body frame of Android."""

    seq: int
    samples: ImuSamples


@dataclass(frozen=True, slots=True)
class SessionProfile:
    """Measured and mapped field at the positions of a session.

    ``calibration`` is what was taken off the readings: what the session has learned about its device by now, else what
    it started with; None: they stand as they came.
    """

    session_id: str
    positions: tuple[Position, ...]
    field: FieldProfile
    calibration: DeviceCalibration | None
    learned: bool


class SessionSamplesService(Service):
    """Reads stored samples, a segment in memory at a time."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, cache: MapCache) -> None:
        super().__init__(uow=uow, clock=clock)
        self._refs = MapRefs(uow=uow, cache=cache)

    def segments(self, session_id: str, after: int = -1, last: int | None = None) -> Iterator[NumberedSamples]:
        """Samples of the segments above number ``after``, up to ``last``, oldest first; NotFoundError at once."""
        with self._uow() as uow:
            end = uow.sessions.get(session_id).next_seq - 1
        return self._segments(session_id, after + 1, end if last is None else min(last, end))

    def profile(self, session_id: str) -> SessionProfile:
        """The field at the positions of the session's last half hour."""
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            learned = uow.sessions.learned(session_id)
            newest = uow.sessions.last_segment(session_id)
        since = -np.inf if newest is None else newest.t_end - PROFILE_S
        readings = self._readings(session, since)
        positions = tuple(one for one in self._positions(session_id) if one.fix.t >= since)
        maps = {one.level_id: self._refs.grid(one.map_id) for one in session.maps}
        calibration = learned or session.prior.calibration
        field = field_profile(readings, [one.fix for one in positions], maps, calibration)
        return SessionProfile(session_id, positions, field, calibration, learned is not None)

    def _segments(self, session_id: str, first: int, last: int) -> Iterator[NumberedSamples]:
        for seq in range(first, last + 1):
            # a transaction each: the receiver may be slow
            with self._uow() as uow:
                samples = uow.sessions.load_segment(session_id, seq).samples
            yield NumberedSamples(seq, samples)

    def _readings(self, session: Session, since: float) -> FieldReadings:
        attitude: Attitude | None = None
        parts = [FieldReadings(np.empty(0), np.empty((0, 3)))]
        for info in self._infos(session.id):
            if info.t_end < since:
                continue
            with self._uow() as uow:
                samples = uow.sessions.load_segment(session.id, info.seq).samples
            part, attitude = read_field(samples, attitude)
            parts.append(part)
        return FieldReadings(np.concatenate([one.t for one in parts]), np.concatenate([one.field for one in parts]))

    def _infos(self, session_id: str) -> Iterator[SegmentInfo]:
        cursor: str | None = None
        while True:
            with self._uow() as uow:
                page = uow.sessions.list_segments(session_id, cursor=cursor, limit=MAX_LIMIT)
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return

    def _positions(self, session_id: str) -> Iterator[Position]:
        cursor: str | None = None
        while True:
            with self._uow() as uow:
                page: Page[Position] = uow.sessions.list_positions(session_id, seq=None, cursor=cursor, limit=MAX_LIMIT)
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return
