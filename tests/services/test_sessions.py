"""Sessions: opening, the rules of ``seq``, what is stored, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.types import ImuSamples, Prior
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
from app.services.records import JobKind, JobState, SessionStatus
from tests.support.builders import World, locate_result, new_segment, scans


def test_a_session_pins_the_current_map_and_takes_the_prior(world: World) -> None:
    level = world.mapped_level()
    current = world.services.maps.current(level.id)
    prior = Prior("somewhere else", 1.0, 2.0, heading=0.5)
    session = world.services.sessions.create(level.id, "particle", {"n_particles": 99}, prior)
    assert (session.map_id, session.venue_id, session.next_seq) == (current.id, level.venue_id, 0)
    assert session.prior == replace(prior, level_id=level.id)
    world.build(level.id, seed=1)
    assert world.services.sessions.get(session.id) == session
    assert world.services.sessions.create(level.id, "particle", {}).map_id != current.id
    pinned = world.services.sessions.create(level.id, "particle", {}, map_id=current.id)
    assert pinned.map_id == current.id
    assert pinned.prior == Prior(level.id)


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


def test_sessions_are_listed_by_level_device_and_status(world: World) -> None:
    sessions, level = world.services.sessions, world.mapped_level()
    device = world.services.devices.create("phone")
    one = sessions.create(level.id, "particle", {}, device_id=device.id)
    other = sessions.create(level.id, "particle", {})
    closed = sessions.close(one.id)
    assert sessions.list().items == (other, closed)
    assert sessions.list(level_id=level.id, status=SessionStatus.OPEN).items == (other,)
    assert sessions.list(device_id=device.id).items == (closed,)
    assert sessions.list(level_id="lvl_none").items == ()


def test_a_segment_is_stored_with_its_job(world: World) -> None:
    session, new = world.session(), new_segment(wifi=scans())
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
    assert world.services.jobs.list(kind=JobKind.LOCATE_SEGMENT).items == ()


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
    for missing in (lambda: sessions.segment(session.id, 0), lambda: sessions.positions(session.id, seq=0)):
        with pytest.raises(NotFoundError) as caught:
            missing()
        assert caught.value.kind == "segment"


def test_errors_of_sequence_are_conflicts() -> None:
    for error in (SequenceConflictError, SequenceGapError, SessionClosedError):
        assert issubclass(error, ConflictError)
