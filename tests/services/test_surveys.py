from __future__ import annotations

from dataclasses import replace

import pytest

from app.services.errors import NotFoundError
from tests.support.builders import World, new_walk


def test_a_walk_is_measured_when_it_is_stored(world: World) -> None:
    surveys = world.services.surveys
    survey = surveys.create(world.level().id, "first")
    walk, repeated = surveys.add_walk(survey.id, new_walk("round"))
    assert not repeated
    assert (walk.name, walk.n_samples, walk.n_waypoints, walk.length_m) == ("round", 500, 3, 7.0)
    assert walk.duration_s == pytest.approx(9.98)
    assert surveys.get_walk(survey.id, walk.id) == walk
    assert surveys.get(survey.id).n_walks == 1


def test_the_same_walk_again_is_the_same_walk(world: World) -> None:
    surveys = world.services.surveys
    survey = surveys.create(world.level().id, "first")
    walk, _ = surveys.add_walk(survey.id, new_walk("round"))
    assert surveys.add_walk(survey.id, new_walk("other name")) == (walk, True)
    assert surveys.list_walks(survey.id).items == (walk,)
    elsewhere = surveys.create(survey.level_id, "second")
    assert surveys.add_walk(elsewhere.id, new_walk())[1] is False


def test_walks_are_listed_oldest_first_and_deleted(world: World) -> None:
    surveys = world.services.surveys
    survey = surveys.create(world.level().id, "first")
    walks = [surveys.add_walk(survey.id, new_walk(seed=seed))[0] for seed in range(3)]
    assert list(surveys.list_walks(survey.id).items) == walks
    surveys.delete_walk(survey.id, walks[1].id)
    assert list(surveys.list_walks(survey.id).items) == [walks[0], walks[2]]


def test_a_walk_belongs_to_its_survey(world: World) -> None:
    surveys = world.services.surveys
    survey = surveys.create(world.level().id, "first")
    other = surveys.create(survey.level_id, "second")
    walk, _ = surveys.add_walk(survey.id, new_walk())
    with pytest.raises(NotFoundError):
        surveys.get_walk(other.id, walk.id)
    with pytest.raises(NotFoundError):
        surveys.delete_walk(other.id, walk.id)
    assert surveys.get_walk(survey.id, walk.id) == walk


def test_what_a_walk_names_must_exist(world: World) -> None:
    surveys = world.services.surveys
    with pytest.raises(NotFoundError):
        surveys.create("lvl_none", "first")
    with pytest.raises(NotFoundError):
        surveys.add_walk("srv_none", new_walk())
    survey = surveys.create(world.level().id, "first")
    with pytest.raises(NotFoundError) as caught:
        surveys.add_walk(survey.id, replace(new_walk(), device_id="dev_none"))
    assert caught.value.kind == "device"
    assert surveys.get(survey.id).n_walks == 0
