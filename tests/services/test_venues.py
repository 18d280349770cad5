from __future__ import annotations

import math

import pytest

from app.services.errors import ConflictError, InvalidError, NotFoundError
from app.services.records import Anchor, VenueKind
from tests.support.builders import World, vector_plan


def test_a_venue_is_created_read_changed_and_deleted(world: World) -> None:
    venues = world.services.venues
    venue = venues.create("House", VenueKind.INDOOR, None)
    assert venues.get(venue.id) == venue
    anchor = Anchor(48.0, 11.0, 30.0)
    changed = venues.update(venue.id, "Hall", anchor)
    assert (changed.name, changed.anchor, changed.created_at) == ("Hall", anchor, venue.created_at)
    assert changed.updated_at > venue.updated_at
    assert venues.list().items == (changed,)
    venues.delete(venue.id)
    with pytest.raises(NotFoundError):
        venues.get(venue.id)


def test_a_venue_with_levels_stays(world: World) -> None:
    level = world.level()
    with pytest.raises(ConflictError, match="has levels"):
        world.services.venues.delete(level.venue_id)
    assert world.services.venues.get(level.venue_id)


def test_levels_are_listed_by_venue(world: World) -> None:
    one, other = world.level(), world.level()
    venues = world.services.venues
    assert venues.list_levels().items == (other, one)
    assert venues.list_levels(one.venue_id).items == (one,)
    with pytest.raises(NotFoundError):
        venues.list_levels("ven_none")
    with pytest.raises(NotFoundError):
        venues.create_level("ven_none", "1", 0, (0, 0, 1, 1))


@pytest.mark.parametrize("extent", [(0, 0, 0, 1), (0, 5, 1, 1), (0, 0, math.inf, 1), (math.nan, 0, 1, 1)])
def test_an_extent_holds_something(world: World, extent: tuple[float, float, float, float]) -> None:
    venue = world.services.venues.create("House", VenueKind.INDOOR, None)
    with pytest.raises(InvalidError) as caught:
        world.services.venues.create_level(venue.id, "1", 0, extent)
    assert caught.value.field == "extent"
    assert world.services.venues.list_levels().items == ()


def test_plans_come_back_and_are_missed_by_name(world: World) -> None:
    level, venues = world.level(), world.services.venues
    for read in (venues.plan_image, venues.vector_plan):
        with pytest.raises(NotFoundError, match="of level"):
            read(level.id)
    venues.set_plan_image(level.id, b"png")
    venues.set_vector_plan(level.id, vector_plan())
    assert (venues.plan_image(level.id), venues.vector_plan(level.id)) == (b"png", vector_plan())
    stored = venues.get_level(level.id)
    assert (stored.has_plan_image, stored.has_vector_plan) == (True, True)


@pytest.mark.parametrize(
    "geojson",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"{}",
        b'{"type": "FeatureCollection"}',
        vector_plan().replace(b"[61.0, 2.25]", b"[null]"),
    ],
    ids=str,
)
def test_a_plan_that_no_build_could_read_is_refused(world: World, geojson: bytes) -> None:
    level = world.level()
    with pytest.raises(InvalidError) as caught:
        world.services.venues.set_vector_plan(level.id, geojson)
    assert caught.value.field.startswith("plan")
    assert not world.services.venues.get_level(level.id).has_vector_plan


@pytest.mark.parametrize("limit", [0, -1, 501])
def test_page_sizes_are_bounded(world: World, limit: int) -> None:
    services = world.services
    for read in (
        services.venues.list,
        services.venues.list_levels,
        services.devices.list,
        services.surveys.list,
        services.maps.list,
        services.sessions.list,
        services.jobs.list,
        services.accounts.list,
    ):
        with pytest.raises(InvalidError) as caught:
            read(limit=limit)
        assert caught.value.field == "limit"
