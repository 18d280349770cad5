"""Alarms: what is worth an operator's attention, as a table of rules.

A rule looks at :class:`Facts` and names what it finds. Thresholds are policy, and stand in the table;
docs/operations.md lists every rule, and a test keeps the two in step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from app.services.records import JobKind, LastingChange
from app.services.stats_records import (
    AccuracyRow,
    BacklogRow,
    DiskUsage,
    Ended,
    Failure,
    LastHeard,
    LevelRow,
)
from app.services.webhook_records import Delivery

PER_RULE = 20
"""A rule names at most so many subjects."""
RECENT = timedelta(days=7)
"""How far back rules about maps and errors look."""
FAILING = timedelta(hours=1)
"""How far back rules about jobs look."""


class Severity(StrEnum):
    """How soon somebody should look."""

    CRITICAL = "critical"
    WARNING = "warning"
    INFO = "info"


@dataclass(frozen=True, slots=True)
class Facts:
    """What rules look at, as of ``now``; None: nobody told."""

    now: datetime
    backlog: Sequence[BacklogRow] = ()
    ended: Sequence[Ended] = ()
    failures: Sequence[Failure] = ()
    disk: DiskUsage | None = None
    workers: tuple[int, int] | None = None
    accuracy: Sequence[AccuracyRow] = ()
    levels: Sequence[LevelRow] = ()
    building: frozenset[str] = frozenset()
    quarantined: Sequence[tuple[str, int]] = ()
    changes: Sequence[LastingChange] = ()
    heard: Sequence[LastHeard] = ()
    unsent: Sequence[Delivery] = ()
    """The oldest message of each webhook that waits."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a rule found: about what, in words, and since when (None: nobody knows)."""

    subject: str
    message: str
    since: datetime | None = None


@dataclass(frozen=True, slots=True)
class Rule:
    """One line of the table.

    ``threshold`` is what :attr:`check` compares with, in the unit that ``when`` names; ``when`` and ``remedy`` are for
    people.
    """

    name: str
    severity: Severity
    when: str
    threshold: float
    remedy: str
    check: Callable[[Facts, float], Iterable[Finding]]


@dataclass(frozen=True, slots=True)
class Alarm:
    """A rule that found something."""

    rule: str
    severity: Severity
    subject: str
    message: str
    since: datetime | None
    remedy: str


def alarms_of(facts: Facts, rules: Sequence[Rule]) -> tuple[Alarm, ...]:
    """Apply the rules; the most severe first, then in the order of the table."""
    found = [
        Alarm(rule.name, rule.severity, one.subject, one.message, one.since, rule.remedy)
        for rule in rules
        for one in list(rule.check(facts, rule.threshold))[:PER_RULE]
    ]
    order = list(Severity)
    return tuple(sorted(found, key=lambda alarm: order.index(alarm.severity)))


def _workers_dead(facts: Facts, least: float) -> Iterable[Finding]:
    if facts.workers is not None and facts.workers[0] < least:
        yield Finding("workers", f"none of {facts.workers[1]} workers is ready")


def _workers_missing(facts: Facts, share: float) -> Iterable[Finding]:
    if facts.workers is not None and 0 < facts.workers[0] < share * facts.workers[1]:
        yield Finding("workers", f"{facts.workers[0]} of {facts.workers[1]} workers are ready")


def _disk_low(facts: Facts, share: float) -> Iterable[Finding]:
    if facts.disk is not None and facts.disk.free < share * facts.disk.total:
        free, total = facts.disk.free / 2**30, facts.disk.total / 2**30
        yield Finding("data folder", f"{free:.1f} of {total:.1f} GiB are free")


def _queue_old(kinds: frozenset[JobKind]) -> Callable[[Facts, float], Iterable[Finding]]:
    def check(facts: Facts, seconds: float) -> Iterable[Finding]:
        for row in facts.backlog:
            if row.kind in kinds and row.oldest_queued_s is not None and row.oldest_queued_s > seconds:
                waits = f"{row.queued} wait, the oldest for {row.oldest_queued_s:.0f} s"
                yield Finding(row.kind.value, waits, facts.now - timedelta(seconds=row.oldest_queued_s))

    return check


