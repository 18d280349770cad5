"""Crossings: what fixes show, what is stored of it, and that none is told twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from app.engine.types import Fix, Status
from app.services.errors import ConflictError, InvalidError, NotFoundError
from app.services.geofence_records import EventFilter, Geofence, GeofenceEvent, GeofenceEventKind, Stay
from app.services.geofences import DEFAULT_EVENTS, MAX_PER_LEVEL, GeofenceSpec
from app.services.geofencing import crossings
from app.services.records import Job, JobKind, Level, Session, VenueKind
from app.services.webhook_records import WebhookEvent
from tests.services.test_cost import _statements
from tests.support.builders import START, T0, World, fix, locate_result, new_segment

ROOM = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]]
IN, OUT, BORDER = (15.0, 15.0), (40.0, 15.0), (20.0, 15.0)
ALL = frozenset(GeofenceEventKind)
ENTER, LEAVE, DWELL = GeofenceEventKind.ENTER, GeofenceEventKind.LEAVE, GeofenceEventKind.DWELL


def room(world: World, level: Level, **changes: object) -> Geofence:
    spec = GeofenceSpec("room", ROOM, events=ALL, dwell_s=10.0)
    return world.services.geofences.create(level.id, replace(spec, **changes))


class Walker:
    """A session whose fixes the test decides."""

    def __init__(self, world: World, level: Level, session: Session | None = None) -> None:
        self.world, self.level = world, level
        self.session = session or world.session(level.id)
        self.seq = 0

    def queue(self) -> Job:
        self.world.services.sessions.accept(self.session.id, new_segment(self.seq, n=5))
        (job,) = self.world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
        return job

    def complete(self, job: Job, fixes: Sequence[Fix]) -> Job | None:
        result = replace(locate_result(self.seq, level_id=self.level.id), fixes=tuple(fixes))
        self.seq += 1
        return self.world.services.processing.complete_locate(job, result)

    def at(self, *places: tuple[float, float], status: Status = Status.OK, level_id: str | None = None) -> None:
        """One segment with fixes at these places, a second apart."""
        t0 = T0 + 5.0 * self.seq
        fixes = [
            replace(fix(t0 + i, level_id=level_id or self.level.id, x=x, y=y), status=status)
            for i, (x, y) in enumerate(places)
        ]
        self.complete(self.queue(), fixes)

    def close(self) -> None:
        self.world.services.sessions.close(self.session.id)


def told(world: World, **wanted: object) -> list[GeofenceEvent]:
    """Events, oldest first."""
    return list(reversed(world.services.geofences.events(EventFilter(**wanted)).items))  # type: ignore[arg-type]


def kinds(world: World) -> list[str]:
    return [event.kind.value for event in told(world)]


def fence(**changes: object) -> Geofence:
    made = Geofence("gfc", "lvl", "room", ((0.0, 0.0),), ALL, 10.0, 0.9, START, START)
    return replace(made, **changes)


def shown(
    probabilities: Sequence[float], stay: Stay | None = None, **changes: object
) -> tuple[list[tuple], Stay | None]:
    found, after = crossings(
        fence(**changes), stay, np.arange(len(probabilities), dtype=float), np.array(probabilities)
    )
    return [(one.kind.value, one.index) for one in found], after


def test_in_between_nothing_changes() -> None:
    assert shown([0.0, 0.5, 0.89, 0.5, 0.0]) == ([], None)
    assert shown([0.9, 0.11, 0.89, 0.11]) == ([("enter", 0)], Stay(0.0))
    assert shown([0.95, 0.5, 0.05, 0.5, 0.95]) == ([("enter", 0), ("leave", 2), ("enter", 4)], Stay(4.0))


def test_a_dwell_is_told_once_a_stay_and_only_inside() -> None:
    assert shown([1.0] * 25) == ([("enter", 0), ("dwell", 10)], Stay(0.0, dwelled=True))
    assert shown([1.0] * 5, Stay(-20.0)) == ([("dwell", 0)], Stay(-20.0, dwelled=True))
    assert shown([0.0], Stay(-20.0)) == ([("leave", 0)], None)
    assert shown([1.0] * 25, dwell_s=None) == ([("enter", 0)], Stay(0.0))
    again = [1.0] * 12 + [0.0] + [1.0] * 12
    assert shown(again)[0] == [("enter", 0), ("dwell", 10), ("leave", 12), ("enter", 13), ("dwell", 23)]


def test_a_walk_through_a_room(world: World) -> None:
    level = world.mapped_level()
    geofence = room(world, level)
    walker = Walker(world, level)
    walker.at(OUT, BORDER, IN)
    walker.at(IN, IN)
    walker.at(IN, BORDER)
    walker.at(IN, OUT)
    enter, dwell, leave = told(world)
    assert [event.kind for event in (enter, dwell, leave)] == [ENTER, DWELL, LEAVE]
    assert [(event.seq, event.t - T0) for event in (enter, dwell, leave)] == [(0, 2.0), (3, 15.0), (3, 16.0)]
    assert (enter.x, enter.y, enter.dwell_s, enter.reason) == (*IN, None, None)
    assert (dwell.dwell_s, leave.dwell_s) == (13.0, 14.0)
    assert enter.probability == pytest.approx(1.0)
    assert leave.probability == pytest.approx(0.0)
    assert {event.geofence_id for event in (enter, dwell, leave)} == {geofence.id}
    assert (enter.session_id, enter.level_id, enter.venue_id) == (walker.session.id, level.id, level.venue_id)


@pytest.mark.parametrize("status", [status for status in Status if status is not Status.OK])
def test_only_claimed_positions_count(world: World, status: Status) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN, status=status)
    assert kinds(world) == []
    walker.at(IN)
    walker.at(OUT, status=status)
    assert kinds(world) == ["enter"]


def test_a_poor_position_neither_enters_nor_leaves(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    vague = replace(fix(level_id=level.id, x=IN[0], y=IN[1]), cov_xx=40.0, cov_yy=40.0, cov_xy=0.0)
    walker.complete(walker.queue(), [vague])
    assert kinds(world) == []
    walker.at(IN)
    near = replace(vague, x=24.0, t=T0 + 9.0)
    walker.complete(walker.queue(), [near])
    assert kinds(world) == ["enter"]


def test_another_level_is_outside(world: World) -> None:
    level = world.mapped_level()
    other = world.services.venues.create_level(level.venue_id, "2", 1, level.extent)
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    walker.at(IN, level_id=other.id)
    _, leave = told(world)
    assert (leave.kind, leave.reason, leave.level_id, leave.x) == (LEAVE, "another level", level.id, None)
    assert leave.dwell_s == 5.0
    walker.at(IN)
    assert kinds(world) == ["enter", "leave", "enter"]


def test_only_wanted_events_are_told(world: World) -> None:
    level = world.mapped_level()
    room(world, level, events=frozenset({LEAVE}), dwell_s=None)
    walker = Walker(world, level)
    walker.at(IN, OUT, IN)
    walker.close()
    assert [(event.kind, event.reason) for event in told(world)] == [(LEAVE, None), (LEAVE, "session closed")]


def test_the_end_of_a_session_leaves(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN, IN)
    walker.close()
    walker.close()
    _, leave = told(world)
    assert (leave.kind, leave.reason, leave.t - T0, leave.dwell_s, leave.seq) == (LEAVE, "session closed", 1.0, 1.0, 0)
    assert (leave.x, leave.probability) == (IN[0], None)


def test_a_session_closed_with_a_segment_waiting_leaves_after_it(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(OUT)
    job = walker.queue()
    walker.close()
    assert kinds(world) == []
    walker.complete(job, [fix(T0 + 5, level_id=level.id, x=IN[0], y=IN[1])])
    assert [(event.kind, event.reason) for event in told(world)] == [(ENTER, None), (LEAVE, "session closed")]


def test_a_session_whose_last_segment_fails_leaves(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    job = walker.queue()
    walker.close()
    world.services.processing.fail(job, "no")
    assert kinds(world) == ["enter", "leave"]


def test_of_two_answers_to_a_segment_one_counts(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    job = walker.queue()
    inside = [fix(level_id=level.id, x=IN[0], y=IN[1])]
    assert walker.complete(job, inside) is not None
    assert walker.complete(job, inside) is None
    assert kinds(world) == ["enter"]


def test_what_is_rolled_back_is_not_told(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the process had been killed before the commit: the segment is done over again, and told once."""
    level = world.mapped_level()
    room(world, level)
    hook = world.services.webhooks.create("https://a.example/", [WebhookEvent.GEOFENCE_ENTER])
    walker = Walker(world, level)
    job = walker.queue()
    inside = [fix(level_id=level.id, x=IN[0], y=IN[1])]

    class KilledError(Exception):
        pass

    def killed(*_: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr("app.storage.repositories.webhooks.SqlWebhookRepository.add_deliveries", killed)
        with pytest.raises(KilledError):
            walker.complete(job, inside)
    assert kinds(world) == []
    assert world.services.processing.recover() == 1
    walker.seq = 0
    (again,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    walker.complete(again, inside)
    assert kinds(world) == ["enter"]
    assert len(world.services.webhooks.deliveries(hook.id).items) == 1


def test_sessions_and_geofences_are_each_for_themselves(world: World) -> None:
    level = world.mapped_level()
    first = room(world, level)
    second = room(world, level, name="half", polygon=[[15.0, 10.0], [20.0, 10.0], [20.0, 20.0], [15.0, 20.0]])
    one, two = Walker(world, level), Walker(world, level)
    one.at((12.0, 15.0), (18.0, 15.0))
    two.at((18.0, 15.0))
    two.at((12.0, 15.0))
    assert [(event.geofence_name, event.kind) for event in told(world, session_id=one.session.id)] == [
        ("room", ENTER),
        ("half", ENTER),
    ]
    assert [(event.geofence_name, event.kind) for event in told(world, session_id=two.session.id)] == [
        ("room", ENTER),
        ("half", ENTER),
        ("half", LEAVE),
    ]
    assert len(told(world, geofence_id=first.id)) == 2
    assert len(told(world, geofence_id=second.id, kind=ENTER)) == 2
    assert told(world, level_id="lvl_0") == []


@pytest.mark.parametrize("places", [(OUT, OUT), (IN, IN)], ids=["far away", "inside already"])
def test_nothing_new_costs_one_search(world: World, places: tuple[tuple[float, float], ...]) -> None:
    """However many geofences the level has: a segment without a crossing sends one statement for all of them."""
    level = world.mapped_level()
    walker = Walker(world, level)
    room(world, level, dwell_s=3600.0)
    for i in range(20):
        room(world, level, name=str(i), dwell_s=3600.0)
    walker.at(*places)
    walker.at(*places)
    with _statements(world) as sent:
        walker.at(*places)
    about = [statement for statement in sent if "geofence" in statement]
    assert len(about) == 1
    assert about[0].startswith("SELECT")


def test_events_are_found_by_time(world: World) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN, OUT)
    enter, leave = told(world)
    between = datetime.fromtimestamp(T0, UTC) + timedelta(seconds=0.5)
    assert told(world, after=between) == [leave]
    assert told(world, before=between) == [enter]


def test_a_moved_geofence_waits_for_the_next_fix(world: World) -> None:
    level = world.mapped_level()
    geofence = room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    away = [[x + 20.0, y] for x, y in ROOM]
    changed = world.services.geofences.update(geofence.id, GeofenceSpec("away", away, DEFAULT_EVENTS))
    assert (changed.id, changed.created_at, changed.name) == (geofence.id, geofence.created_at, "away")
    assert world.services.geofences.get(geofence.id) == changed
    assert kinds(world) == ["enter"]
    walker.at(IN)
    assert kinds(world) == ["enter", "leave"]


def test_a_deleted_geofence_is_left_and_its_events_stay(world: World) -> None:
    level = world.mapped_level()
    geofence = room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    world.services.geofences.delete(geofence.id)
    assert [(event.kind, event.reason) for event in told(world)] == [(ENTER, None), (LEAVE, "geofence deleted")]
    walker.at(IN, OUT)
    walker.close()
    assert kinds(world) == ["enter", "leave"]
    with pytest.raises(NotFoundError):
        world.services.geofences.delete(geofence.id)


def test_a_restart_remembers_who_is_inside(world: World, tmp_path: object) -> None:
    level = world.mapped_level()
    room(world, level)
    walker = Walker(world, level)
    walker.at(IN)
    again = World.at(tmp_path)  # type: ignore[arg-type]
    later = Walker(again, level, walker.session)
    later.seq = walker.seq
    later.at(IN)
    later.at(OUT)
    assert kinds(again) == ["enter", "leave"]
    again.close()


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"polygon": [[0.0, 3.0], [4.0, 3.0]]}, "polygon"),
        ({"polygon": [[0.0, 3.0], [4.0, 7.0], [4.0, 3.0], [0.0, 7.0]]}, "polygon"),
        ({"polygon": [[0.0, 3.0], [4.0, 3.0], [4.0, 90.0]]}, "polygon"),
        ({"confidence": 0.5}, "confidence"),
        ({"confidence": 1.0}, "confidence"),
        ({"events": frozenset()}, "events"),
        ({"dwell_s": None}, "dwell_s"),
        ({"dwell_s": 0.0}, "dwell_s"),
        ({"events": frozenset({ENTER})}, "dwell_s"),
    ],
)
def test_what_cannot_be_a_geofence_is_refused(world: World, changes: dict[str, object], field: str) -> None:
    level = world.level()
    with pytest.raises(InvalidError) as caught:
        room(world, level, **changes)
    assert caught.value.field == field
    assert caught.value.remedy
    assert world.services.geofences.list(level.id).items == ()


