"""A device's memory: what sessions learned, each once, from its close to the start of the next."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from app.engine.calibration import (
    next_epoch,
    next_session,
    remember,
    remember_offsets,
    remember_strides,
    unknown_device,
)
from app.engine.types import DeviceCalibration, Prior
from app.services.errors import InvalidError, NotFoundError
from app.services.records import DeviceMemory, Job, JobKind, NewBuild, Session
from app.services.tasks import BuildResult
from tests.support.builders import World, calibration, locate_result, map_build, new_segment, new_walk

WALK_OFFSET = (0.5, -1.0, 2.0)
"""What every walk of a made map is found to have."""


class Phone:
    """A device that walks on one level."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.level_id = world.mapped_level().id
        self.id = world.services.devices.create("phone").id

    def open(self, epoch: str = "") -> Session:
        return self.world.services.sessions.create(
            self.level_id, "particle", {}, device_id=self.id, calibration_epoch=epoch
        )

    def send(self, session: Session, n: int = 1) -> list[Job]:
        """Segments of the session, claimed, not done."""
        jobs = []
        for _ in range(n):
            seq = self.world.services.sessions.get(session.id).next_seq
            self.world.services.sessions.accept(session.id, new_segment(seq, n=20))
            jobs += self.world.services.processing.claim(9)
        return jobs

    def learn(self, job: Job, learned: DeviceCalibration | None) -> Job | None:
        result = locate_result(int(job.subject["seq"]), level_id=self.level_id, learned=learned)
        return self.world.services.processing.complete_locate(job, result)

    def trip(self, learned: DeviceCalibration | None, epoch: str = "") -> Session:
        """A session of one segment, from first to last."""
        session = self.open(epoch)
        (job,) = self.send(session)
        self.learn(job, learned)
        return self.world.services.sessions.close(session.id)

    def survey(self, *seeds: int, own: bool = True, epoch: str = "") -> list[str]:
        """Walks of a survey of its level, by the phone or by nobody; their ids."""
        survey = self.world.services.surveys.create(self.level_id, "survey")
        carried = {"device_id": self.id if own else None, "calibration_epoch": epoch}
        walks = (replace(new_walk(seed=seed), **carried) for seed in seeds)
        return [self.world.services.surveys.add_walk(survey.id, walk)[0].id for walk in walks]

    def memories(self) -> tuple[DeviceMemory, ...]:
        return tuple(self.world.services.devices.memories(self.id))


@pytest.fixture
def phone(world: World) -> Phone:
    return Phone(world)


def test_a_closed_session_starts_the_next(phone: Phone) -> None:
    assert phone.open().prior.calibration is None
    phone.trip(calibration(6.0))
    (memory,) = phone.memories()
    assert (memory.epoch, memory.n_sessions) == ("", 1)
    assert memory.calibration == remember(unknown_device(), None, calibration(6.0))
    following = phone.open()
    assert following.prior.calibration == next_session(memory.calibration)
    assert phone.world.services.sessions.get(following.id) == following
    (job,) = phone.send(following)
    assert phone.world.services.processing.locate_spec(job).prior.calibration == following.prior.calibration


def test_sessions_add_up(phone: Phone) -> None:
    expected: DeviceCalibration | None = None
    for offset in (6.0, 4.0, 5.0):
        session = phone.trip(calibration(offset))
        assert session.prior.calibration == (expected and next_session(expected))
        start = unknown_device() if expected is None else next_session(expected)
        expected = remember(start, session.prior.calibration, calibration(offset))
    (memory,) = phone.memories()
    assert memory.calibration == expected
    assert memory.n_sessions == 3


def test_the_last_that_was_learned_counts(phone: Phone) -> None:
    session = phone.open()
    for learned in (calibration(1.0), calibration(8.0), None):
        (job,) = phone.send(session)
        phone.learn(job, learned)
    phone.world.services.sessions.close(session.id)
    (memory,) = phone.memories()
    assert memory.calibration == remember(unknown_device(), None, calibration(8.0))


