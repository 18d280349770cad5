"""Changes of level while a session is tracked: what the barometer tells, and what follows from it."""

from __future__ import annotations

import numpy as np

from app.engine.localization.aids import GnssSighting, LevelSighting, Sighting
from app.engine.localization.integrity import spread
from app.engine.localization.session import Quest, SessionState
from app.engine.types import MapSource, Prior, Segment

STAIRS_M = 8.0
"""Standard deviation per axis of where stairs, escalators and lifts end, seen from where they were entered."""
LEFT_LOG = -3.0
"""Log odds of being on the level that the barometer says was left: one in twenty is a door or a draught."""


def changes_level(session: SessionState, segment: Segment, map_source: MapSource) -> bool:
    """Whether a session whose level is open reaches another one with these samples."""
    heard = session.barometer.hear(segment.pressure)
    arrived = heard.elsewhere and not heard.climbing
    return arrived and session.prior.level_id is None and len(map_source.level_ids()) > 1


def watch(session: SessionState, segment: Segment, map_source: MapSource) -> bool:
    """Take the barometer's readings; whether the walker is away from the level that is tracked.

    Away means: on the way to another level, or on one that there is no map of (the session names its level, or there is
    but one map). Who arrives on another level of a venue is searched on all of them, about where the way began.
    """
    arrived = changes_level(session, segment, map_source)
    session.barometer = session.barometer.hear(segment.pressure)
    if arrived:
        _search_levels(session, float(segment.samples.t[0]))
    return session.barometer.climbing or session.barometer.elsewhere


def _search_levels(session: SessionState, t: float) -> None:
    track, quest = session.track, session.quest
    known: tuple[Sighting, ...] = ()
    calibration = session.prior.calibration if quest is None else quest.prior.calibration
    if track is not None:
        e, calibration = track.estimate, track.calibration()
        sd = float(np.hypot(spread(e), STAIRS_M))
        # what is known of the place is told like a satellite fix: on any level, with a heavy tail
        known = (GnssSighting(t, e.x, e.y, sd, 1.0), LevelSighting(t, track.level_id, LEFT_LOG))
    session.track = None
    session.quest = Quest(Prior(None, calibration=calibration), whole=False, sightings=known)
    session.barometer = session.barometer.settled()
