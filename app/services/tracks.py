"""Tracks of sessions as files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from app.engine.types import FixKind
from app.exchange.tracks import FORMATS, TrackDocument, TrackFormat, TrackPoint
from app.services.base import MAX_LIMIT, Service
from app.services.clock import Clock
from app.services.exchange import software
from app.services.ports import UnitOfWorkFactory
from app.services.records import Page, Position
from app.services.trajectories import TrajectoryService


@dataclass(frozen=True, slots=True)
class TrackExport:
    """A track that is ready to be sent: ``pieces`` are read from the database as they are asked for."""

    file_name: str
    media_type: str
    pieces: Iterator[bytes]


class TrackService(Service):
    """Writes the fixes of a session to a file, a page in memory at a time."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, trajectories: TrajectoryService) -> None:
        super().__init__(uow=uow, clock=clock)
        self._trajectories = trajectories

    def document(self, session_id: str, kind: FixKind) -> TrackDocument:
        """What the file says about itself; its ``plane`` is None where the venue has no anchor."""
        with self._uow() as uow:
            session = uow.sessions.get(session_id)
            venue = uow.venues.get(session.venue_id)
            levels = {one.level_id: uow.levels.get(one.level_id).name for one in session.maps}
        return TrackDocument(
            session_id=session.id,
            kind=kind,
            venue=venue.name,
            levels=levels,
            method=session.method,
            software=software(),
            map_ids=tuple(one.map_id for one in session.maps),
            device_id=session.device_id,
            plane=None if venue.anchor is None else venue.anchor.plane(),
        )

    def export(self, document: TrackDocument, kind: TrackFormat) -> TrackExport:
        """The file of a document's session.

        Smoothed fixes are computed here and now, by a worker. What can be refused is refused before the first piece.
        """
        form = FORMATS[kind]
        suffix = "" if document.kind is FixKind.FILTERED else f"-{document.kind.value}"
        return TrackExport(
            file_name=f"{document.session_id}{suffix}{form.suffix}",
            media_type=form.media_type,
            pieces=form.write(document, self._points(document.session_id, document.kind)),
        )

    def _points(self, session_id: str, kind: FixKind) -> Iterable[TrackPoint]:
        if kind is FixKind.SMOOTHED:
            fixes = self._trajectories.trajectory(session_id).fixes
            return [TrackPoint(number, fix) for number, fix in enumerate(fixes)]
        return self._stored(session_id, kind, self._page(session_id, kind, None))

    def _stored(self, session_id: str, kind: FixKind, page: Page[Position]) -> Iterator[TrackPoint]:
        while True:
            for position in page.items:
                yield TrackPoint(position.number, position.fix, position.seq)
            if page.next_cursor is None:
                return
            page = self._page(session_id, kind, page.next_cursor)

    def _page(self, session_id: str, kind: FixKind, cursor: str | None) -> Page[Position]:
        """One page in a transaction of its own: the receiver may be slow."""
        with self._uow() as uow:
            return uow.sessions.list_positions(session_id, seq=None, cursor=cursor, limit=MAX_LIMIT, kind=kind)