@pytest.mark.parametrize("end", ["done", "failed", "cancelled"])
def test_a_session_closed_early_is_remembered_when_its_last_segment_ends(phone: Phone, end: str) -> None:
    services = phone.world.services
    session = phone.open()
    (first,) = phone.send(session)
    phone.learn(first, calibration(2.0))
    (last,) = phone.send(session)
    services.sessions.accept(session.id, new_segment(2, n=20))
    services.sessions.close(session.id)
    assert phone.memories() == ()
    phone.learn(last, calibration(3.0))
    assert phone.memories() == ()  # one more is queued
    (job,) = services.processing.claim(9)
    if end == "done":
        phone.learn(job, calibration(9.0))
    elif end == "failed":
        services.processing.fail(job, "no")
    else:
        services.jobs.cancel(job.id)
    (memory,) = phone.memories()
    expected = calibration(9.0 if end == "done" else 3.0)
    assert memory.calibration == remember(unknown_device(), None, expected)
    assert memory.n_sessions == 1


def test_nothing_counts_twice(phone: Phone) -> None:
    services = phone.world.services
    session = phone.open()
    (job,) = phone.send(session)
    services.sessions.close(session.id)
    assert phone.learn(job, calibration(7.0)) is not None
    (memory,) = phone.memories()
    # the same answer again, another answer of a worker thought lost, the session closed again
    assert phone.learn(job, calibration(7.0)) is None
    assert phone.learn(replace(job, attempts=job.attempts + 1), calibration(-7.0)) is None
    services.processing.fail(job, "late")
    services.sessions.close(session.id)
    assert phone.memories() == (memory,)


def test_a_crash_before_the_commit_neither_loses_nor_doubles(phone: Phone, tmp_path: Path) -> None:
    session = phone.open()
    (job,) = phone.send(session)
    phone.world.services.sessions.close(session.id)
    broken = replace(locate_result(level_id=phone.level_id, learned=calibration(7.0)), state=None)  # type: ignore[arg-type]
    with pytest.raises(AttributeError):
        phone.world.services.processing.complete_locate(job, broken)
    assert phone.memories() == ()
    after = World.at(tmp_path)
    assert after.services.processing.recover() == 1
    (again,) = after.services.processing.claim(9)
    result = locate_result(level_id=phone.level_id, learned=calibration(7.0))
    assert after.services.processing.complete_locate(again, result) is not None
    assert phone.world.services.processing.complete_locate(job, result) is None
    (memory,) = phone.memories()
    assert memory.n_sessions == 1
    after.close()


def test_sessions_that_learned_nothing_or_name_no_device_leave_no_trace(phone: Phone) -> None:
    phone.trip(None)
    services = phone.world.services
    anonymous = services.sessions.create(phone.level_id, "particle", {})
    (job,) = phone.send(anonymous)
    phone.learn(job, calibration())
    services.sessions.close(anonymous.id)
    services.sessions.close(phone.open().id)
    assert phone.memories() == ()


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_calibration_that_is_not_finite_teaches_nothing_and_costs_no_position(phone: Phone, broken: float) -> None:
    session = phone.open()
    (job,) = phone.send(session)
    done = phone.learn(job, replace(calibration(), stride_scale=broken))
    assert done is not None
    assert done.error is None
    phone.world.services.sessions.close(session.id)
    assert phone.memories() == ()


def test_epochs_share_the_stride_only(phone: Phone) -> None:
    phone.trip(calibration(6.0, stride=1.12), "a")
    (first,) = phone.memories()
    other = phone.open("b")
    assert other.calibration_epoch == "b"
    assert other.prior.calibration == next_epoch(first.calibration)
    assert other.prior.calibration is not None
    assert other.prior.calibration.offset_sd == (5.5, 5.5, 5.5)
    assert other.prior.calibration.stride_scale > 1.05
    phone.trip(calibration(-4.0), "b")
    newest, oldest = phone.memories()
    assert (newest.epoch, newest.n_sessions, oldest) == ("b", 1, first)
    expected = remember(next_epoch(first.calibration), next_epoch(first.calibration), calibration(-4.0))
    assert newest.calibration == expected
    assert phone.open("a").prior.calibration == next_session(first.calibration)
    # a third one takes the stride of the epoch used last
    assert phone.open("c").prior.calibration == next_epoch(newest.calibration)


