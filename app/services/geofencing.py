"""Crossings of geofences, found in the transaction that stores the fixes: none is told twice, none is lost.

Whether a fix is inside is a probability. A session enters when it is the geofence's confidence or more, leaves when it
is one minus that or less, and else stays what it was: a position that wanders along a border does not flicker. Only
fixes that claim a position count (status ``ok``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from app.engine.geofencing import FAR_SD, inside_probability
from app.engine.types import Fix, Float64Array, Status
from app.services.geofence_ports import Box
from app.services.geofence_records import Geofence, GeofenceEvent, GeofenceEventKind, Stay, Watched
from app.services.ids import new_id
from app.services.ports import UnitOfWork
from app.services.records import Session
from app.services.webhook_outbox import announce, iso
from app.services.webhook_records import WebhookEvent

ANOTHER_LEVEL = "another level"
SESSION_CLOSED = "session closed"
GEOFENCE_DELETED = "geofence deleted"
_MIN_REACH_M = 0.01

_ANNOUNCED = {
    GeofenceEventKind.ENTER: WebhookEvent.GEOFENCE_ENTER,
    GeofenceEventKind.LEAVE: WebhookEvent.GEOFENCE_LEAVE,
    GeofenceEventKind.DWELL: WebhookEvent.GEOFENCE_DWELL,
}


@dataclass(frozen=True, slots=True)
class Crossing:
    """What a fix showed about a geofence: the fix by its index, the stay it began, lasted in or ended."""

    kind: GeofenceEventKind
    index: int
    stay: Stay
    probability: float


def crossings(
    geofence: Geofence, stay: Stay | None, times: Float64Array, probabilities: Float64Array
) -> tuple[tuple[Crossing, ...], Stay | None]:
    """What fixes show about a geofence, and the stay after them (None: outside).

    Parameters
    ----------
    stay : Stay or None
        The stay before them.
    times, probabilities : array, shape (n,)
        UTC seconds, increasing, and how likely each is inside.
    """
    found: list[Crossing] = []
    for index, (t, probability) in enumerate(zip(times.tolist(), probabilities.tolist(), strict=True)):
        if stay is None and probability >= geofence.confidence:
            stay = Stay(t)
            found.append(Crossing(GeofenceEventKind.ENTER, index, stay, probability))
        elif stay is not None and probability <= 1.0 - geofence.confidence:
            found.append(Crossing(GeofenceEventKind.LEAVE, index, stay, probability))
            stay = None
        if stay is not None and _lasted(geofence, stay, t):
            stay = Stay(stay.entered_t, dwelled=True)
            found.append(Crossing(GeofenceEventKind.DWELL, index, stay, probability))
    return tuple(found), stay


def watch_fixes(uow: UnitOfWork, session_id: str, seq: int, fixes: Sequence[Fix], now: datetime) -> None:
    """Move the session in and out of geofences; to be called in the transaction that stores these fixes."""
    claimed = [fix for fix in fixes if fix.status is Status.OK]
    if not claimed:
        return
    places = _Places.of(claimed)
    watched = uow.geofences.watched(session_id, frozenset(places.level_ids), places.reach())
    told: list[tuple[Geofence, Crossing]] = []
    for one in watched:
        found, stay = crossings(one.geofence, one.stay, places.times, places.probabilities(one.geofence))
        if stay != one.stay:
            uow.geofences.set_stay(session_id, one.geofence.id, one.stay, stay)
        told += [(one.geofence, crossing) for crossing in found if crossing.kind in one.geofence.events]
    if told:
        session = uow.sessions.get(session_id)
        told.sort(key=lambda pair: pair[1].index)
        _tell(uow, [_event(session, seq, fence, one, claimed[one.index], now) for fence, one in told], now)


def leave_all(uow: UnitOfWork, session_id: str, now: datetime) -> None:
    """End the stays of a session that is over; to be called in the transaction in which it ends."""
    end_stays(uow, uow.geofences.stays(session_id=session_id), SESSION_CLOSED, now)


def end_stays(uow: UnitOfWork, watched: Iterable[Watched], reason: str, now: datetime) -> None:
    """End stays without a fix outside."""
    told = []
    for one in watched:
        uow.geofences.set_stay(one.session_id, one.geofence.id, one.stay, None)
        if one.stay is not None and GeofenceEventKind.LEAVE in one.geofence.events:
            told.append(_ended(uow, one.geofence, one.session_id, one.stay, reason, now))
    _tell(uow, told, now)


def event_data(event: GeofenceEvent) -> dict[str, object]:
    """An event in plain values, as the API and webhooks show it."""
    return {
        "id": event.id,
        "kind": event.kind.value,
        "geofence_id": event.geofence_id,
        "geofence_name": event.geofence_name,
        "session_id": event.session_id,
        "device_id": event.device_id,
        "venue_id": event.venue_id,
        "level_id": event.level_id,
        "seq": event.seq,
        "t_ms": round(event.t * 1000.0, 3),
        "x": _rounded(event.x, 3),
        "y": _rounded(event.y, 3),
        "probability": _rounded(event.probability, 6),
        "dwell_s": _rounded(event.dwell_s, 3),
        "reason": event.reason,
        "created_at": iso(event.created_at),
    }


def _lasted(geofence: Geofence, stay: Stay, t: float) -> bool:
    return geofence.dwell_s is not None and not stay.dwelled and t - stay.entered_t >= geofence.dwell_s


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Fixes as arrays, taken apart once for all geofences: shapes (n,), (n, 2) m and (n, 3) m^2."""

    level_ids: tuple[str, ...]
    times: Float64Array
    mean: Float64Array
    covariance: Float64Array

    @classmethod
    def of(cls, fixes: Sequence[Fix]) -> _Places:
        return cls(
            tuple(fix.level_id for fix in fixes),
            np.array([fix.t for fix in fixes]),
            np.array([(fix.x, fix.y) for fix in fixes]),
            np.array([(fix.cov_xx, fix.cov_xy, fix.cov_yy) for fix in fixes]),
        )

    def reach(self) -> Box:
        """The box beyond which none of them lies in all likelihood."""
        far = np.maximum(FAR_SD * np.sqrt(np.maximum(self.covariance[:, [0, 2]], 0.0)), _MIN_REACH_M)
        (x_min, y_min), (x_max, y_max) = (self.mean - far).min(axis=0), (self.mean + far).max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)

    def probabilities(self, geofence: Geofence) -> Float64Array:
        """How likely each is inside; not at all on another level."""
        found = inside_probability(np.array(geofence.polygon), self.mean, self.covariance)
        here = [level_id == geofence.level_id for level_id in self.level_ids]
        return found if all(here) else np.where(here, found, 0.0)


