"""Replays: which maps and segments go to the worker, and what is refused before."""

from __future__ import annotations

import pytest
from sqlalchemy import update

from app.engine.localization.registry import METHODS
from app.engine.types import FeatureSet, Progress
from app.services import stored_segments
from app.services.errors import InvalidError, NotFoundError, NotReplayableError
from app.services.ids import seed_of
from app.services.ports import WorkerLostError
from app.services.records import JobKind, LevelMap, Session
from app.services.replays import ReplayService
from app.services.tasks import ReplayResult, ReplaySpec
from app.storage.models import sessions
from tests.services.test_versions import draft
from tests.support.builders import CallingExecutor, World, answer_locate, answer_replay, new_segment


class Worker:
    """A task that remembers its specs and loses its worker a number of times."""

    def __init__(self, losses: int = 0) -> None:
        self.losses = losses
        self.specs: list[ReplaySpec] = []

    def __call__(self, spec: ReplaySpec, progress: Progress) -> ReplayResult:
        self.specs.append(spec)
        if len(self.specs) <= self.losses:
            raise WorkerLostError
        return answer_replay(spec, progress)


def service(world: World, worker: Worker) -> ReplayService:
    return ReplayService(
        uow=world.database, clock=world.clock, executor=CallingExecutor(), cache=world.cache, task=worker
    )


def located(world: World, session: Session, n: int = 2) -> Session:
    """The session with so many segments, located by the task that the replay uses too."""
    for seq in range(n):
        world.services.sessions.accept(session.id, new_segment(seq))
        (job,) = world.services.processing.claim(1, JobKind.LOCATE_SEGMENT)
        result = answer_locate(world.services.processing.locate_spec(job), lambda *_: None)
        assert world.services.processing.complete_locate(job, result) is not None
    return session


def test_all_segments_go_from_the_prior_through_the_named_map(world: World) -> None:
    session, worker = located(world, world.session()), Worker()
    other = draft(world, session.level_id or "")
    before = world.services.stats.stats()
    answer = service(world, worker).replay(session.id, other.id)
    (spec,) = worker.specs
    assert (spec.method, spec.parameters, spec.prior) == (session.method, session.parameters, session.prior)
    assert (spec.seed, len(spec.segments)) == (seed_of(session.id), 2)
    assert [ref.hash for ref in spec.maps] == [other.hash]
    assert (answer.maps, answer.maps_then) == ((LevelMap(other.level_id, other.id),), session.maps)
    assert [position.fix for position in world.services.sessions.positions(session.id).items] == list(answer.fixes)
    assert answer.comparison.n_compared == len(answer.fixes) == 6
    assert answer.comparison.distance is not None
    assert answer.comparison.distance.largest == 0.0
    assert world.services.stats.stats() == before


def test_without_a_named_map_it_is_the_current_one(world: World) -> None:
    session, worker = located(world, world.session()), Worker()
    world.build(session.level_id or "", seed=1)
    current = world.services.maps.current(session.level_id or "")
    assert service(world, worker).replay(session.id).maps == (LevelMap(current.level_id, current.id),)


def test_in_a_venue_levels_that_are_not_named_keep_the_map_of_then(world: World) -> None:
    venue_id, (ground, upper) = world.venue(0, 1)
    session = located(world, world.services.sessions.create(None, "particle", {}, venue_id=venue_id))
    world.build(ground.id, seed=7)
    other, replay = draft(world, upper.id), service(world, Worker()).replay
    kept = LevelMap(ground.id, ground.current_map_id or "")
    assert replay(session.id, map_ids=(other.id,)).maps == (kept, LevelMap(upper.id, other.id))
    assert kept not in replay(session.id).maps


def test_what_cannot_be_replayed_is_refused_before_a_worker_sees_it(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, worker = located(world, world.session()), Worker()
    replay = service(world, worker).replay
    with pytest.raises(NotFoundError):
        replay("ses_none")
    with pytest.raises(NotFoundError):
        replay(session.id, "map_none")
    _, (same_house, next_floor) = world.venue(0, 1)
    for map_id in (same_house.current_map_id, next_floor.current_map_id):
        with pytest.raises(InvalidError) as caught:
            replay(session.id, map_ids=(map_id or "",))
        assert caught.value.field == "map_ids.0"
    monkeypatch.setattr(stored_segments, "MAX_SEGMENTS", 1)
    with pytest.raises(NotReplayableError, match="2 segments") as refused:
        replay(session.id)
    assert refused.value.field == "session_id"
    assert worker.specs == []


def test_a_map_of_the_next_level_is_none_for_a_session_on_one(world: World) -> None:
    _, (ground, upper) = world.venue(0, 1)
    session = located(world, world.session(ground.id))
    with pytest.raises(InvalidError, match=f"level {ground.id}"):
        service(world, Worker()).replay(session.id, upper.current_map_id)


def test_a_map_that_the_method_cannot_use_is_refused(world: World) -> None:
    """Declination-aided matching needs vectors; the draft has none."""
    level = world.mapped_level()
    session = located(world, world.session(level.id))
    needing = next(name for name, method in METHODS.items() if method.features == (FeatureSet.VECTOR,))
    with world.database.engine.begin() as connection:
        connection.execute(update(sessions).where(sessions.c.id == session.id).values(method=needing))
    with pytest.raises(InvalidError, match="needs vector") as caught:
        service(world, Worker()).replay(session.id, draft(world, level.id).id)
    assert caught.value.field == "map_id"
    assert needing in caught.value.remedy


def test_a_session_without_segments_has_nothing_to_tell(world: World) -> None:
    worker = Worker()
    answer = service(world, worker).replay(world.session().id)
    assert (answer.fixes, answer.comparison.distance, worker.specs) == ((), None, [])


def test_a_lost_worker_is_tried_once_more(world: World) -> None:
    session = located(world, world.session())
    assert service(world, Worker(losses=1)).replay(session.id).fixes
    with pytest.raises(WorkerLostError):
        service(world, Worker(losses=2)).replay(session.id)