def test_overlapping_sessions_both_count(phone: Phone) -> None:
    one, other = phone.open(), phone.open()
    jobs = {session.id: phone.send(session)[0] for session in (one, other)}
    phone.learn(jobs[one.id], calibration(6.0))
    phone.learn(jobs[other.id], calibration(5.0))
    for session in (one, other):
        phone.world.services.sessions.close(session.id)
    first = remember(unknown_device(), None, calibration(6.0))
    (memory,) = phone.memories()
    assert memory.calibration == remember(next_session(first), None, calibration(5.0))
    assert memory.n_sessions == 2


def test_forgetting(phone: Phone) -> None:
    phone.trip(calibration(6.0), "a")
    phone.trip(calibration(6.0), "b")
    under_way = phone.open("a")
    phone.world.services.devices.forget(phone.id)
    assert phone.memories() == ()
    assert phone.open("a").prior.calibration is None
    # the session under way keeps what it began with, and brings back no more than it found out itself
    (job,) = phone.send(under_way)
    assert under_way.prior.calibration is not None
    phone.learn(job, under_way.prior.calibration)
    phone.world.services.sessions.close(under_way.id)
    (memory,) = phone.memories()
    assert memory.calibration.offset == (0.0, 0.0, 0.0)
    with pytest.raises(NotFoundError):
        phone.world.services.devices.forget("dev_none")


def test_devices_do_not_mix(phone: Phone) -> None:
    phone.trip(calibration(6.0))
    other = phone.world.services.devices.create("other")
    session = phone.world.services.sessions.create(phone.level_id, "particle", {}, device_id=other.id)
    assert session.prior.calibration is None


def test_an_epoch_without_a_device_is_a_mistake(phone: Phone) -> None:
    with pytest.raises(InvalidError) as caught:
        phone.world.services.sessions.create(phone.level_id, "particle", {}, calibration_epoch="a")
    assert caught.value.field == "calibration_epoch"
    with pytest.raises(NotFoundError):
        phone.world.services.sessions.create(phone.level_id, "particle", {}, device_id="dev_none")


def test_a_prior_given_keeps_its_place_and_takes_the_memory(phone: Phone) -> None:
    phone.trip(calibration(6.0))
    prior = Prior("?", 1.0, 2.0, heading=0.5)
    session = phone.world.services.sessions.create(phone.level_id, "particle", {}, prior, device_id=phone.id)
    (memory,) = phone.memories()
    assert session.prior == replace(prior, level_id=phone.level_id, calibration=next_session(memory.calibration))


def test_closing_and_finishing_at_once_count_once(phone: Phone) -> None:
    """Each round: two sessions of the device are closed while both their last answers arrive, twice."""
    n_rounds = 10
    services, errors = phone.world.services, []
    result = locate_result(level_id=phone.level_id, learned=calibration(6.0))

    def act(ready: threading.Barrier, action: Callable[[], object]) -> None:
        ready.wait()
        try:
            action()
        except Exception as error:  # noqa: BLE001 - shown below
            errors.append(error)

    for _ in range(n_rounds):
        sessions = [phone.open(), phone.open()]
        jobs = [job for session in sessions for job in phone.send(session)]
        actions: list[Callable[[], object]] = [partial(services.sessions.close, session.id) for session in sessions]
        actions += [partial(services.processing.complete_locate, job, result) for job in jobs * 2]
        ready = threading.Barrier(len(actions))
        threads = [threading.Thread(target=act, args=(ready, action)) for action in actions]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert errors == []
    (memory,) = phone.memories()
    assert memory.n_sessions == 2 * n_rounds


def test_a_survey_teaches_the_stride_of_the_device_it_names(phone: Phone) -> None:
    own, foreign = phone.survey(1, 2, 3), phone.survey(4, own=False)
    strides = dict(zip(own, (1.2, 1.25, 1.22), strict=True)) | dict.fromkeys(foreign, 0.7)
    phone.world.build(phone.level_id, strides=strides)
    (memory,) = phone.memories()
    assert (memory.epoch, memory.n_sessions) == ("", 0)
    taught = remember_strides(unknown_device(), list(strides.values())[:3])
    assert memory.calibration == remember_offsets(taught, [WALK_OFFSET] * 3)
    assert phone.open("any").prior.calibration == next_epoch(memory.calibration)


