from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest

from app.services.alarm_rules import PER_RULE, RULES, Facts, Severity, alarms_of
from app.services.records import JobKind, LastingChange
from app.services.stats_records import (
    AccuracyRow,
    BacklogRow,
    DiskUsage,
    Ended,
    LastHeard,
    LevelRow,
)
from app.services.webhook_records import Delivery, DeliveryState, WebhookEvent
from tests.support.builders import START

QUIET = Facts(now=START)
LEVEL = LevelRow(
    level_id="lvl_1",
    venue_id="ven_1",
    name="F2",
    sessions=3,
    last_session_at=START,
    walks=4,
    last_walk_at=START - timedelta(hours=2),
    map_id="map_1",
    map_version=1,
    map_created_at=START - timedelta(hours=1),
    map_age_days=0.04,
    map_behind=False,
)
BUDGET = AccuracyRow(START, "sure", "lvl_1", None, None, 40, 1.0, 2.0, 3.0, 0.7, 0.55, 0.82)
CHANGE = LastingChange("chg_1", "lvl_1", "map_1", (0.0, 0.0, 2.0, 3.0), 6.0, (5.0,), None, None, START)


def queue(kind: JobKind, seconds: float) -> Facts:
    return replace(QUIET, backlog=[BacklogRow(kind, 3, 1, seconds, None)])


def heard(ago: timedelta, device_id: str | None = "dev_1") -> Facts:
    return replace(QUIET, heard=[LastHeard("ses_1", device_id, START - ago)])


def unsent(ago: timedelta) -> Facts:
    message = Delivery(
        id="whd_1",
        webhook_id="whk_1",
        event_id="gev_1",
        event=WebhookEvent.GEOFENCE_ENTER,
        body="{}",
        state=DeliveryState.PENDING,
        attempts=4,
        next_attempt_at=START,
        last_attempt_at=START,
        last_status=500,
        last_error=None,
        created_at=START - ago,
    )
    return replace(QUIET, unsent=[message])


CASES = [
    ("workers-dead", replace(QUIET, workers=(0, 2)), replace(QUIET, workers=(1, 2))),
    ("workers-missing", replace(QUIET, workers=(1, 2)), replace(QUIET, workers=(2, 2))),
    ("disk-full", replace(QUIET, disk=DiskUsage(1, 1, 1, 100)), replace(QUIET, disk=DiskUsage(1, 1, 3, 100))),
    ("disk-low", replace(QUIET, disk=DiskUsage(1, 1, 9, 100)), replace(QUIET, disk=DiskUsage(1, 1, 11, 100))),
    ("queue-stuck", queue(JobKind.LOCATE_SEGMENT, 601.0), queue(JobKind.LOCATE_SEGMENT, 599.0)),
    ("queue-old", queue(JobKind.LOCATE_SEGMENT, 31.0), queue(JobKind.BUILD_MAP, 31.0)),
    ("builds-old", queue(JobKind.BUILD_MAP, 3601.0), queue(JobKind.BUILD_MAP, 3599.0)),
    (
        "jobs-failing",
        replace(QUIET, ended=[Ended(JobKind.BUILD_MAP, 60, 5, 0)]),
        replace(QUIET, ended=[Ended(JobKind.BUILD_MAP, 0, 4, 9), Ended(JobKind.LOCATE_SEGMENT, 995, 5, 0)]),
    ),
    (
        "error-budget-missed",
        replace(QUIET, accuracy=[BUDGET]),
        replace(
            QUIET,
            accuracy=[replace(BUDGET, fixes="all"), replace(BUDGET, n=19), replace(BUDGET, inside_high=0.94)],
        ),
    ),
    (
        "map-behind",
        replace(QUIET, levels=[replace(LEVEL, map_behind=True)]),
        replace(QUIET, levels=[replace(LEVEL, map_behind=True)], building=frozenset({"lvl_1"})),
    ),
    (
        "map-missing",
        replace(QUIET, levels=[replace(LEVEL, map_id=None)]),
        replace(QUIET, levels=[LEVEL, replace(LEVEL, map_id=None, last_walk_at=START)]),
    ),
    ("contributions-conflict", replace(QUIET, quarantined=[("lvl_1", 3)]), replace(QUIET, quarantined=[("lvl_1", 2)])),
    ("field-changed", replace(QUIET, changes=[CHANGE]), replace(QUIET, changes=[replace(CHANGE, area_m2=0.5)])),
    ("webhook-failing", unsent(timedelta(minutes=16)), unsent(timedelta(minutes=14))),
    ("device-silent", heard(timedelta(minutes=11)), heard(timedelta(minutes=9))),
    ("sessions-abandoned", heard(timedelta(days=2)), heard(timedelta(hours=23), None)),
]


def test_every_rule_has_a_case() -> None:
    assert [name for name, _, _ in CASES] == sorted(
        (name for name, _, _ in CASES), key=[name for name, _, _ in CASES].index
    )
    assert {name for name, _, _ in CASES} == {rule.name for rule in RULES}


@pytest.mark.parametrize(("name", "trouble", "fine"), CASES, ids=lambda value: value if isinstance(value, str) else "")
def test_a_rule_finds_its_trouble_and_nothing_else(name: str, trouble: Facts, fine: Facts) -> None:
    (alarm,) = [alarm for alarm in alarms_of(trouble, RULES) if alarm.rule == name]
    assert alarm.subject
    assert alarm.message
    assert alarm.remedy
    assert name not in {alarm.rule for alarm in alarms_of(fine, RULES)}


def test_a_quiet_service_has_no_alarms() -> None:
    healthy = replace(QUIET, workers=(2, 2), disk=DiskUsage(1, 1, 50, 100), levels=[LEVEL])
    assert alarms_of(healthy, RULES) == ()


def test_the_severe_come_first_and_no_rule_fills_the_list() -> None:
    crowd = [LastHeard(f"ses_{i}", f"dev_{i}", START - timedelta(hours=1)) for i in range(100)]
    facts = replace(QUIET, heard=crowd, workers=(0, 2), quarantined=[("lvl_1", 9)])
    found = alarms_of(facts, RULES)
    assert found[0].severity is Severity.CRITICAL
    assert len([alarm for alarm in found if alarm.rule == "device-silent"]) == PER_RULE