def _event(
    session: Session, seq: int, geofence: Geofence, crossing: Crossing, fix: Fix, now: datetime
) -> GeofenceEvent:
    here = fix.level_id == geofence.level_id
    entered = crossing.kind is GeofenceEventKind.ENTER
    return GeofenceEvent(
        id=new_id("gev", now),
        kind=crossing.kind,
        geofence_id=geofence.id,
        geofence_name=geofence.name,
        session_id=session.id,
        device_id=session.device_id,
        venue_id=session.venue_id,
        level_id=geofence.level_id,
        seq=seq,
        t=fix.t,
        x=fix.x if here else None,
        y=fix.y if here else None,
        probability=crossing.probability,
        dwell_s=None if entered else fix.t - crossing.stay.entered_t,
        reason=None if here else ANOTHER_LEVEL,
        created_at=now,
    )


def _ended(
    uow: UnitOfWork, geofence: Geofence, session_id: str, stay: Stay, reason: str, now: datetime
) -> GeofenceEvent:
    """The end of a stay, at the time of the session's last position: later, nothing is known of it."""
    session = uow.sessions.get(session_id)
    last = uow.geofences.last_claimed(session_id)
    t = stay.entered_t if last is None else max(last.fix.t, stay.entered_t)
    there = last is not None and last.fix.level_id == geofence.level_id
    return GeofenceEvent(
        id=new_id("gev", now),
        kind=GeofenceEventKind.LEAVE,
        geofence_id=geofence.id,
        geofence_name=geofence.name,
        session_id=session.id,
        device_id=session.device_id,
        venue_id=session.venue_id,
        level_id=geofence.level_id,
        seq=None if last is None else last.seq,
        t=t,
        x=last.fix.x if last is not None and there else None,
        y=last.fix.y if last is not None and there else None,
        probability=None,
        dwell_s=t - stay.entered_t,
        reason=reason,
        created_at=now,
    )


def _tell(uow: UnitOfWork, events: Sequence[GeofenceEvent], now: datetime) -> None:
    if not events:
        return
    uow.geofences.add_events(events)
    for event in events:
        kind = _ANNOUNCED[event.kind]
        announce(uow, kind, event.id, event_data(event), now, venue_id=event.venue_id, level_id=event.level_id)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