def test_a_walk_teaches_with_the_first_map_it_goes_into(phone: Phone) -> None:
    first = dict.fromkeys(phone.survey(1, 2), 1.2)
    phone.world.build(phone.level_id, strides=first)
    before = phone.memories()
    phone.world.build(phone.level_id, strides=first)
    assert phone.memories() == before
    phone.world.build(phone.level_id, strides=first | dict.fromkeys(phone.survey(3), 1.3))
    (memory,) = phone.memories()
    expected = remember_strides(next_session(before[0].calibration), [1.3])
    assert memory.calibration.stride_scale == expected.stride_scale
    assert memory.calibration.stride_scale_sd == expected.stride_scale_sd


def test_walks_teach_the_offset_of_their_own_epoch(phone: Phone) -> None:
    phone.trip(calibration(6.0), "old")
    phone.trip(calibration(-3.0), "new")
    latest, older = phone.memories()
    walks = phone.survey(1, 2, epoch="old") + phone.survey(3, epoch="third")
    phone.world.build(phone.level_id, strides=dict.fromkeys(walks))
    by_epoch = {memory.epoch: memory for memory in phone.memories()}
    assert by_epoch["new"] == latest
    iron = remember_offsets(next_session(older.calibration), [WALK_OFFSET] * 2)
    assert by_epoch["old"].calibration == replace(older.calibration, offset=iron.offset, offset_sd=iron.offset_sd)
    assert by_epoch["old"].n_sessions == older.n_sessions
    third = remember_offsets(next_epoch(latest.calibration), [WALK_OFFSET])
    assert by_epoch["third"].calibration.offset == third.offset
    assert by_epoch["third"].calibration.stride_scale_sd == pytest.approx(third.stride_scale_sd)
    assert by_epoch["third"].n_sessions == 0
    phone.world.build(phone.level_id, strides=dict.fromkeys(walks))
    assert {memory.epoch: memory for memory in phone.memories()} == by_epoch


@pytest.mark.parametrize("why", ["not aligned", "few walks"])
def test_offsets_that_were_not_compared_teach_nothing(phone: Phone, why: str) -> None:
    own = phone.survey(1, 2)
    walks: list[str] = [*own, *phone.survey(3, 4, own=False)]
    if why == "not aligned":
        phone.world.build(phone.level_id, strides=dict.fromkeys(walks), align=False)
    else:
        phone.world.build(phone.level_id, strides=dict.fromkeys(own))
    assert phone.memories() == ()
    phone.world.build(phone.level_id, strides=dict.fromkeys(walks))
    assert phone.memories()[0].calibration == remember_offsets(unknown_device(), [WALK_OFFSET] * 2)


def test_a_survey_leaves_the_hard_iron_of_other_epochs_as_it_was(phone: Phone) -> None:
    phone.trip(calibration(6.0), "old")
    phone.trip(calibration(-3.0), "new")
    latest, older = phone.memories()
    phone.world.build(phone.level_id, strides=dict.fromkeys(phone.survey(1), 1.3))
    taught, untouched = phone.memories()
    assert untouched == older
    assert (taught.epoch, taught.n_sessions) == ("new", latest.n_sessions)
    assert taught.calibration.offset == latest.calibration.offset
    assert taught.calibration.offset_sd == latest.calibration.offset_sd
    assert taught.calibration.stride_scale > latest.calibration.stride_scale


def test_walks_that_tell_no_stride_or_are_gone_teach_nothing(phone: Phone) -> None:
    (walk,) = phone.survey(1)
    survey_id = phone.world.services.surveys.list(phone.level_id).items[0].id
    phone.world.build(phone.level_id)
    phone.world.services.surveys.delete_walk(survey_id, walk)
    phone.world.build(phone.level_id, strides={walk: 1.3})
    assert phone.memories() == ()


def test_a_build_that_was_given_up_teaches_nothing(phone: Phone) -> None:
    strides = dict.fromkeys(phone.survey(1), 1.3)
    phone.world.services.maps.request_build(NewBuild(phone.level_id))
    (job,) = phone.world.services.processing.claim(1, JobKind.BUILD_MAP)
    phone.world.services.processing.fail(job, "lost")
    phone.world.services.processing.complete_build(job, BuildResult(map_build(phone.level_id, strides=strides), 0.5), 1)
    assert phone.memories() == ()