def _jobs_failing(facts: Facts, share: float) -> Iterable[Finding]:
    for one in facts.ended:
        n = one.n_done + one.n_failed
        if one.n_failed >= _FAILURES_AT_LEAST and one.n_failed > share * n:
            since = min((failure.at for failure in facts.failures if failure.kind is one.kind), default=None)
            yield Finding(one.kind.value, f"{one.n_failed} of {n} jobs failed within the last hour", since)


def _budget_missed(facts: Facts, promised: float) -> Iterable[Finding]:
    for row in facts.accuracy:
        if row.fixes == "sure" and row.n >= _POINTS_AT_LEAST and row.inside_high < promised:
            held = f"the 95 % ellipse of sure fixes held {100 * row.inside_share:.0f} % of {row.n} known positions"
            interval = f"({100 * row.inside_low:.0f} to {100 * row.inside_high:.0f} %)"
            yield Finding(row.level_id or "all levels", f"{held} {interval}, p90 {row.p90_m:.1f} m", row.since)


def _map_behind(facts: Facts, hours: float) -> Iterable[Finding]:
    for row, last_walk_at in _walked(facts, hours):
        if row.map_behind:
            yield Finding(row.level_id, f"{row.name}: a survey walk is newer than the map", last_walk_at)


def _map_missing(facts: Facts, hours: float) -> Iterable[Finding]:
    for row, last_walk_at in _walked(facts, hours):
        if row.map_id is None:
            yield Finding(row.level_id, f"{row.name}: {row.walks} walks and no map", last_walk_at)


def _walked(facts: Facts, hours: float) -> Iterable[tuple[LevelRow, datetime]]:
    """Levels whose last walk is so old, and whose map nobody is building."""
    for row in facts.levels:
        old = row.last_walk_at is not None and facts.now - row.last_walk_at > timedelta(hours=hours)
        if old and row.last_walk_at is not None and row.level_id not in facts.building:
            yield row, row.last_walk_at


def _conflicts(facts: Facts, n: float) -> Iterable[Finding]:
    for level_id, count in facts.quarantined:
        if count >= n:
            yield Finding(level_id, f"{count} contributions of the last 7 days contradict the map or each other")


def _field_changed(facts: Facts, square_metres: float) -> Iterable[Finding]:
    for change in facts.changes:
        if change.area_m2 >= square_metres:
            x_min, y_min, x_max, y_max = change.box
            where = f"({x_min:.1f}, {y_min:.1f}) to ({x_max:.1f}, {y_max:.1f}) m"
            yield Finding(change.level_id, f"the field changed for good at {where}", change.created_at)


def _webhook_failing(facts: Facts, minutes: float) -> Iterable[Finding]:
    for one in facts.unsent:
        if facts.now - one.created_at > timedelta(minutes=minutes):
            why = one.last_error or (f"status {one.last_status}" if one.last_status else "not tried yet")
            yield Finding(
                one.webhook_id, f"{one.attempts} attempts to send one message; the last: {why}", one.created_at
            )


def _device_silent(facts: Facts, minutes: float) -> Iterable[Finding]:
    for one in facts.heard:
        if one.device_id is not None and timedelta(minutes=minutes) < facts.now - one.last_at <= _ABANDONED:
            yield Finding(one.device_id, f"session {one.session_id} is open and sends nothing", one.last_at)


def _sessions_abandoned(facts: Facts, days: float) -> Iterable[Finding]:
    old = [one for one in facts.heard if facts.now - one.last_at > timedelta(days=days)]
    if old:
        oldest = min(old, key=lambda one: one.last_at)
        yield Finding(
            oldest.session_id, f"{len(old)} sessions are open and sent nothing for a day; the oldest", oldest.last_at
        )


_FAILURES_AT_LEAST = 5
_POINTS_AT_LEAST = 20
_ABANDONED = timedelta(days=1)