def test_geofences_need_a_level_and_are_listed_by_it(world: World) -> None:
    with pytest.raises(NotFoundError):
        world.services.geofences.create("lvl_0", GeofenceSpec("room", ROOM))
    level, other = world.level(), world.level()
    made = [room(world, level, name=str(i)) for i in range(3)]
    room(world, other)
    page = world.services.geofences.list(level.id, limit=2)
    rest = world.services.geofences.list(level.id, page.next_cursor)
    assert [*page.items, *rest.items] == made[::-1]
    assert len(world.services.geofences.list().items) == 4
    with pytest.raises(NotFoundError):
        world.services.geofences.list("lvl_0")


def test_a_level_has_so_many_geofences(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_PER_LEVEL >= 1000
    monkeypatch.setattr("app.services.geofences.MAX_PER_LEVEL", 1)
    level = world.level()
    room(world, level)
    with pytest.raises(ConflictError, match="delete one"):
        room(world, level)
    room(world, world.level())


def test_a_venue_without_levels_can_still_be_deleted(world: World) -> None:
    venue = world.services.venues.create("Empty", VenueKind.INDOOR)
    world.services.webhooks.create("https://a.example/", [WebhookEvent.SESSION_CLOSED], venue_id=venue.id)
    world.services.venues.delete(venue.id)
