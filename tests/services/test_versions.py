"""Publishing, rolling back, sources and differences of map versions."""

from __future__ import annotations

import pytest

from app.engine.mapping.diff import Component
from app.engine.types import FeatureSet, MapBuildSettings, SourceKind
from app.services.errors import InvalidError, NotFoundError
from app.services.publishing import BUILT
from app.services.records import JobKind, LevelMap, MapInfo, NewBuild, Scope, SettingChange
from app.services.tasks import BuildResult
from tests.support.builders import World, map_build, new_walk


def draft(world: World, level_id: str, *, seed: int = 1, **changes: object) -> MapInfo:
    """A version that is not published."""
    order = NewBuild(level_id, publish=False, **changes)  # type: ignore[arg-type]
    world.services.maps.request_build(order)
    (job,) = world.services.processing.claim(1, JobKind.BUILD_MAP)
    done = world.services.processing.complete_build(job, BuildResult(map_build(level_id, seed=seed), 0.1), 0.1)
    return world.services.maps.get(str(done.result["map_id"]))


def test_a_build_publishes_unless_it_is_a_draft(world: World) -> None:
    key, _ = world.services.accounts.create_key("surveyor", {Scope.SURVEY})
    level = world.surveyed_level()
    world.services.maps.request_build(NewBuild(level.id, key_id=key.id))
    (job,) = world.services.processing.claim(1)
    world.services.processing.complete_build(job, BuildResult(map_build(level.id), 0.1), 0.1)
    first = world.services.maps.current(level.id)
    second = draft(world, level.id)
    assert world.services.maps.current(level.id) == first
    assert (second.version, second.parent_id) == (2, first.id)
    (logged,) = world.services.versions.publications(level.id).items
    assert (logged.map_id, logged.from_map_id, logged.key_id, logged.note) == (first.id, None, key.id, BUILT)


def test_publishing_an_older_version_rolls_back_and_is_logged(world: World) -> None:
    level = world.mapped_level()
    first = world.services.maps.current(level.id)
    open_session = world.session(level.id)
    second = draft(world, level.id)
    versions = world.services.versions
    there = versions.publish(level.id, second.id, note="looks right")
    assert world.services.maps.current(level.id) == second
    assert world.session(level.id).maps == (LevelMap(level.id, second.id),)
    back = versions.publish(level.id, first.id)
    assert world.services.maps.current(level.id) == first
    assert (there.from_map_id, back.from_map_id, back.note) == (first.id, second.id, "")
    assert versions.publications(level.id).items[:2] == (back, there)
    assert world.services.sessions.get(open_session.id).maps == open_session.maps


def test_publishing_what_is_current_changes_nothing(world: World) -> None:
    level = world.mapped_level()
    (logged,) = world.services.versions.publications(level.id).items
    assert world.services.versions.publish(level.id, logged.map_id, note="again") == logged
    assert world.services.versions.publications(level.id).items == (logged,)


def test_a_publication_names_a_map_of_its_level(world: World) -> None:
    level, other = world.mapped_level(), world.mapped_level()
    with pytest.raises(InvalidError, match=level.id) as caught:
        world.services.versions.publish(level.id, other.current_map_id or "")
    assert caught.value.field == "map_id"
    for level_id, map_id in ((level.id, "map_none"), ("lvl_none", level.current_map_id)):
        with pytest.raises(NotFoundError):
            world.services.versions.publish(level_id, map_id or "")
    with pytest.raises(NotFoundError):
        world.services.versions.publications("lvl_none")


def test_the_log_comes_in_pages(world: World) -> None:
    level = world.mapped_level()
    ids = [level.current_map_id, draft(world, level.id).id]
    for turn in range(4):
        world.services.versions.publish(level.id, ids[(turn + 1) % 2] or "")
    first = world.services.versions.publications(level.id, limit=3)
    rest = world.services.versions.publications(level.id, first.next_cursor, limit=3)
    assert (len(first.items), len(rest.items), rest.next_cursor) == (3, 2, None)
    log = [*first.items, *rest.items]
    assert [one.from_map_id for one in log[:-1]] == [one.map_id for one in log[1:]]


