from __future__ import annotations

import numpy as np
import pytest

from app.engine.types import FeatureSet, MapBuildSettings
from app.services.errors import ConflictError, InvalidError, NoMapError, NotFoundError
from app.services.records import JobKind, JobState, NewBuild
from app.services.tasks import BuildResult
from tests.support.builders import World, grid_map, map_build, new_walk, radio_map, scans, vector_plan


def test_a_build_is_queued_for_the_level_with_its_settings(world: World) -> None:
    level = world.surveyed_level()
    (survey,) = world.services.surveys.list(level.id).items
    build = NewBuild(level.id, MapBuildSettings(FeatureSet.TOTAL, 0.25), (survey.id,))
    job = world.services.maps.request_build(build)
    assert (job.kind, job.state, job.order_key) == (JobKind.BUILD_MAP, JobState.QUEUED, level.id)
    assert world.listener.queued == [job]
    (claimed,) = world.services.processing.claim(5)
    spec = world.services.processing.build_spec(claimed)
    assert (spec.level_id, spec.settings) == (level.id, build.settings)
    np.testing.assert_array_equal(spec.walks[0].walk.samples.mag, new_walk().samples.mag)


def test_a_build_without_walks_is_refused(world: World) -> None:
    level = world.level()
    with pytest.raises(ConflictError, match="no survey walks"):
        world.services.maps.request_build(NewBuild(level.id))
    empty = world.services.surveys.create(world.surveyed_level().id, "empty")
    with pytest.raises(ConflictError, match="no survey walks"):
        world.services.maps.request_build(NewBuild(empty.level_id, survey_ids=(empty.id,)))
    assert world.services.jobs.list().items == ()
    assert world.listener.queued == []


def test_a_build_names_surveys_of_its_level(world: World) -> None:
    level, other = world.surveyed_level(), world.surveyed_level()
    (foreign,) = world.services.surveys.list(other.id).items
    with pytest.raises(InvalidError) as caught:
        world.services.maps.request_build(NewBuild(level.id, survey_ids=(foreign.id,)))
    assert caught.value.field == "survey_ids.0"
    with pytest.raises(NotFoundError):
        world.services.maps.request_build(NewBuild(level.id, survey_ids=("srv_none",)))
    with pytest.raises(NotFoundError):
        world.services.maps.request_build(NewBuild("lvl_none"))


def test_a_finished_build_becomes_the_current_version(world: World) -> None:
    level = world.surveyed_level()
    with pytest.raises(NoMapError):
        world.services.maps.current(level.id)
    job = world.build(level.id)
    assert (job.state, job.progress) == (JobState.DONE, 1.0)
    info = world.services.maps.current(level.id)
    assert job.result == {"map_id": info.id, "version": 1, "cpu_s": 0.5}
    assert (info.version, info.parent_id, info.n_walks, info.n_samples) == (1, None, 1, 12_345)
    assert (info.rows, info.columns, info.build_s) == (70, 130, 0.6)
    assert info.mapped_share == pytest.approx(69 / 70)
    assert info.mapped_area_m2 == pytest.approx(69 * 130 * 0.25)
    np.testing.assert_array_equal(world.services.maps.grid(info.id).mean, grid_map(level.id).mean)

    world.build(level.id, seed=1)
    newer = world.services.maps.current(level.id)
    assert (newer.version, newer.parent_id) == (2, info.id)
    assert newer.hash != info.hash
    assert world.services.maps.get(info.id) == info
    assert world.services.maps.list(level.id).items == (newer, info)


def test_the_floor_plan_goes_into_the_build(world: World) -> None:
    level = world.surveyed_level()
    for drawn in (False, True):
        if drawn:
            world.services.venues.set_vector_plan(level.id, vector_plan())
        world.services.maps.request_build(NewBuild(level.id))
        (job,) = world.services.processing.claim(1)
        plan = world.services.processing.build_spec(job).plan
        assert (plan is not None) == drawn
        world.services.processing.complete_build(job, BuildResult(map_build(level.id, plan=drawn), 0.1), 0.1)
        info = world.services.maps.current(level.id)
        assert info.has_obstacle == drawn
        obstacle = world.services.maps.grid(info.id).obstacle
        assert (obstacle is not None) == drawn
    assert plan is not None
    assert (len(plan.outline), len(plan.units)) == (1, 1)


def test_the_cache_is_filled_again_from_the_database(world: World) -> None:
    level = world.mapped_level()
    info = world.services.maps.current(level.id)
    ref = world.cache.ref(info, lambda: pytest.fail("the build has filled the cache"))
    ref.path.unlink()
    np.testing.assert_array_equal(world.services.maps.grid(info.id).support, grid_map(level.id).support)
    assert ref.path.exists()


def test_a_radio_layer_is_reported_and_read_back(world: World) -> None:
    level = world.surveyed_level()
    world.build(level.id)
    bare = world.services.maps.current(level.id)
    assert (bare.n_transmitters, bare.radio_cell_m) == (None, None)
    world.build(level.id, radio=radio_map())
    info = world.services.maps.current(level.id)
    assert (info.n_transmitters, info.radio_cell_m) == (5, 2.0)
    assert info.hash != bare.hash
    world.cache.ref(info, lambda: pytest.fail("the build has filled the cache")).path.unlink()
    radio = world.services.maps.grid(info.id).radio
    assert radio is not None
    assert radio.addresses == radio_map().addresses
    np.testing.assert_array_equal(radio.seen, radio_map().seen)


def test_radio_readings_of_the_survey_reach_the_build(world: World) -> None:
    level = world.surveyed_level()
    survey = world.services.surveys.create(level.id, "with readings")
    world.services.surveys.add_walk(survey.id, new_walk(seed=1, wifi=scans()))
    world.services.maps.request_build(NewBuild(level.id))
    (job,) = world.services.processing.claim(1)
    bare, heard = (new.walk for new in world.services.processing.build_spec(job).walks)
    assert bare.wifi is None
    assert heard.wifi is not None
    assert heard.wifi.address == scans().address


def test_a_build_cancelled_meanwhile_leaves_no_map(world: World) -> None:
    level = world.surveyed_level()
    world.services.maps.request_build(NewBuild(level.id))
    (job,) = world.services.processing.claim(1)
    world.services.jobs.cancel(job.id)
    late = world.services.processing.complete_build(job, BuildResult(map_build(level.id), 0.1), 0.1)
    assert late.state is JobState.CANCELLED
    assert world.services.maps.list(level.id).items == ()
    assert world.services.stats.stats().maps == 0


def test_builds_of_one_level_run_one_after_the_other(world: World) -> None:
    level = world.surveyed_level()
    first, second = (world.services.maps.request_build(NewBuild(level.id)) for _ in range(2))
    assert [job.id for job in world.services.processing.claim(9)] == [first.id]
    world.services.processing.fail(world.services.jobs.get(first.id), "no")
    assert [job.id for job in world.services.processing.claim(9)] == [second.id]


def test_unknown_maps_are_named(world: World) -> None:
    for read in (world.services.maps.get, world.services.maps.grid):
        with pytest.raises(NotFoundError) as caught:
            read("map_none")
        assert caught.value.kind == "map"
