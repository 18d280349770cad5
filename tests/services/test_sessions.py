"""Sessions: opening, the rules of ``seq``, what is stored, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.types import FixKind, Hypothesis, ImuSamples, Prior
from app.services import places
from app.services.aids import Aids
from app.services.errors import (
    ConflictError,
    InvalidError,
    NoMapError,
    NotFoundError,
    OverloadedError,
    SequenceConflictError,
    SequenceGapError,
    SessionClosedError,
)
from app.services.records import JobKind, JobState, LevelMap, SessionStatus
from tests.support.builders import World, locate_result, new_segment, scans


def test_a_session_pins_the_current_map_and_takes_the_prior(world: World) -> None:
    level = world.mapped_level()
    current = world.services.maps.current(level.id)
    prior = Prior("somewhere else", 1.0, 2.0, heading=0.5)
    session = world.services.sessions.create(level.id, "particle", {"n_particles": 99}, prior)
    assert session.maps == (LevelMap(level.id, current.id),)
    assert (session.level_id, session.venue_id, session.next_seq) == (level.id, level.venue_id, 0)
    assert session.prior == replace(prior, level_id=level.id)
    world.build(level.id, seed=1)
    assert world.services.sessions.get(session.id) == session
    assert world.services.sessions.create(level.id, "particle", {}).maps[0].map_id != current.id
    pinned = world.services.sessions.create(level.id, "particle", {}, map_id=current.id)
    assert pinned.maps == session.maps
    assert pinned.prior == Prior(level.id)


def test_a_session_in_a_venue_pins_the_maps_of_all_its_levels(world: World) -> None:
    venue_id, levels = world.venue(2, -1, 0, unmapped=1)
    world.venue(0)
    session = world.services.sessions.create(None, "particle", {}, Prior("?", heading=0.5), venue_id=venue_id)
    by_height = sorted(levels, key=lambda level: level.ordinal)
    assert session.maps == tuple(LevelMap(level.id, level.current_map_id or "") for level in by_height)
    assert (session.level_id, session.venue_id, session.prior) == (None, venue_id, Prior(None, heading=0.5))
    world.build(levels[0].id, seed=1)
    assert world.services.sessions.get(session.id) == session
    assert world.services.sessions.create(None, "particle", {}, venue_id=venue_id).maps != session.maps


def test_a_segment_in_a_venue_comes_with_all_maps_and_the_tracker_names_the_level(world: World) -> None:
    venue_id, levels = world.venue(0, 1)
    session = world.services.sessions.create(None, "particle", {}, venue_id=venue_id)
    world.services.sessions.accept(session.id, new_segment(0))
    (job,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
    spec = world.services.processing.locate_spec(job)
    assert spec.prior == Prior(None)
    assert [ref.level_id for ref in spec.maps] == [level.id for level in levels]
    assert [world.cache.open(ref).level_id for ref in spec.maps] == [level.id for level in levels]
    result = locate_result(level_id=levels[1].id)
    several = tuple(Hypothesis(level.id, 1.0, 2.0, 3.0, 0.5, 2.0, 0.5) for level in levels)
    result = replace(result, fixes=(*result.fixes[:-1], replace(result.fixes[-1], hypotheses=several)))
    world.services.processing.complete_locate(job, result)
    stored = world.services.sessions.positions(session.id).items
    assert tuple(position.fix for position in stored) == result.fixes


def test_a_place_is_a_level_or_a_venue(world: World) -> None:
    create = world.services.sessions.create
    level = world.mapped_level()
    venue_id, current = level.venue_id, level.current_map_id
    for field, refused in (
        ("level_id", lambda: create(None, "particle", {})),
        ("venue_id", lambda: create(level.id, "particle", {}, venue_id=venue_id)),
        ("map_id", lambda: create(None, "particle", {}, venue_id=venue_id, map_id=current)),
        ("prior.x", lambda: create(None, "particle", {}, Prior("?", 1.0, 2.0), venue_id=venue_id)),
    ):
        with pytest.raises(InvalidError) as caught:
            refused()
        assert caught.value.field == field
    with pytest.raises(NotFoundError):
        create(None, "particle", {}, venue_id="ven_none")
    with pytest.raises(NoMapError, match="no level of venue") as missing:
        create(None, "particle", {}, venue_id=world.level().venue_id)
    assert missing.value.field == "venue_id"
    assert world.services.sessions.list().items == ()


def test_a_venue_has_only_so_many_levels(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "MAX_LEVELS", 2)
    fits, _ = world.venue(0, 1)
    assert len(world.services.sessions.create(None, "particle", {}, venue_id=fits).maps) == 2
    too_many, _ = world.venue(0, 1, 2)
    with pytest.raises(InvalidError, match="more than 2 levels") as caught:
        world.services.sessions.create(None, "particle", {}, venue_id=too_many)
    assert caught.value.field == "venue_id"


def test_what_a_session_names_must_exist_and_fit(world: World) -> None:
    create = world.services.sessions.create
    level, other = world.mapped_level(), world.mapped_level()
    with pytest.raises(NotFoundError):
        create("lvl_none", "particle", {})
    with pytest.raises(NoMapError):
        create(world.level().id, "particle", {})
    with pytest.raises(NotFoundError):
        create(level.id, "particle", {}, device_id="dev_none")
    with pytest.raises(NotFoundError):
        create(level.id, "particle", {}, map_id="map_none")
    foreign = world.services.maps.current(other.id).id
    for field, refused in (
        ("map_id", lambda: create(level.id, "particle", {}, map_id=foreign)),
        ("method", lambda: create(level.id, "magic", {})),
        ("parameters.speed", lambda: create(level.id, "particle", {"speed": 1})),
    ):
        with pytest.raises(InvalidError) as caught:
            refused()
        assert caught.value.field == field
    assert world.services.sessions.list().items == ()


def test_sessions_are_listed_by_venue_level_device_and_status(world: World) -> None:
    sessions, level = world.services.sessions, world.mapped_level()
    device = world.services.devices.create("phone")
    one = sessions.create(level.id, "particle", {}, device_id=device.id)
    other = sessions.create(level.id, "particle", {})
    closed = sessions.close(one.id)
    venue_id, _ = world.venue(0)
    anywhere = sessions.create(None, "particle", {}, venue_id=venue_id)
    assert sessions.list(venue_id=venue_id).items == (anywhere,)
    assert sessions.list(venue_id=level.venue_id).items == (other, closed)
    assert sessions.list().items == (anywhere, other, closed)
    assert sessions.list(level_id=level.id, status=SessionStatus.OPEN).items == (other,)
    assert sessions.list(device_id=device.id).items == (closed,)
    assert sessions.list(level_id="lvl_none").items == ()


def test_a_segment_is_stored_with_its_job(world: World) -> None:
    session, new = world.session(), new_segment(aids=Aids(wifi=scans()))
    accepted = world.services.sessions.accept(session.id, new)
    assert not accepted.repeated
    assert accepted.job.kind is JobKind.LOCATE_SEGMENT
    assert accepted.job.order_key == session.id
    assert accepted.job.subject == {"session_id": session.id, "seq": 0}
    assert world.services.jobs.get(accepted.job.id) == accepted.job
    assert world.services.sessions.segment(session.id, 0) == accepted.segment
    assert world.listener.queued[-1] == accepted.job
    (job,) = world.services.processing.claim(1)
    segment = world.services.processing.locate_spec(job).segment
    np.testing.assert_array_equal(segment.samples.t, new.samples.t)
    np.testing.assert_array_equal(segment.samples.gyro, new.samples.gyro)
    assert segment.wifi is not None


def test_the_same_segment_again_gives_the_first_answer(world: World) -> None:
    session, sessions = world.session(), world.services.sessions
    first = sessions.accept(session.id, new_segment(0))
    sessions.accept(session.id, new_segment(1))
    heard = len(world.listener.queued)
    assert sessions.accept(session.id, new_segment(0)) == replace(first, repeated=True)
    (job,) = world.services.processing.claim(1)
    done = world.services.processing.complete_locate(job, locate_result(level_id=session.level_id))
    repeated = sessions.accept(session.id, new_segment(0))
    assert (repeated.repeated, repeated.job) == (True, done)
    assert repeated.segment.job_state is JobState.DONE
    assert len(world.listener.queued) == heard
    assert len(sessions.segments(session.id).items) == 2


def test_other_content_under_a_used_seq_is_a_conflict(world: World) -> None:
    session, sessions = world.session(), world.services.sessions
    sessions.accept(session.id, new_segment(0))
    with pytest.raises(SequenceConflictError) as caught:
        sessions.accept(session.id, new_segment(0, seed=99))
    assert caught.value.seq == 0
    assert len(sessions.segments(session.id).items) == 1


@pytest.mark.parametrize(("sent", "expected"), [(1, 0), (5, 0)])
def test_a_gap_says_which_segment_is_missing(world: World, sent: int, expected: int) -> None:
    session = world.session()
    with pytest.raises(SequenceGapError) as caught:
        world.services.sessions.accept(session.id, new_segment(sent))
    assert (caught.value.seq, caught.value.expected) == (sent, expected)
    assert world.services.jobs.list(kinds=(JobKind.LOCATE_SEGMENT,)).items == ()


def test_a_closed_session_takes_nothing_new_but_answers_repeats(world: World) -> None:
    session, sessions = world.session(), world.services.sessions
    sessions.accept(session.id, new_segment(0))
    closed = sessions.close(session.id)
    assert (closed.status, closed.next_seq) == (SessionStatus.CLOSED, 1)
    assert sessions.close(session.id) == closed
    with pytest.raises(SessionClosedError):
        sessions.accept(session.id, new_segment(1))
    assert sessions.accept(session.id, new_segment(0)).repeated
    assert [job.subject["seq"] for job in world.services.processing.claim(9)] == [0]


def test_time_goes_forward_between_segments(world: World) -> None:
    session, sessions = world.session(), world.services.sessions
    first = new_segment(0)
    sessions.accept(session.id, first)
    for shift in (0.0, -0.02, -100.0):
        t = first.samples.t - first.samples.t[0] + first.samples.t[-1] + shift
        moved = ImuSamples(t, first.samples.mag, first.samples.acc, first.samples.gyro)
        with pytest.raises(InvalidError) as caught:
            sessions.accept(session.id, replace(new_segment(1), samples=moved))
        assert caught.value.field == "samples.t_ms"
    hour_later = replace(first.samples, t=first.samples.t + 3600)
    assert sessions.accept(session.id, replace(new_segment(1), samples=hour_later)).segment.seq == 1


def test_an_empty_segment_is_refused(world: World) -> None:
    nothing = ImuSamples(np.empty(0), *(np.empty((0, 3)) for _ in range(3)))
    with pytest.raises(InvalidError) as caught:
        world.services.sessions.accept(world.session().id, replace(new_segment(0), samples=nothing))
    assert caught.value.field == "samples.t_ms"


def test_a_full_queue_refuses_and_recovers(tmp_path: Path) -> None:
    world = World.at(tmp_path, max_queued=2)
    session, sessions = world.session(), world.services.sessions
    for seq in range(2):
        sessions.accept(session.id, new_segment(seq))
    with pytest.raises(OverloadedError) as caught:
        sessions.accept(session.id, new_segment(2))
    assert caught.value.retry_after_s > 0
    assert sessions.accept(session.id, new_segment(1)).repeated
    (job,) = world.services.processing.claim(9)
    with pytest.raises(OverloadedError):
        sessions.accept(session.id, new_segment(2))
    world.services.processing.complete_locate(job, locate_result(level_id=session.level_id))
    assert sessions.accept(session.id, new_segment(2)).segment.seq == 2
    world.close()


def test_segments_and_positions_page_in_order(world: World) -> None:
    session, sessions = world.session(), world.services.sessions
    for seq in range(3):
        sessions.accept(session.id, new_segment(seq))
        (job,) = world.services.processing.claim(1)
        world.services.processing.complete_locate(job, locate_result(seq, level_id=session.level_id))
    page = sessions.segments(session.id, limit=2)
    assert ([info.seq for info in page.items], page.next_cursor) == ([0, 1], "1")
    assert [info.seq for info in sessions.segments(session.id, page.next_cursor).items] == [2]
    first = sessions.positions(session.id, limit=7)
    rest = sessions.positions(session.id, cursor=first.next_cursor)
    assert [position.number for position in (*first.items, *rest.items)] == list(range(9))
    assert [position.fix for position in sessions.positions(session.id, seq=1).items] == list(
        locate_result(1, level_id=session.level_id).fixes
    )
    with pytest.raises(InvalidError) as caught:
        sessions.positions(session.id, kind=FixKind.SMOOTHED)
    assert caught.value.field == "kind"
    for cursor in ("x", "-1", "1.5", "²", "9" * 30, ""):
        with pytest.raises(InvalidError):
            sessions.positions(session.id, cursor=cursor)
        with pytest.raises(InvalidError):
            sessions.segments(session.id, cursor)


def test_unknown_sessions_and_segments_are_named(world: World) -> None:
    sessions, session = world.services.sessions, world.session()
    for read in (sessions.get, sessions.close, sessions.segments, sessions.positions):
        with pytest.raises(NotFoundError) as caught:
            read("ses_none")
        assert caught.value.kind == "session"
    with pytest.raises(NotFoundError):
        sessions.accept("ses_none", new_segment(0))
    for missing in (
        lambda: sessions.segment(session.id, 0),
        lambda: sessions.positions(session.id, seq=0),
        lambda: sessions.result(session.id, 0),
    ):
        with pytest.raises(NotFoundError) as caught:
            missing()
        assert caught.value.kind == "segment"


def test_errors_of_sequence_are_conflicts() -> None:
    for error in (SequenceConflictError, SequenceGapError, SessionClosedError):
        assert issubclass(error, ConflictError)
