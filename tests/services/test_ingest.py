"""Messages of phones on their way into sessions: in any order, cut off anywhere, refused in words."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.types import ImuSamples, Prior
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.phyphox import read_body
from app.exchange.phones.readings import Annotation
from app.services.errors import InvalidError, NotFoundError, OverloadedError
from app.services.ingest.errors import IngestRefusedError, UnknownTokenError
from app.services.ingest.order import HOLD, in_turn
from app.services.ingest.receiving import MAX_GAP_S, pieces
from app.services.ingest.records import Incoming, Marker, Purpose, RecordingState, Stored
from app.services.records import JobKind, SessionStatus
from tests.exchange.recordings import WALK
from tests.support.builders import START, World, samples
from tests.support.phones import Phone, phyphox_bodies, sensor_logger_messages
from tests.support.pushing import Pusher, key_of, new_token, same

BODIES = sensor_logger_messages(WALK.samples)


@pytest.fixture
def phone(world: World) -> Pusher:
    return Pusher.at(world)


# Tokens


def test_a_token_is_made_listed_and_revoked(world: World, phone: Pusher) -> None:
    tokens = world.services.ingest_tokens
    (listed,) = tokens.list().items
    assert (listed.id, listed.revoked_at, listed.last_used_at) == (phone.token_id, None, None)
    assert phone.secret not in repr(listed)
    phone.push(BODIES[0])
    used = tokens.get(phone.token_id).last_used_at
    assert used is not None
    phone.push(BODIES[1])
    assert tokens.get(phone.token_id).last_used_at == used  # to the minute: a write less a message
    first = tokens.revoke(phone.token_id).revoked_at
    assert tokens.revoke(phone.token_id).revoked_at == first
    with pytest.raises(UnknownTokenError, match="make a new one"):
        phone.push(BODIES[2])
    with pytest.raises(UnknownTokenError):
        world.services.recordings.token(phone.secret)
    with pytest.raises(UnknownTokenError):
        world.services.recordings.token(phone.secret + "x")
    assert phone.recording().n_messages == 2


@pytest.mark.parametrize(
    ("said", "field"),
    [
        ({"level_id": None}, "level_id"),
        ({"venue_id": "ven"}, "level_id"),
        ({"purpose": Purpose.SURVEY, "level_id": None, "venue_id": "ven"}, "level_id"),
        ({"purpose": Purpose.SURVEY, "prior": Prior("", x=1.0, y=4.0)}, "prior"),
        ({"purpose": Purpose.SURVEY, "survey_id": "other"}, "survey_id"),
        ({"purpose": Purpose.SURVEY, "route": ("A1",)}, "route.0"),
        ({"route": ("A1",)}, "route"),
        ({"survey_id": "other"}, "survey_id"),
        ({"level_id": None, "venue_id": "ven", "prior": Prior("", x=1.0, y=4.0)}, "prior.x"),
    ],
)
def test_a_token_that_means_nothing_is_refused(world: World, said: dict[str, object], field: str) -> None:
    level = world.level()
    other = world.services.surveys.create(world.level().id, "elsewhere")
    device = world.services.devices.create("phone", "")
    known = {"ven": level.venue_id, "other": other.id}
    given = {"level_id": level.id, **said}
    filled = {name: known.get(value, value) if isinstance(value, str) else value for name, value in given.items()}
    new = dataclasses.replace(new_token(device.id, level.id), **filled)  # type: ignore[arg-type]
    with pytest.raises(InvalidError) as caught:
        world.services.ingest_tokens.create(new, key_of(world))
    assert caught.value.field == field
    assert caught.value.remedy
    assert world.services.ingest_tokens.list().items == ()


def test_a_token_needs_a_device(world: World) -> None:
    with pytest.raises(NotFoundError):
        world.services.ingest_tokens.create(new_token("dev_none", world.level().id), key_of(world))


# Order


def stored(*numbers: int, age: timedelta = timedelta(0)) -> list[Stored]:
    return [Stored(number, b"", START - age) for number in numbers]


@pytest.mark.parametrize(
    ("waiting", "expected", "turn", "then"),
    [
        (stored(0), 0, [0], 1),
        (stored(1), 0, [], 0),
        (stored(1, 2), 0, [], 0),
        (stored(1, 2, 3), 0, [1, 2, 3], 4),
        (stored(1, age=HOLD), 0, [1], 2),
        (stored(2), 5, [2], 5),
        (stored(2, 5, 7), 5, [2, 5], 6),
        (stored(5, 7, 8, 9, 11), 5, [5, 7, 8, 9], 10),
        ([], 3, [], 3),
    ],
)
def test_whose_turn_it_is(waiting: list[Stored], expected: int, turn: list[int], then: int) -> None:
    found, following = in_turn(waiting, expected, START)
    assert ([one.number for one in found], following) == (turn, then)


def test_a_lost_message_is_waited_for_and_then_given_up(phone: Pusher) -> None:
    for body in BODIES[:3]:
        phone.push(body)
    before = phone.recording().n_samples
    for body in BODIES[4:6]:
        phone.push(body)
    assert phone.recording().n_samples == before
    for body in BODIES[6:]:
        phone.push(body)
    late = phone.push(BODIES[3])
    assert late.recording is not None
    assert (late.recording.n_late, late.repeated) == (1, False)
    closed = phone.close()
    t = phone.samples().t
    assert closed.n_samples == len(t)
    # what is lost is a gap, and nothing else is
    assert len(t) >= len(WALK.samples) - 160
    assert (np.diff(t) > 0).all()


def test_a_message_that_overtakes_waits_no_longer_than_it_must(world: World, phone: Pusher) -> None:
    phone.push_all(BODIES[:2])
    phone.push(BODIES[3])
    assert phone.recording().next_number == 2
    world.clock.now += HOLD
    phone.push(BODIES[4])
    assert phone.recording().next_number == 5


def test_repeated_messages_change_nothing(phone: Pusher) -> None:
    first = phone.push_all(BODIES)
    again = phone.push_all(BODIES)
    assert not any(one.repeated for one in first)
    assert all(one.repeated and not one.job_ids for one in again)
    phone.close()
    assert same(phone.samples(), WALK.samples)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pusher]:
    """One phone for many examples, each with a recording of its own."""
    world = World.at(tmp_path_factory.mktemp("world"), max_queued=10**9)
    yield Pusher.at(world)
    world.close()


SHORT = ImuSamples(*(getattr(WALK.samples, name)[:600] for name in ("t", "mag", "acc", "gyro")))


@settings(max_examples=25, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 10_000), max_size=12),
    swaps=st.lists(st.integers(0, 11)),
    repeats=st.lists(st.integers(0, 11)),
    asynchronous=st.booleans(),
)
def test_however_messages_come_the_samples_are_the_same(
    shared: Pusher, cuts: list[int], swaps: list[int], repeats: list[int], asynchronous: bool
) -> None:
    """Cut anywhere, neighbours interchanged, repeated at any time."""
    number = len(shared.world.services.recordings.list(token_id=shared.token_id, limit=500).items)
    found = []
    for form in ("whole", "cut"):
        session_id = f"{form} {number}"
        rows = Phone(asynchronous=asynchronous, seed=number).rows(SHORT)
        payload = [{"name": name, "time": t, "values": values} for t, name, values in rows]
        bounds = sorted({min(cut, len(payload)) for cut in cuts} | {0, len(payload)}) if form == "cut" else [0, None]
        bodies = [
            json.dumps({"messageId": i, "sessionId": session_id, "deviceId": "d", "payload": payload[a:b]}).encode()
            for i, (a, b) in enumerate(pairwise(bounds))
        ]
        order = list(range(len(bodies)))
        if form == "cut":
            for one in sorted(set(swaps), reverse=True):
                if one + 1 < len(order) and order[one] == one and order[one + 1] == one + 1:
                    order[one], order[one + 1] = order[one + 1], order[one]
            order = [one for at, one in enumerate(order) for one in ([one, one] if at in repeats else [one])]
            order += [one for one in repeats if one < len(bodies)]
        shared.push_all(bodies[one] for one in order)
        closed = shared.close()
        assert closed.app_session == f"d/{session_id}"
        assert closed.n_late == 0
        found.append(shared.samples(closed.session_id))
    assert same(*found)


# Sessions


def test_samples_of_a_pushed_walk_are_those_of_the_phone(world: World, phone: Pusher) -> None:
    results = phone.push_all(BODIES)
    assert sum(len(one.job_ids) for one in results) > 10
    queued = [job.id for job in world.listener.queued if job.kind is JobKind.LOCATE_SEGMENT]
    assert queued == [job for one in results for job in one.job_ids]
    closed = phone.close()
    assert (closed.state, closed.problem) == (RecordingState.CLOSED, "")
    assert same(phone.samples(), WALK.samples)
    assert world.services.sessions.get(closed.session_id or "").status is SessionStatus.CLOSED
    assert phone.close() == closed


def test_an_iphone_is_turned(world: World) -> None:
    level = world.mapped_level()
    bodies = sensor_logger_messages(WALK.samples, phone=Phone(ios=True))
    turned, upside_down = Pusher.at(world, level, frame=PhoneFrame.IOS), Pusher.at(world, level)
    for one in (turned, upside_down):
        one.push_all(bodies)
        one.close()
    assert same(turned.samples(), WALK.samples)
    assert upside_down.samples().acc == pytest.approx(-WALK.samples.acc, abs=1e-4)


@pytest.mark.parametrize("purpose", list(Purpose))
@pytest.mark.parametrize("frame", list(PhoneFrame))
def test_a_message_that_tells_its_frame_is_believed_to_the_end(
    world: World, purpose: Purpose, frame: PhoneFrame
) -> None:
    """Also by what is cut last, and by the walks of a survey, when no message is at hand."""
    phone = Pusher.at(world, purpose=purpose, frame=frame)
    for number, body in enumerate(phyphox_bodies(WALK.samples, ios=True)):
        found = read_body(body, received_ns=0)
        message = Incoming("run", number, found.readings, frame=found.frame, started_ns=found.started_ns)
        world.services.recordings.receive(phone.secret, message)
    recording = phone.close()
    if purpose is Purpose.SURVEY:
        recording = world.services.recordings.set_waypoints(recording.id, WALK.waypoints)
        with world.database() as uow:
            acc = uow.surveys.load_walk(recording.walk_ids[0]).samples.acc
    else:
        acc = phone.samples().acc
    assert acc == pytest.approx(WALK.samples.acc, abs=1e-4)


def test_messages_of_a_survey_are_never_late(world: World) -> None:
    phone = Pusher.at(world, purpose=Purpose.SURVEY)
    bodies = sensor_logger_messages(WALK.samples, WALK.waypoints)
    phone.push_all(bodies[5:] + bodies[:5])
    closed = phone.close()
    assert (closed.n_late, closed.state, closed.problem) == (0, RecordingState.CLOSED, "")
    assert closed.n_samples == len(WALK.samples)


def test_nothing_is_lost_when_the_service_is_killed_between_two_messages(tmp_path: Path) -> None:
    world = World.at(tmp_path)
    phone = Pusher.at(world)
    for body in BODIES:
        phone.push(body)
        world.close()
        world = World.at(tmp_path)
        phone.world = world
    phone.close()
    assert same(phone.samples(), WALK.samples)
    world.close()


def test_a_silent_recording_is_closed_and_one_that_goes_on_becomes_a_new_part(world: World, phone: Pusher) -> None:
    phone.push_all(BODIES[:8])
    silence = timedelta(minutes=1)
    assert world.services.recordings.close_silent(silence) == ()
    world.clock.now += silence * 2
    (closed,) = world.services.recordings.close_silent(silence)
    assert world.services.recordings.close_silent(silence) == ()
    first = world.services.recordings.get(closed)
    assert first.state is RecordingState.CLOSED
    phone.push_all(BODIES[8:])
    second, _ = phone.recordings()
    assert (second.part, second.state) == (1, RecordingState.OPEN)
    assert second.session_id != first.session_id
    late = phone.push(BODIES[3])
    assert late.repeated or late.recording is not None
    phone.close()
    t = np.concatenate([phone.samples(one.session_id).t for one in (first, second)])
    assert np.array_equal(np.unique(t), t)
    assert len(t) >= len(WALK.samples) - 2


def test_a_full_queue_loses_nothing(tmp_path: Path) -> None:
    world = World.at(tmp_path, max_queued=3)
    phone = Pusher.at(world)
    results = phone.push_all(BODIES)
    assert sum(len(one.job_ids) for one in results) == 3
    with pytest.raises(OverloadedError):
        phone.close()
    assert phone.recording().state is RecordingState.OPEN
    world.clock.now += timedelta(minutes=5)
    assert world.services.recordings.close_silent(timedelta(minutes=1)) == ()
    for job in world.services.processing.claim(10):
        world.services.processing.fail(job, "made room")
    phone.close()
    assert same(phone.samples(), WALK.samples)
    world.close()


def test_readings_full_of_gaps_do_not_keep_a_recording_open(tmp_path: Path) -> None:
    world = World.at(tmp_path, max_queued=5)
    phone = Pusher.at(world)
    message = json.loads(BODIES[0])
    first = message["payload"][0]["time"]
    sensors = ("magnetometer", "totalacceleration", "gyroscope")
    values = dict(zip(sensors, ((20, 5, -40), (0.1, 0.2, 9.8), (0.01, 0, 0.02)), strict=True))
    message["payload"] = [
        {
            "name": name,
            "time": first + gap * 2_000_000_000 + i * 20_000_000,
            "values": dict(zip("xyz", values[name], strict=True)),
        }
        for gap in range(8)
        for i in range(2 + gap)
        for name in sensors
    ]
    assert len(phone.push(json.dumps(message).encode()).job_ids) == 5
    while jobs := world.services.processing.claim(10):
        for job in jobs:
            world.services.processing.fail(job, "made room")
    closed = phone.close()
    assert closed.state is RecordingState.CLOSED
    assert closed.n_samples > sum(2 + gap for gap in range(3, 7))
    assert "gaps" in closed.problem
    world.close()


def test_a_clock_that_is_set_back_is_told_in_words(phone: Pusher) -> None:
    phone.push_all(BODIES[:4])
    assert phone.recording().problem == ""
    for body in BODIES[4:6]:
        message = json.loads(body)
        for reading in message["payload"]:
            reading["time"] -= 3600 * 1_000_000_000
        phone.push(json.dumps(message).encode())
    assert "set back" in phone.recording().problem
    assert "start again" in phone.recording().problem


def test_one_recording_that_must_wait_does_not_hold_up_the_others(tmp_path: Path) -> None:
    world = World.at(tmp_path, max_queued=1)
    waiting = Pusher.at(world)
    waiting.push_all(BODIES)
    survey = Pusher.at(world, waiting.level, purpose=Purpose.SURVEY)
    survey.push_all(BODIES[:2])
    world.clock.now += timedelta(minutes=5)
    closed = world.services.recordings.close_silent(timedelta(minutes=1))
    assert closed == (survey.recording().id,)
    assert waiting.recording().state is RecordingState.OPEN
    world.close()


def test_a_session_closed_by_hand_is_told_in_words(world: World, phone: Pusher) -> None:
    phone.push_all(BODIES[:5])
    world.services.sessions.close(phone.recording().session_id or "")
    with pytest.raises(IngestRefusedError, match="start again"):
        phone.push_all(BODIES[5:])
    closed = phone.close()
    assert closed.state is RecordingState.CLOSED
    phone.push(sensor_logger_messages(WALK.samples, phone=Phone(session_id="anew"))[0])
    assert phone.recordings()[0].session_id != closed.session_id


def test_a_level_without_a_map_is_told_in_words(world: World) -> None:
    phone = Pusher.at(world, world.level())
    with pytest.raises(IngestRefusedError, match="cannot locate here yet"):
        phone.push(BODIES[0])
    assert phone.recordings() == []


def test_readings_that_no_phone_can_have_are_told_in_words(phone: Pusher) -> None:
    nonsense = dataclasses.replace(WALK.samples, mag=WALK.samples.mag * 50)
    phone.push_all(sensor_logger_messages(nonsense))
    problem = phone.recording().problem
    assert "mag" in problem
    assert "nT" in problem or "uT" in problem


def test_an_empty_message_is_a_test_push(world: World, phone: Pusher) -> None:
    empty = json.dumps({"messageId": 0, "sessionId": "s", "deviceId": "d", "payload": []}).encode()
    assert phone.push(empty).recording is None
    assert phone.recordings() == []


def test_late_messages_of_a_closed_recording_are_not_kept(world: World, phone: Pusher) -> None:
    phone.push_all(BODIES[:3] + BODIES[4:])
    closed = phone.close()
    phone.push(BODIES[3])
    assert phone.recording().n_messages == closed.n_messages + 1
    with world.database() as uow:
        assert uow.ingest.messages(closed.id) == ()


@given(st.lists(st.floats(0.001, 40.0), min_size=1, max_size=300))
def test_pieces_have_no_gaps_and_end(steps: list[float]) -> None:
    t = 1.7e9 + np.cumsum(np.round(steps, 3))
    chunk = samples(len(t))
    cut = list(pieces(ImuSamples(t, chunk.mag, chunk.acc, chunk.gyro)))
    for rows in cut:
        part = t[rows]
        assert len(part) > 1
        assert np.diff(part).max() <= MAX_GAP_S
        assert part[-1] - part[0] <= 30.0
    taken = [row for rows in cut for row in range(rows.start, rows.stop)]
    assert taken == sorted(set(taken))
    alone = set(range(len(t))) - set(taken)
    for row in alone:  # a sample alone is no segment
        assert row in {0, len(t) - 1} or t[row] - t[row - 1] > MAX_GAP_S or row - 1 in taken


# Markers


def test_markers_are_set_and_read(world: World) -> None:
    level = world.level()
    recordings = world.services.recordings
    made = [Marker("B2", 10.0, 5.0), Marker("A1", 2.0, 3.0)]
    assert recordings.set_markers(level.id, made) == (made[1], made[0])
    assert recordings.set_markers(level.id, []) == ()
    with pytest.raises(NotFoundError):
        recordings.markers("lvl_none")


@pytest.mark.parametrize(
    ("markers", "field", "words"),
    [
        ([Marker("Door 1", 2.0, 3.0), Marker("door  1", 4.0, 3.0)], "markers.1.name", "comes twice"),
        ([Marker("A1", 2.0, 3.0), Marker(" a1 ", 2.0, 3.0)], "markers.1.name", "comes twice"),
        ([Marker("A1", 100.0, 3.0)], "markers.0.x", "outside the level"),
        ([Marker("A1", 2.0, -3.0)], "markers.0.y", "outside the level"),
    ],
)
def test_markers_that_cannot_be_are_refused(world: World, markers: list[Marker], field: str, words: str) -> None:
    level = world.level()
    with pytest.raises(InvalidError, match=words) as caught:
        world.services.recordings.set_markers(level.id, markers)
    assert caught.value.field == field


def test_annotations_of_a_located_walk_are_its_ground_truth(world: World) -> None:
    level = world.mapped_level()
    world.services.recordings.set_markers(level.id, [Marker("Start", 2.0, 3.0)])
    points = WALK.waypoints
    labels = ["start", *(["nowhere"] * (len(points) - 2)), f"{points.x[-1]:.2f} {points.y[-1]:.2f}"]
    phone = Pusher.at(world, level)
    phone.push_all(sensor_logger_messages(WALK.samples, points, labels=labels))
    closed = phone.close()
    assert [note.text for note in closed.annotations] == labels
    assert isinstance(closed.annotations[0], Annotation)
    told = world.services.ground_truth.list(closed.session_id or "").items
    assert [(round(one.mark.x, 2), round(one.mark.y, 2)) for one in told] == [
        (2.0, 3.0),
        (round(float(points.x[-1]), 2), round(float(points.y[-1]), 2)),
    ]
