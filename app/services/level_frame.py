"""From what was uploaded to what the engine takes: satellite fixes go through the venue's anchor."""

from __future__ import annotations

from collections.abc import Iterable

from app.engine.types import Segment
from app.services.aids import Recording
from app.services.ports import UnitOfWork


def in_level_frame(uow: UnitOfWork, venue_id: str, recordings: Iterable[Recording]) -> tuple[Segment, ...]:
    """Segments for the engine; the venue is read only where there are satellite fixes.

    InvalidError if there are some and the venue has no anchor, or they lie elsewhere in the world.
    """
    recordings = tuple(recordings)
    anchor = None
    if any(recording.aids.gnss is not None for recording in recordings):
        anchor = uow.venues.get(venue_id).anchor
    plane = None if anchor is None else anchor.plane()
    return tuple(recording.segment(plane) for recording in recordings)
