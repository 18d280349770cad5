"""Alarms: what is worth an operator's attention now."""

from __future__ import annotations

from app.services.activity import Host
from app.services.alarm_rules import FAILING, RECENT, RULES, Alarm, Facts, alarms_of
from app.services.base import Service
from app.services.clock import Clock
from app.services.ports import UnitOfWork, UnitOfWorkFactory
from app.services.records import JobKind
from app.services.stats_records import NO_FILTERS, GroupBy, Window
from app.services.stats_tables import accuracy_rows, backlog_rows

_JOBS = 20_000
_POINTS = 20_000
_LEVELS = 500
_SESSIONS = 1000
_CHANGES = 100
_WEBHOOKS = 100


class AlarmService(Service):
    """Gathers what the rules look at, within bounds, and applies them; an alarm ends with its cause."""

    def __init__(self, *, uow: UnitOfWorkFactory, clock: Clock, host: Host | None = None) -> None:
        super().__init__(uow=uow, clock=clock)
        self._host = host

    def now(self) -> tuple[Alarm, ...]:
        """All alarms, the most severe first."""
        with self._uow() as uow:
            return alarms_of(self._facts(uow), RULES)

    def _facts(self, uow: UnitOfWork) -> Facts:
        now = self._clock()
        hour, week = (Window(now - span, now, open_end=True) for span in (FAILING, RECENT))
        judged = uow.ground_truth.judged(week, NO_FILTERS, limit=_POINTS)
        levels = uow.inventory.levels(week, venue_id=None, level_id=None, cursor=None, limit=_LEVELS)
        behind = [row.level_id for row in levels if row.map_behind or row.map_id is None]
        return Facts(
            now=now,
            backlog=backlog_rows(uow.activity.waiting(), now),
            ended=[uow.activity.ended(kind, hour, NO_FILTERS, limit=_JOBS) for kind in JobKind],
            failures=[
                failure
                for kind in JobKind
                for failure in uow.activity.failures(kind, hour, NO_FILTERS, limit=_JOBS).rows
            ],
            disk=None if self._host is None else self._host.disk(),
            workers=None if self._host is None else self._host.workers(),
            accuracy=accuracy_rows(week, judged, (GroupBy.LEVEL,)),
            levels=levels,
            building=frozenset(level_id for level_id in behind if uow.jobs.is_pending(level_id)),
            quarantined=sorted(uow.inventory.quarantined(week.since).items()),
            changes=uow.inventory.changes(week.since, limit=_CHANGES),
            unsent=uow.webhooks.oldest_pending(limit=_WEBHOOKS),
            heard=uow.inventory.open_sessions(limit=_SESSIONS),
        )