def test_sources_are_those_of_the_evidence_and_then_what_was_left_out(world: World) -> None:
    level = world.surveyed_level()
    (survey,) = world.services.surveys.list(level.id).items
    walks = [world.services.surveys.add_walk(survey.id, new_walk(seed=seed))[0].id for seed in (1, 2)]
    job = world.services.maps.request_build(NewBuild(level.id))
    world.services.processing.claim(1)
    build = map_build(level.id, walk_ids=[walks[0], "wlk_deleted", walks[1]])
    world.services.processing.complete_build(world.services.jobs.get(job.id), BuildResult(build, 0.1), 0.1)
    map_id = world.services.maps.current(level.id).id
    used, deleted, left_out = world.services.versions.sources(map_id).items
    assert (used.id, used.kind, used.survey_id) == (walks[0], SourceKind.SURVEY, survey.id)
    assert (used.n_samples, used.n_used, used.rejected) == (3, 3, None)
    assert (deleted.id, deleted.survey_id, deleted.n_samples) == ("wlk_deleted", None, 3)
    assert (left_out.id, left_out.rejected) == (walks[1], "moved")
    pages = [world.services.versions.sources(map_id, cursor, 2) for cursor in (None, "2")]
    assert [len(page.items) for page in pages] == [2, 1]
    assert [page.next_cursor for page in pages] == ["2", None]


def test_a_difference_tells_sources_tiles_and_settings(world: World) -> None:
    level = world.mapped_level()
    second = draft(world, level.id, seed=0, settings=MapBuildSettings(FeatureSet.HV, align=False))
    found = world.services.versions.diff(second.id)
    assert (found.map_id, found.against, found.identical) == (second.id, second.parent_id, True)
    assert (found.tiles.shared, found.tiles.new, found.tiles.gone) == (6, 0, 0)
    assert (found.sources.added, found.sources.removed, found.field.changed) == ((), (), 0)
    assert found.settings == (SettingChange("align", now=False, then=True),)
    third = draft(world, level.id, seed=2)
    found = world.services.versions.diff(third.id, second.id, least_ut=5.0)
    assert (found.identical, found.tiles.shared, found.tiles.new) == (False, 0, 6)
    assert 0 < found.field.changed < found.field.compared
    raster = world.services.versions.change(third, second, Component.V, significance=False)
    assert raster.values.shape == (third.rows, third.columns)


def test_what_cannot_be_compared_is_named_with_the_remedy(world: World) -> None:
    level, other = world.mapped_level(), world.mapped_level()
    first = level.current_map_id or ""
    with pytest.raises(InvalidError, match="no parent"):
        world.services.versions.diff(first)
    with pytest.raises(InvalidError, match="another level") as caught:
        world.services.versions.diff(first, other.current_map_id)
    assert (caught.value.field, level.id in caught.value.remedy) == ("against", True)
    now, then = world.services.versions.compared(draft(world, level.id).id)
    with pytest.raises(InvalidError, match="choose one of: all, h, v, total"):
        world.services.versions.change(now, then, Component.X, significance=False)


def test_a_session_is_pinned_to_the_versions_it_names(world: World) -> None:
    level = world.mapped_level()
    other = draft(world, level.id)
    create = world.services.sessions.create
    for named in ({"map_id": other.id}, {"map_ids": (other.id,)}):
        assert create(level.id, "particle", {}, **named).maps == (LevelMap(level.id, other.id),)  # type: ignore[arg-type]
    with pytest.raises(InvalidError) as caught:
        create(level.id, "particle", {}, map_id=other.id, map_ids=(other.id,))
    assert caught.value.field == "map_ids"
    with pytest.raises(InvalidError, match="one level"):
        create(level.id, "particle", {}, map_ids=(other.id, level.current_map_id or ""))


def test_in_a_venue_named_versions_stand_for_the_current_ones(world: World) -> None:
    venue_id, (ground, upper) = world.venue(0, 1, unmapped=2)
    named = draft(world, upper.id)
    create = world.services.sessions.create
    session = create(None, "particle", {}, venue_id=venue_id, map_ids=(named.id,))
    assert session.maps == (LevelMap(ground.id, ground.current_map_id or ""), LevelMap(upper.id, named.id))
    foreign = world.mapped_level()
    refusals = {
        (foreign.current_map_id or "",): "map_ids.0",
        (named.id, upper.current_map_id or ""): "map_ids.1",
    }
    for map_ids, field in refusals.items():
        with pytest.raises(InvalidError) as caught:
            create(None, "particle", {}, venue_id=venue_id, map_ids=map_ids)
        assert caught.value.field == field
        assert "name" in caught.value.remedy
