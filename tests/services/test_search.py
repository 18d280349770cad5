"""Venues and levels are found by place, name and storey; a scan in plain Python says what is to be found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.engine.geodesy import GeoBox, TangentPlane
from app.services.errors import InvalidError
from app.services.records import Anchor, Found, Level, Page, VenueKind
from app.services.search import EVERYTHING, MAX_RADIUS_M, Near, Search, query_words
from tests.support.builders import World

HOUSE = (0.0, 0.0, 60.0, 40.0)


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[World, list[tuple[Level, Anchor]]]]:
    """Levels of all sizes: around a city, at the antimeridian, near a pole, one the other way round the earth."""
    made = World.at(Path(tmp_path_factory.mktemp("city")))
    rng = np.random.default_rng(5)
    centres = (
        [(48.15, 11.57)] * 30 + [(-17.0, 180.0)] * 20 + [(89.5, 30.0)] * 8 + [(0.0, 0.0)] * 8 + [(60.0, -179.99)] * 8
    )
    levels = []
    for i, (latitude, longitude) in enumerate(centres):
        spread = 0.05 if i % 2 else 0.4
        where = Anchor(
            min(latitude + spread * rng.standard_normal(), 89.9),
            (longitude + spread * rng.standard_normal() + 180.0) % 360.0 - 180.0,
            float(rng.uniform(-180, 180)),
        )
        venue = made.services.venues.create(f"House {i}", VenueKind.INDOOR, where)
        side = float(rng.choice([30.0, 300.0, 5_000.0, 20_000.0], p=[0.4, 0.3, 0.2, 0.1]))
        far = float(rng.choice([0.0, 900_000.0], p=[0.95, 0.05]))
        extent = (far - side / 3, -side / 5, far + 2 * side / 3, side / 2)
        levels.append((made.services.venues.create_level(venue.id, f"F{i % 4}", i % 4, extent), where))
    yield made, levels
    made.close()


def box_of(level: Level, anchor: Anchor) -> GeoBox:
    return anchor.plane().bounds(*level.extent)


def touch(a: GeoBox, b: GeoBox) -> bool:
    if a.south_deg > b.north_deg or b.south_deg > a.north_deg:
        return False
    return any(a.west_deg <= b.east_deg + k and a.east_deg >= b.west_deg + k for k in (-720, -360, 0, 360, 720))


def whole(made: World, search: Search, limit: int = 7) -> list[Found[Level]]:
    """All pages."""
    found: list[Found[Level]] = []
    cursor: str | None = None
    while True:
        page: Page[Found[Level]] = made.services.search.levels(search, cursor=cursor, limit=limit)
        found += page.items
        cursor = page.next_cursor
        if cursor is None:
            return found


@pytest.mark.parametrize(
    "box",
    [
        GeoBox(48.1, 11.5, 48.2, 11.6),
        GeoBox(48.1499, 11.5699, 48.1501, 11.5701),
        GeoBox(-18.0, 179.5, -16.0, 180.5),
        GeoBox(-18.0, -180.0, -16.0, -179.0),
        GeoBox(59.0, 179.0, 61.0, 181.0),
        GeoBox(89.3, 20.0, 89.6, 40.0),
        GeoBox(-90.0, -180.0, 90.0, 180.0),
        GeoBox(30.0, -20.0, 70.0, 40.0),
        GeoBox(10.0, 10.0, 10.1, 10.1),
    ],
)
def test_a_box_finds_what_touches_it(city: tuple[World, list[tuple[Level, Anchor]]], box: GeoBox) -> None:
    made, levels = city
    expected = {level.id for level, anchor in levels if touch(box_of(level, anchor), box)}
    found = whole(made, Search(box=box))
    assert {one.item.id for one in found} == expected
    assert [one.item.id for one in found] == sorted(expected, reverse=True)
    assert {one.distance_m for one in found} <= {None}


@pytest.mark.parametrize(
    "near",
    [
        Near(48.15, 11.57, 3_000.0),
        Near(48.15, 11.57, MAX_RADIUS_M),
        Near(-17.0, 179.999, 40_000.0),
        Near(-17.0, -179.999, 40_000.0),
        Near(60.0, -179.99, 30_000.0),
        Near(0.0, 0.0, 10.0),
        Near(0.0, 180.0, MAX_RADIUS_M),
    ],
)
def test_the_nearest_come_first(city: tuple[World, list[tuple[Level, Anchor]]], near: Near) -> None:
    made, levels = city
    found = whole(made, Search(near=near))
    distances = [one.distance_m or 0.0 for one in found]
    assert distances == sorted(distances)
    assert len({one.item.id for one in found}) == len(found)
    told = {one.item.id: one.distance_m for one in found}
    for level, anchor in levels:
        distance = to_box_m(near, box_of(level, anchor))
        if distance < 0.97 * near.radius_m:
            assert level.id in told
        if level.id in told:
            assert told[level.id] == pytest.approx(distance, rel=0.03, abs=1.0)
        else:
            assert distance > 0.97 * near.radius_m


def to_box_m(near: Near, box: GeoBox) -> float:
    """Distance to a box of degrees, by its nearest point on a fine outline (haversine)."""
    outline = [
        (lat, lon) for lat in np.linspace(box.south_deg, box.north_deg, 60) for lon in (box.west_deg, box.east_deg)
    ]
    outline += [
        (lat, lon) for lon in np.linspace(box.west_deg, box.east_deg, 60) for lat in (box.south_deg, box.north_deg)
    ]
    inside = GeoBox(near.latitude_deg, near.longitude_deg, near.latitude_deg, near.longitude_deg)
    if touch(box, inside):
        return 0.0
    lat, lon = np.radians(np.array(outline)).T
    lat0, lon0 = math.radians(near.latitude_deg), math.radians(near.longitude_deg)
    h = np.sin((lat - lat0) / 2) ** 2 + np.cos(lat) * math.cos(lat0) * np.sin((lon - lon0) / 2) ** 2
    radius = 6_378_137.0 if abs(near.latitude_deg) < 20 else 6_371_000.0
    return float((2 * radius * np.arcsin(np.sqrt(h))).min())


def test_a_level_is_where_its_venue_is_now(world: World) -> None:
    venues, search = world.services.venues, world.services.search
    venue = venues.create("House", VenueKind.INDOOR)
    level = venues.create_level(venue.id, "1", 0, HOUSE)
    here, there = Near(48.0, 11.0, 500.0), Near(-33.0, 151.0, 500.0)
    assert search.levels(Search(near=here)).items == ()
    venues.update(venue.id, "House", Anchor(48.0, 11.0))
    assert [(one.item.id, one.distance_m) for one in search.levels(Search(near=here)).items] == [(level.id, 0.0)]
    assert [(one.item.id, one.distance_m) for one in search.venues(Search(near=here)).items] == [(venue.id, 0.0)]
    venues.update(venue.id, "House", Anchor(-33.0, 151.0))
    assert search.levels(Search(near=here)).items == search.venues(Search(near=here)).items == ()
    assert len(search.levels(Search(near=there)).items) == len(search.venues(Search(near=there)).items) == 1
    venues.update(venue.id, "House", None)
    assert search.levels(Search(near=there)).items == search.venues(Search(near=there)).items == ()
    assert len(search.levels().items) == len(search.venues().items) == 1


def test_a_venue_reaches_as_far_as_its_levels(world: World) -> None:
    venues, search = world.services.venues, world.services.search
    venue = venues.create("Road", VenueKind.ROUTE, Anchor(48.0, 11.0))
    longitude, latitude = TangentPlane(48.0, 11.0).to_wgs84(8_000.0, 50.0)
    near = Search(near=Near(latitude, longitude, 100.0))
    assert search.venues(near).items == ()
    venues.create_level(venue.id, "1", 0, (7_900.0, 0.0, 8_100.0, 100.0))
    assert [one.item.id for one in search.venues(near).items] == [venue.id]
    assert [one.item.id for one in search.venues(Search(near=Near(48.0, 11.0, 10.0))).items] == [venue.id]


def test_names_are_found_by_the_beginnings_of_their_words(world: World) -> None:
    venues, search = world.services.venues, world.services.search
    mall = venues.create("Zentrum-Süd, STRASSE 5", VenueKind.INDOOR)
    ground, first = (venues.create_level(mall.id, name, k, HOUSE) for k, name in enumerate(("Ground", "First floor")))
    venues.create("Other", VenueKind.INDOOR)

    def found(text: str) -> tuple[list[str], list[str]]:
        wanted = Search(words=query_words(text))
        return tuple([one.item.id for one in page.items] for page in (search.venues(wanted), search.levels(wanted)))  # type: ignore[return-value]

    assert found("zent") == ([mall.id], [first.id, ground.id])
    assert found("straße süd") == ([mall.id], [first.id, ground.id])
    assert found("floor zentrum") == ([], [first.id])
    assert found("entrum") == ([], [])
    venues.update(mall.id, "Arcades", None)
    assert found("zent") == ([], [])
    assert found("arc gro") == ([], [ground.id])
    with pytest.raises(InvalidError) as caught:
        query_words(" -- ")
    assert caught.value.field == "q"


def test_levels_are_found_by_storey_and_all_conditions_count(world: World) -> None:
    venues, search = world.services.venues, world.services.search
    ids = []
    for k in range(3):
        venue = venues.create(f"House {k}", VenueKind.INDOOR, Anchor(48.0 + 0.001 * k, 11.0))
        ids += [venues.create_level(venue.id, f"F{n}", n, HOUSE).id for n in range(2)]
    assert [one.item.id for one in search.levels(Search(ordinal=1)).items] == [ids[5], ids[3], ids[1]]
    near = Near(48.0, 11.0, 150.0)
    assert [one.item.id for one in search.levels(Search(near=near, ordinal=1)).items] == [ids[1], ids[3]]
    wanted = Search(near=near, ordinal=1, words=("house", "1"))
    assert [one.item.id for one in search.levels(wanted).items] == [ids[3]]
    assert search.levels(EVERYTHING, limit=2).next_cursor == ids[4]


def test_a_search_that_cannot_be_is_refused(world: World) -> None:
    with pytest.raises(InvalidError) as both:
        Search(near=Near(0, 0), box=GeoBox(0, 0, 1, 1))
    assert both.value.field == "bbox"
    with pytest.raises(InvalidError) as wide:
        Search(near=Near(0, 0, 2 * MAX_RADIUS_M))
    assert wide.value.field == "radius_m"
    for cursor in ("lvl_1", "00_lvl_1", "zz"):
        with pytest.raises(InvalidError) as caught:
            world.services.search.levels(Search(near=Near(0, 0)), cursor=cursor)
        assert caught.value.field == "cursor"