RULES: tuple[Rule, ...] = (
    Rule(
        "workers-dead",
        Severity.CRITICAL,
        "fewer than 1 worker is ready",
        1,
        "read the service's log for why they die, then restart it; accepted segments are kept",
        _workers_dead,
    ),
    Rule(
        "disk-full",
        Severity.CRITICAL,
        "less than 2 % of the data folder's disk is free",
        0.02,
        "free space or move the data folder at once: a full disk refuses every segment",
        _disk_low,
    ),
    Rule(
        "queue-stuck",
        Severity.CRITICAL,
        "the oldest segment has waited for more than 600 s",
        600,
        "see GET /v1/stats/backlog and /v1/stats/errors; restart the service if nothing runs",
        _queue_old(frozenset({JobKind.LOCATE_SEGMENT})),
    ),
    Rule(
        "queue-old",
        Severity.WARNING,
        "the oldest segment has waited for more than 30 s",
        30,
        "more comes in than the workers can do: raise ISODYN_WORKERS, or send less",
        _queue_old(frozenset({JobKind.LOCATE_SEGMENT})),
    ),
    Rule(
        "builds-old",
        Severity.WARNING,
        "the oldest map build or contribution has waited for more than 3600 s",
        3600,
        "see GET /v1/jobs?state=running: one build holds up the others; cancel it if it is not wanted",
        _queue_old(frozenset({JobKind.BUILD_MAP, JobKind.CONTRIBUTE})),
    ),
    Rule(
        "workers-missing",
        Severity.WARNING,
        "fewer than 100 % of the workers are ready",
        1.0,
        "wait a minute: dead workers are replaced; if it stays, look at memory and the log",
        _workers_missing,
    ),
    Rule(
        "disk-low",
        Severity.WARNING,
        "less than 10 % of the data folder's disk is free",
        0.10,
        "see GET /v1/stats/storage for what takes the space; make room before it is full",
        _disk_low,
    ),
    Rule(
        "jobs-failing",
        Severity.WARNING,
        "more than 5 % of a kind's jobs failed within the last hour, at least 5 of them",
        0.05,
        "see GET /v1/stats/errors for the texts, each with an example",
        _jobs_failing,
    ),
    Rule(
        "error-budget-missed",
        Severity.WARNING,
        "the share of known positions of 7 days inside sure fixes' ellipses lies below 93 %, beyond chance",
        0.93,
        "check the level's plan and markers, then survey it anew and build a map",
        _budget_missed,
    ),
    Rule(
        "map-behind",
        Severity.WARNING,
        "a survey walk was uploaded more than 1 h ago, after the level's map was made",
        1,
        'bring the map up to date: POST /v1/maps with "mode": "update"',
        _map_behind,
    ),
    Rule(
        "map-missing",
        Severity.INFO,
        "a level has walks, the last more than 1 h old, and no map",
        1,
        "build one: POST /v1/maps",
        _map_missing,
    ),
    Rule(
        "contributions-conflict",
        Severity.WARNING,
        "at least 3 contributions of a level were quarantined within 7 days",
        3,
        "look at GET /v1/contributions?state=quarantined; if they agree with each other, survey the place anew",
        _conflicts,
    ),
    Rule(
        "field-changed",
        Severity.INFO,
        "independent passes agree on a lasting change of at least 1 m² within 7 days",
        1,
        "the map has it already; see GET /v1/changes, and survey the place if it matters",
        _field_changed,
    ),
    Rule(
        "webhook-failing",
        Severity.WARNING,
        "a webhook's oldest message has waited for more than 15 min",
        15,
        "see GET /v1/webhooks/{webhook_id}/deliveries; mend the address, or pause the webhook",
        _webhook_failing,
    ),
    Rule(
        "device-silent",
        Severity.WARNING,
        "a device's open session has sent nothing for more than 10 min, and did within the last day",
        10,
        "look after the device, or close the session: POST /v1/sessions/{session_id}/close",
        _device_silent,
    ),
    Rule(
        "sessions-abandoned",
        Severity.INFO,
        "open sessions have sent nothing for more than 1 day",
        1,
        "close them: POST /v1/sessions/{session_id}/close",
        _sessions_abandoned,
    ),
)
