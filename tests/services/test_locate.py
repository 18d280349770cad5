from __future__ import annotations

import numpy as np
import pytest

from app.engine.types import Prior, Progress
from app.services.aids import Aids
from app.services.errors import InvalidError, NoMapError, NotFoundError
from app.services.locate import LocateService
from app.services.ports import WorkerLostError
from app.services.records import LevelMap
from app.services.tasks import LocateResult, LocateSpec
from tests.support.builders import (
    CallingExecutor,
    World,
    check_known_method,
    locate_result,
    samples,
    scans,
)


class Worker:
    """A task that remembers its specs and loses its worker a number of times."""

    def __init__(self, losses: int = 0) -> None:
        self.losses = losses
        self.specs: list[LocateSpec] = []

    def __call__(self, spec: LocateSpec, progress: Progress) -> LocateResult:
        self.specs.append(spec)
        if len(self.specs) <= self.losses:
            raise WorkerLostError
        return locate_result(n_lagged=2, level_id=spec.prior.level_id or spec.maps[-1].level_id)


def _service(world: World, worker: Worker) -> LocateService:
    return LocateService(
        uow=world.database,
        clock=world.clock,
        executor=CallingExecutor(),
        cache=world.cache,
        task=worker,
        check=check_known_method,
    )


def test_a_segment_is_located_and_nothing_is_stored(world: World) -> None:
    level, worker = world.mapped_level(), Worker()
    before = world.services.stats.stats()
    located = _service(world, worker).locate(
        level.id, "particle", {"n_particles": 7}, Prior("?", 1.0, 2.0), samples(), aids=Aids(wifi=scans())
    )
    expected = locate_result(n_lagged=2, level_id=level.id)
    assert (located.fixes, located.lagged) == (expected.fixes, expected.lagged)
    assert located.maps == (LevelMap(level.id, level.current_map_id),)
    (spec,) = worker.specs
    assert (spec.method, spec.parameters, spec.state) == ("particle", {"n_particles": 7}, None)
    assert spec.prior == Prior(level.id, 1.0, 2.0)
    assert spec.segment.wifi is not None
    assert spec.maps[0].hash == world.services.maps.current(level.id).hash
    np.testing.assert_array_equal(spec.segment.samples.mag, samples().mag)
    assert world.services.stats.stats() == before


def test_any_level_of_a_venue(world: World) -> None:
    venue_id, levels = world.venue(0, 1, unmapped=2)
    worker = Worker()
    located = _service(world, worker).locate(None, "particle", {}, None, samples(), venue_id=venue_id)
    (spec,) = worker.specs
    assert spec.prior == Prior(None)
    assert [ref.level_id for ref in spec.maps] == [level.id for level in levels]
    assert (located.level_id, [one.level_id for one in located.maps]) == (None, [level.id for level in levels])
    assert located.fixes[0].level_id == levels[1].id


def test_the_same_request_has_the_same_seed(world: World) -> None:
    level, worker = world.mapped_level(), Worker()
    service = _service(world, worker)
    for chunk in (samples(seed=1), samples(seed=1), samples(seed=2)):
        service.locate(level.id, "particle", {}, None, chunk)
    first, second, third = (spec.seed for spec in worker.specs)
    assert first == second != third


def test_a_lost_worker_is_tried_once_more(world: World) -> None:
    level, worker = world.mapped_level(), Worker(losses=1)
    assert _service(world, worker).locate(level.id, "particle", {}, None, samples()).fixes
    with pytest.raises(WorkerLostError):
        _service(world, Worker(losses=2)).locate(level.id, "particle", {}, None, samples())


def test_what_cannot_work_is_refused_before_a_worker_sees_it(world: World) -> None:
    worker = Worker()
    locate = _service(world, worker).locate
    level, other = world.mapped_level(), world.mapped_level()
    with pytest.raises(NotFoundError):
        locate("lvl_none", "particle", {}, None, samples())
    with pytest.raises(NoMapError):
        locate(world.level().id, "particle", {}, None, samples())
    with pytest.raises(InvalidError):
        locate(level.id, "magic", {}, None, samples())
    with pytest.raises(InvalidError):
        locate(level.id, "particle", {}, None, samples(), map_id=other.current_map_id)
    assert worker.specs == []


def test_an_older_version_can_be_named(world: World) -> None:
    level = world.mapped_level()
    world.build(level.id, seed=1)
    located = world.services.locate.locate(level.id, "dead_reckoning", {}, None, samples(), map_id=level.current_map_id)
    assert (located.maps[0].map_id, located.method) == (level.current_map_id, "dead_reckoning")
