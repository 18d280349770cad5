"""Contract of the repositories, the same on every database."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from datetime import timedelta

import numpy as np
import pytest
from sqlalchemy.exc import IntegrityError

from app.engine.types import FeatureSet, FixKind, GridMap, MapBuildSettings, Prior, TrackerState, WalkReport
from app.services.aids import NO_AIDS, Aids
from app.services.errors import NotFoundError, SequenceGapError
from app.services.ports import UnitOfWork
from app.services.records import (
    Anchor,
    ApiKey,
    Carrier,
    Device,
    DeviceMemory,
    Job,
    JobKind,
    JobState,
    Level,
    LevelMap,
    MapInfo,
    MapKind,
    NewBuild,
    Page,
    Publication,
    Scope,
    Session,
    SessionStatus,
    Survey,
    Venue,
    VenueKind,
    Walk,
)
from app.storage import Database
from tests.support.builders import (
    START,
    all_aids,
    calibration,
    fix,
    grid_map,
    new_segment,
    new_walk,
    queued_job,
    radio_map,
    scans,
)

LATER = START + timedelta(seconds=90, microseconds=123_456)
QUEUED, RUNNING, DONE, FAILED, CANCELLED = JobState


def venue(id_: str = "ven_1", anchor: Anchor | None = None) -> Venue:
    return Venue(id_, "House", VenueKind.INDOOR, anchor, START, START)


def level(id_: str = "lvl_1", venue_id: str = "ven_1") -> Level:
    return Level(id_, venue_id, "G", -1, (0.0, -1.5, 40.0, 30.25), False, False, None, START, START)


def walk(id_: str = "wlk_1", survey_id: str = "srv_1", content_hash: str = "a" * 64) -> Walk:
    return Walk(id_, survey_id, "round", None, 500, 3, 9.98, 7.0, content_hash, START)


def map_info(id_: str = "map_1", *, version: int = 1, content_hash: str = "0" * 64, level_id: str = "lvl_1") -> MapInfo:
    return MapInfo(
        id=id_,
        level_id=level_id,
        version=version,
        parent_id=None,
        hash=content_hash,
        features=FeatureSet.HV,
        x0=-3.5,
        y0=2.25,
        cell_m=0.5,
        rows=70,
        columns=130,
        mapped_m=1.5,
        noise_sd=(0.75, 0.85),
        mapped_share=0.9,
        mapped_area_m2=2000.5,
        n_walks=1,
        n_samples=500,
        length_scale_m=2.5,
        field_sd=(8.0, 7.0),
        walks=(
            WalkReport("wlk_1", 12, 7.0, (0.1, 0.2, 0.3), 0.9, stride_scale=1.08),
            WalkReport("wlk_2", 0, 0.0, (0.0, 0.0, 0.0), 0.0, "stood still"),
        ),
        build_s=1.25,
        created_at=START,
        has_obstacle=True,
    )


def session(id_: str = "ses_1", *, device_id: str | None = None) -> Session:
    prior = Prior("lvl_1", 1.0, 2.0, 3.0, heading=0.5)
    parameters = {"n_particles": 500, "sd": 0.1, "name": "x", "on": True, "list": [1, 2]}
    maps = (LevelMap("lvl_1", "map_1"),)
    return Session(
        id_, "ven_1", "lvl_1", maps, device_id, "particle", parameters, prior, SessionStatus.OPEN, 0, START, None
    )


def add_level(uow: UnitOfWork) -> None:
    uow.venues.add(venue())
    uow.levels.add(level())


def add_survey(uow: UnitOfWork) -> None:
    add_level(uow)
    uow.surveys.add(Survey("srv_1", "lvl_1", "first", 0, START))


def add_map(uow: UnitOfWork) -> MapInfo:
    add_level(uow)
    packed = uow.maps.pack(grid_map("lvl_1", plan=True))
    info = map_info(content_hash=packed.hash)
    uow.maps.add(info, packed)
    return info


def add_session(uow: UnitOfWork) -> None:
    add_map(uow)
    uow.sessions.add(session())


def add_segment(uow: UnitOfWork, seq: int = 0) -> None:
    uow.jobs.add(queued_job(f"job_{seq}", seq=seq))
    uow.sessions.add_segment("ses_1", new_segment(seq), f"job_{seq}", LATER)


def write(database: Database, *steps: Callable[[UnitOfWork], object]) -> None:
    """Run steps in a committed transaction, so that reads see what was really stored."""
    with database(write=True) as uow:
        for step in steps:
            step(uow)


def ids(page: Page[Venue] | Page[Job] | Page[Session] | Page[Level]) -> list[str]:
    return [item.id for item in page.items]


@pytest.mark.parametrize("anchor", [None, Anchor(48.1, 11.5, 12.5, 520.0), Anchor(0.0, 0.0)], ids=str)
def test_venues(database: Database, anchor: Anchor | None) -> None:
    write(database, lambda uow: uow.venues.add(venue(anchor=anchor)))
    with database() as uow:
        assert uow.venues.get("ven_1") == venue(anchor=anchor)
    moved = Anchor(1.0, 2.0, 3.0, 4.0)
    write(database, lambda uow: uow.venues.update("ven_1", name="Hall", anchor=moved, now=LATER))
    with database() as uow:
        assert uow.venues.get("ven_1") == replace(venue(), name="Hall", anchor=moved, updated_at=LATER)
    write(database, lambda uow: uow.venues.delete("ven_1"))
    with database() as uow:
        assert uow.venues.list(cursor=None, limit=10) == Page((), None)


def test_what_is_not_there_is_named(database: Database) -> None:
    with database(write=True) as uow:
        lookups: Iterable[tuple[str, Callable[[], object]]] = (
            ("venue", lambda: uow.venues.get("x")),
            ("venue", lambda: uow.venues.delete("x")),
            ("venue", lambda: uow.venues.update("x", name="", anchor=None, now=START)),
            ("level", lambda: uow.levels.get("x")),
            ("level", lambda: uow.levels.plan_image("x")),
            ("level", lambda: uow.levels.vector_plan("x")),
            ("level", lambda: uow.levels.set_vector_plan("x", b"", START)),
            ("level", lambda: uow.levels.set_current_map("x", "map_1", START)),
            ("device", lambda: uow.devices.get("x")),
            ("survey", lambda: uow.surveys.get("x")),
            ("walk", lambda: uow.surveys.get_walk("x")),
            ("walk", lambda: uow.surveys.delete_walk("x")),
            ("map", lambda: uow.maps.get("x")),
            ("map", lambda: uow.maps.load("x")),
            ("map build", lambda: uow.maps.get_build("x")),
            ("session", lambda: uow.sessions.get("x")),
            ("session", lambda: uow.sessions.close("x", START)),
            ("segment", lambda: uow.sessions.get_segment("x", 0)),
            ("segment", lambda: uow.sessions.load_segment("x", 0)),
            ("segment", lambda: uow.sessions.record_failure("x", 0, "", START)),
            ("segment", lambda: uow.sessions.list_positions("x", seq=0, cursor=None, limit=1)),
            ("segment", lambda: uow.sessions.get_result("x", 0)),
            ("job", lambda: uow.jobs.get("x")),
            ("job", lambda: uow.jobs.finish("x", DONE, START)),
            ("key", lambda: uow.keys.get("x")),
            ("key", lambda: uow.keys.revoke("x", START)),
        )
        for kind, look_up in lookups:
            with pytest.raises(NotFoundError) as caught:
                look_up()
            assert caught.value.kind == kind


def test_lists_page_newest_first_without_skips_or_repeats(database: Database) -> None:
    write(database, *(lambda uow, i=i: uow.venues.add(venue(f"ven_{i}")) for i in range(5)))
    seen, cursor = [], None
    with database() as uow:
        while True:
            page = uow.venues.list(cursor=cursor, limit=2)
            seen += ids(page)
            cursor = page.next_cursor
            if cursor is None:
                break
        assert seen == ["ven_4", "ven_3", "ven_2", "ven_1", "ven_0"]
        assert uow.venues.list(cursor=None, limit=5).next_cursor is None
        assert uow.venues.list(cursor="ven_0", limit=5) == Page((), None)


def test_levels_and_their_plans(database: Database) -> None:
    write(database, add_level, lambda uow: uow.venues.add(venue("ven_2")))
    write(database, lambda uow: uow.levels.add(level("lvl_2", "ven_2")))
    with database() as uow:
        assert uow.levels.get("lvl_1") == level()
        assert uow.levels.plan_image("lvl_1") is None
        assert ids(uow.levels.list(venue_id=None, cursor=None, limit=9)) == ["lvl_2", "lvl_1"]
        assert ids(uow.levels.list(venue_id="ven_1", cursor=None, limit=9)) == ["lvl_1"]
    for png in (b"\x89PNG first", b"\x89PNG second"):
        write(database, lambda uow, png=png: uow.levels.set_plan_image("lvl_1", png, LATER))
    write(database, lambda uow: uow.levels.set_vector_plan("lvl_1", b"{}", LATER))
    with database() as uow:
        assert uow.levels.plan_image("lvl_1") == b"\x89PNG second"
        assert uow.levels.vector_plan("lvl_1") == b"{}"
        assert uow.levels.get("lvl_1") == replace(level(), has_plan_image=True, has_vector_plan=True, updated_at=LATER)
        assert uow.levels.vector_plan("lvl_2") is None


def test_devices(database: Database) -> None:
    devices = (Device("dev_2", "b", "Pixel 9", LATER), Device("dev_1", "a", None, START))
    write(database, *(lambda uow, one=one: uow.devices.add(one) for one in devices))
    with database() as uow:
        assert uow.devices.get("dev_2") == devices[0]
        assert uow.devices.list(cursor=None, limit=9) == Page(devices, None)


def test_walks(database: Database) -> None:
    data = replace(new_walk(wifi=scans()), ble=all_aids().ble)
    write(database, add_survey, lambda uow: uow.surveys.add_walk(walk(content_hash=data.content_hash), data))
    plain = new_walk(seed=1)
    write(database, lambda uow: uow.surveys.add_walk(walk("wlk_2", content_hash=plain.content_hash), plain))
    with database() as uow:
        assert uow.surveys.get("srv_1") == Survey("srv_1", "lvl_1", "first", 2, START)
        assert uow.surveys.list(level_id="lvl_1", cursor=None, limit=9).items[0].n_walks == 2
        assert uow.surveys.list(level_id="lvl_2", cursor=None, limit=9).items == ()
        assert uow.surveys.get_walk("wlk_1") == walk(content_hash=data.content_hash)
        assert uow.surveys.find_walk("srv_1", data.content_hash) == uow.surveys.get_walk("wlk_1")
        assert uow.surveys.find_walk("srv_1", "f" * 64) is None
        oldest = uow.surveys.list_walks("srv_1", cursor=None, limit=1)
        assert [one.id for one in oldest.items] == ["wlk_1"]
        following = uow.surveys.list_walks("srv_1", cursor=oldest.next_cursor, limit=1)
        assert ([one.id for one in following.items], following.next_cursor) == (["wlk_2"], None)
        first, second = uow.surveys.load_walks("lvl_1", ())
        assert (first.walk_id, second.walk_id, second.wifi) == ("wlk_1", "wlk_2", None)
        np.testing.assert_array_equal(first.samples.mag, data.samples.mag)
        np.testing.assert_array_equal(first.waypoints.x, data.waypoints.x)
        assert first.wifi is not None
        assert first.wifi.address == scans().address
        assert first.ble is not None
        assert first.ble.address == all_aids().ble.address  # type: ignore[union-attr]
        assert second.ble is None
    write(database, lambda uow: uow.surveys.delete_walk("wlk_1"))
    with database() as uow:
        assert [one.walk_id for one in uow.surveys.load_walks("lvl_1", ())] == ["wlk_2"]


def test_devices_of_walks(database: Database) -> None:
    write(database, add_survey, lambda uow: uow.devices.add(Device("dev_1", "phone", None, START)))
    own = replace(walk("wlk_1", content_hash="a" * 64), device_id="dev_1", calibration_epoch="bias-1")
    write(database, lambda uow: uow.surveys.add_walk(own, new_walk()))
    write(database, lambda uow: uow.surveys.add_walk(walk("wlk_2", content_hash="b" * 64), new_walk()))
    with database() as uow:
        assert uow.surveys.carriers("lvl_1") == {"wlk_1": Carrier("dev_1", "bias-1", offset_remembered=False)}
        assert uow.surveys.carriers("lvl_2") == {}
        assert uow.surveys.get_walk("wlk_1") == own
    write(database, lambda uow: uow.surveys.mark_offsets_remembered(["wlk_1"], LATER))
    with database() as uow:
        assert uow.surveys.carriers("lvl_1")["wlk_1"].offset_remembered


def test_walks_of_some_surveys(database: Database) -> None:
    write(database, add_survey, lambda uow: uow.surveys.add(Survey("srv_2", "lvl_1", "second", 0, START)))
    for i, survey_id in enumerate(("srv_1", "srv_2", "srv_2")):
        one = walk(f"wlk_{i}", survey_id, f"{i:064d}")
        write(database, lambda uow, one=one: uow.surveys.add_walk(one, new_walk()))
    with database() as uow:
        for survey_ids, expected in (((), 3), (("srv_1",), 1), (("srv_2",), 2), (("srv_1", "srv_2"), 3), (("x",), 0)):
            assert uow.surveys.count_walks("lvl_1", survey_ids) == expected
            assert len(uow.surveys.load_walks("lvl_1", survey_ids)) == expected
        assert uow.surveys.count_walks("lvl_2", ()) == 0


def test_one_survey_holds_a_content_once(database: Database) -> None:
    write(database, add_survey, lambda uow: uow.surveys.add_walk(walk(), new_walk()))
    with pytest.raises(IntegrityError):
        write(database, lambda uow: uow.surveys.add_walk(walk("wlk_2"), new_walk()))


def test_maps_come_back_and_become_current(database: Database) -> None:
    write(database, add_map)
    expected = grid_map("lvl_1", plan=True)
    with database() as uow:
        assert uow.levels.get("lvl_1").current_map_id is None
        info = uow.maps.get("map_1")
        assert info == map_info(content_hash=info.hash)
        loaded = uow.maps.load("map_1")
        assert uow.maps.pack(loaded).hash == info.hash
        assert uow.maps.next_version("lvl_1") == 2
        assert uow.maps.next_version("lvl_2") == 1
        assert (uow.maps.paced_walks("lvl_1"), uow.maps.paced_walks("lvl_2")) == ({"wlk_1"}, set())
        assert uow.maps.list(level_id="lvl_1", cursor=None, limit=9) == Page((info,), None)
        assert uow.maps.list(level_id="lvl_2", cursor=None, limit=9) == Page((), None)
    np.testing.assert_array_equal(loaded.mean, expected.mean)
    assert loaded.noise_sd == expected.noise_sd
    write(database, lambda uow: uow.levels.set_current_map("lvl_1", "map_1", LATER))
    with database() as uow:
        assert uow.levels.get("lvl_1").current_map_id == "map_1"


def test_publications_are_listed_newest_first_by_level(database: Database) -> None:
    write(database, add_map)
    log = [Publication(f"pub_{i}", "lvl_1", "map_1", "map_1" if i else None, None, f"n{i}", LATER) for i in range(3)]

    def publish(uow: UnitOfWork) -> None:
        for one in log:
            uow.publications.add(one)
        assert uow.levels.set_current_map("lvl_1", "map_1", LATER) is None
        assert uow.levels.set_current_map("lvl_1", "map_1", LATER) == "map_1"

    write(database, publish)
    with database() as uow:
        assert uow.publications.latest("lvl_1") == log[2]
        assert uow.publications.latest("lvl_2") is None
        assert uow.publications.list("lvl_1", cursor=None, limit=2) == Page((log[2], log[1]), "pub_1")
        assert uow.publications.list("lvl_1", cursor="pub_1", limit=2) == Page((log[0],), None)


def test_a_build_is_known_by_its_map(database: Database) -> None:
    order = NewBuild("lvl_1", MapBuildSettings(cell_m=0.25), ("srv_1",), publish=False)
    key = ApiKey("key_1", "k", frozenset({Scope.SURVEY}), START, None, None)

    def build(uow: UnitOfWork) -> None:
        uow.keys.add(key, "f" * 64)
        uow.jobs.add(queued_job("job_1", kind=JobKind.BUILD_MAP))
        uow.maps.add_build("job_1", replace(order, key_id="key_1"))
        assert uow.maps.build_of("map_1") is None
        uow.maps.finish_build("job_1", "map_1")

    write(database, add_map, build)
    with database() as uow:
        assert uow.maps.build_of("map_1") == uow.maps.get_build("job_1") == replace(order, key_id="key_1")
        hashes = uow.maps.tile_hashes("map_1")
        assert hashes == [tile.hash for tile in uow.maps.pack(grid_map("lvl_1", plan=True)).tiles]


def test_reports_of_an_update_are_beside_those_of_its_build(database: Database) -> None:
    def report(walk_id: str) -> WalkReport:
        return WalkReport(walk_id, 9, 5.0, (0.0, 0.0, 0.0), 1.0)

    def versions(uow: UnitOfWork) -> None:
        packed = uow.maps.pack(grid_map("lvl_1", plan=True))
        update = replace(map_info("map_2", version=2), parent_id="map_1", kind=MapKind.UPDATE)
        for info in (
            replace(update, walks=(report("wlk_3"),), removed=("wlk_2",)),
            replace(update, id="map_3", version=3, parent_id="map_2", walks=(report("wlk_4"),)),
            replace(map_info("map_4", version=4), parent_id="map_3", walks=(report("wlk_5"),)),
        ):
            uow.maps.add(info, packed)

    write(database, add_map, versions)
    with database() as uow:
        known = {f"map_{i}": set(uow.maps.reports(f"map_{i}")) for i in (1, 2, 3, 4)}
        assert uow.maps.reports("map_3")["wlk_3"] == report("wlk_3")
    assert known == {
        "map_1": {"wlk_1", "wlk_2"},
        "map_2": {"wlk_1", "wlk_3"},
        "map_3": {"wlk_1", "wlk_3", "wlk_4"},
        "map_4": {"wlk_5"},
    }


def test_versions_share_their_equal_tiles(database: Database) -> None:
    write(database, add_map)
    one = grid_map("lvl_1", plan=True)
    changed = replace(one, mean=one.mean.copy())
    changed.mean[0, 0, 0] += 1

    def second(uow: UnitOfWork) -> None:
        packed = uow.maps.pack(changed)
        uow.maps.add(map_info("map_2", version=2, content_hash=packed.hash), packed)

    write(database, second)
    with database() as uow:
        np.testing.assert_array_equal(uow.maps.load("map_1").mean, one.mean)
        np.testing.assert_array_equal(uow.maps.load("map_2").mean, changed.mean)
    with database.engine.connect() as connection:
        n_tiles = connection.exec_driver_sql("SELECT count(*) FROM tiles").scalar_one()
        n_places = connection.exec_driver_sql("SELECT count(*) FROM map_tiles").scalar_one()
    assert (n_tiles, n_places) == (7, 12)  # 2 x 3 tiles a version


def test_versions_share_a_radio_layer(database: Database) -> None:
    radio = radio_map()
    other = radio_map(seed=3)
    layers = ((1, radio), (2, radio), (2, other), (2, None))
    versions = [(grid_map("lvl_1", seed=seed, plan=True, radio=layer), i + 1) for i, (seed, layer) in enumerate(layers)]
    write(database, add_level)
    for one, number in versions:

        def add(uow: UnitOfWork, one: GridMap = one, number: int = number) -> None:
            packed = uow.maps.pack(one)
            info = map_info(f"map_{number}", version=number, content_hash=packed.hash)
            heard = None if one.radio is None else len(one.radio.addresses)
            uow.maps.add(replace(info, n_transmitters=heard, radio_cell_m=None if heard is None else 2.0), packed)

        write(database, add)
    with database() as uow:
        for one, number in versions:
            loaded, info = uow.maps.load(f"map_{number}").radio, uow.maps.get(f"map_{number}")
            assert (info.n_transmitters, info.radio_cell_m) == ((5, 2.0) if one.radio else (None, None))
            assert (loaded is None) == (one.radio is None)
            if loaded is not None and one.radio is not None:
                np.testing.assert_array_equal(loaded.mean, one.radio.mean)
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT count(*) FROM radio_layers").scalar_one() == 2


def test_builds_keep_their_request(database: Database) -> None:
    settings = MapBuildSettings(FeatureSet.TOTAL, 0.25, 2.0, (0.0, 1.0, 2.0, 3.5), align=False)
    for i, build in enumerate((NewBuild("lvl_1"), NewBuild("lvl_1", settings, ("srv_1", "srv_2")))):
        if i == 0:
            write(database, add_level)
        write(database, lambda uow, i=i: uow.jobs.add(queued_job(f"job_{i}")))
        write(database, lambda uow, i=i, build=build: uow.maps.add_build(f"job_{i}", build))
        with database() as uow:
            assert uow.maps.get_build(f"job_{i}") == build


def test_sessions(database: Database) -> None:
    prior = replace(session().prior, calibration=calibration())
    other = replace(session("ses_2", device_id="dev_1"), prior=prior, calibration_epoch="bias-1")
    write(database, add_map, lambda uow: uow.devices.add(Device("dev_1", "a", None, START)))
    write(
        database,
        lambda uow: uow.sessions.add(session()),
        lambda uow: uow.sessions.add(other),
    )
    write(database, lambda uow: uow.sessions.close("ses_1", LATER))
    closed = replace(session(), status=SessionStatus.CLOSED, closed_at=LATER)
    with database(write=True) as uow:
        assert uow.sessions.get("ses_1") == closed
        assert uow.sessions.close("ses_1", LATER + timedelta(hours=1)) == closed
        assert uow.sessions.get("ses_2") == other

        def listed(**wanted: str) -> list[str]:
            filters = dict.fromkeys(("venue_id", "level_id", "device_id", "status")) | wanted
            return ids(uow.sessions.list(**filters, cursor=None, limit=9))

        assert listed() == ["ses_2", "ses_1"]
        assert listed(level_id="lvl_1") == ["ses_2", "ses_1"]
        assert listed(level_id="lvl_2") == listed(venue_id="ven_2") == []
        assert listed(venue_id="ven_1") == ["ses_2", "ses_1"]
        assert listed(device_id="dev_1") == ["ses_2"]
        assert listed(status=SessionStatus.CLOSED) == ["ses_1"]
        assert listed(status=SessionStatus.OPEN) == ["ses_2"]


def test_a_session_in_a_venue_has_no_level_and_all_maps(database: Database) -> None:
    maps = (LevelMap("lvl_1", "map_1"), LevelMap("lvl_2", "map_2"))
    anywhere = replace(session("ses_2"), level_id=None, maps=maps, prior=Prior(None, heading=0.5))
    write(database, add_map, lambda uow: uow.sessions.add(anywhere))
    with database() as uow:
        assert uow.sessions.get("ses_2") == anywhere


def test_current_maps_of_a_venue_come_lowest_level_first(database: Database) -> None:
    def add(uow: UnitOfWork, number: int, ordinal: int, *, mapped: bool = True) -> None:
        uow.levels.add(replace(level(f"lvl_{number}"), ordinal=ordinal))
        if mapped:
            uow.maps.add(map_info(f"map_{number}", level_id=f"lvl_{number}"), uow.maps.pack(grid_map()))
            uow.levels.set_current_map(f"lvl_{number}", f"map_{number}", LATER)

    write(database, lambda uow: (uow.venues.add(venue()), uow.venues.add(venue("ven_2"))))
    write(database, lambda uow: add(uow, 1, 2), lambda uow: add(uow, 2, -1), lambda uow: add(uow, 3, 0, mapped=False))
    with database() as uow:
        expected = (LevelMap("lvl_2", "map_2"), LevelMap("lvl_1", "map_1"))
        assert uow.levels.current_maps("ven_1", limit=9) == expected
        assert uow.levels.current_maps("ven_1", limit=1) == expected[:1]
        assert uow.levels.current_maps("ven_2", limit=9) == ()


def test_segments(database: Database) -> None:
    write(database, add_session)
    with database() as uow:
        assert uow.sessions.last_segment("ses_1") is None
    new = new_segment(0, aids=Aids(wifi=scans()))
    write(database, lambda uow: uow.jobs.add(queued_job("job_0")))
    write(database, lambda uow: uow.sessions.add_segment("ses_1", new, "job_0", LATER))
    write(database, lambda uow: add_segment(uow, 1))
    with database() as uow:
        assert uow.sessions.get("ses_1").next_seq == 2
        info = uow.sessions.get_segment("ses_1", 0)
        assert (info.content_hash, info.n_samples, info.job_id) == (new.content_hash, 250, "job_0")
        assert (info.t_start, info.t_end) == (new.samples.t[0], new.samples.t[-1])
        assert (info.job_state, info.error, info.received_at, info.processed_at) == (QUEUED, None, LATER, None)
        last = uow.sessions.last_segment("ses_1")
        assert last is not None
        assert last.seq == 1
        page = uow.sessions.list_segments("ses_1", cursor=None, limit=1)
        assert ([one.seq for one in page.items], page.next_cursor) == ([0], "0")
        page = uow.sessions.list_segments("ses_1", cursor="0", limit=1)
        assert ([one.seq for one in page.items], page.next_cursor) == ([1], None)
        loaded = uow.sessions.load_segment("ses_1", 0)
        for name in ("t", "mag", "acc", "gyro"):
            np.testing.assert_array_equal(getattr(loaded.samples, name), getattr(new.samples, name))
        assert loaded.aids.wifi is not None
        np.testing.assert_array_equal(loaded.aids.wifi.rssi, scans().rssi)
        assert uow.sessions.load_segment("ses_1", 1).aids == NO_AIDS


def test_aids_come_back_to_the_bit(database: Database) -> None:
    write(database, add_session, lambda uow: uow.jobs.add(queued_job("job_0")))
    write(database, lambda uow: uow.sessions.add_segment("ses_1", new_segment(0, aids=all_aids()), "job_0", LATER))
    write(database, lambda uow: uow.jobs.claim(limit=1, now=LATER), lambda uow: uow.jobs.finish("job_0", DONE, LATER))
    with database() as uow:
        for loaded in (uow.sessions.load_segment("ses_1", 0), uow.sessions.load_segments("ses_1", 1)[0]):
            for aid in fields(Aids):
                taken, given = getattr(loaded.aids, aid.name), getattr(all_aids(), aid.name)
                assert type(taken) is type(given)
                for column in fields(given):
                    a, b = getattr(taken, column.name), getattr(given, column.name)
                    assert a == b if isinstance(b, tuple) else a.tobytes() == b.tobytes(), (aid.name, column.name)


def test_what_a_session_learned_last_stays_until_it_learns_more(database: Database) -> None:
    write(database, add_session, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in range(4)))
    state = TrackerState("particle", b"x", 1.0)
    expected = None
    for seq, learned in enumerate((None, calibration(1.0), None, calibration(-2.0 / 3.0))):
        with database(write=True) as uow:
            status = uow.sessions.record_result("ses_1", seq, state, (), LATER, calibration=learned)
        assert status is SessionStatus.OPEN
        expected = learned or expected
        with database() as uow:
            assert uow.sessions.learned("ses_1") == expected
    with database() as uow:
        assert uow.sessions.learned("ses_2") is None
    write(database, lambda uow: uow.sessions.close("ses_1", LATER))
    with database(write=True) as uow:
        assert uow.sessions.record_result("ses_1", 3, state, (), LATER) is SessionStatus.CLOSED
        assert uow.sessions.mark_remembered("ses_1", LATER)
    with database(write=True) as uow:
        assert not uow.sessions.mark_remembered("ses_1", LATER)


def test_what_is_remembered_of_devices(database: Database) -> None:
    write(
        database,
        lambda uow: uow.devices.add(Device("dev_1", "a", None, START)),
        lambda uow: uow.devices.add(Device("dev_2", "b", None, START)),
    )
    old = DeviceMemory("dev_1", "", calibration(1.0 / 3.0), 4, START)
    new = DeviceMemory("dev_1", "bias é", calibration(7.0), 1, LATER)
    other = DeviceMemory("dev_2", "", calibration(-1.0), 2, LATER)
    write(database, *(lambda uow, memory=memory: uow.devices.set_memory(memory) for memory in (new, old, other)))
    with database() as uow:
        assert uow.devices.memories("dev_1") == (new, old)
        with pytest.raises(NotFoundError, match="device"):
            uow.devices.memories("dev_3")
    newest = replace(old, calibration=calibration(2.0), n_sessions=5, updated_at=LATER + timedelta(seconds=1))
    write(database, lambda uow: uow.devices.set_memory(newest))
    with database(write=True) as uow:
        assert uow.devices.memories("dev_1") == (newest, new)
    write(database, lambda uow: uow.devices.forget("dev_1"))
    with database() as uow:
        assert (uow.devices.memories("dev_1"), uow.devices.memories("dev_2")) == ((), (other,))


def test_pending_jobs_of_a_key(database: Database) -> None:
    write(
        database,
        *(lambda uow, i=i, key=key: uow.jobs.add(queued_job(f"job_{i}", key=key)) for i, key in enumerate("aab")),
    )

    def pending() -> list[bool]:
        with database() as uow:
            return [uow.jobs.is_pending(key) for key in "abc"]

    assert pending() == [True, True, False]
    write(database, lambda uow: uow.jobs.claim(limit=9, now=LATER))
    write(
        database, lambda uow: uow.jobs.finish("job_2", DONE, LATER), lambda uow: uow.jobs.finish("job_0", FAILED, LATER)
    )
    assert pending() == [True, False, False]
    write(database, lambda uow: uow.jobs.finish("job_1", CANCELLED, LATER))
    assert pending() == [False, False, False]


def test_samples_of_all_done_segments_come_oldest_first(database: Database) -> None:
    write(database, add_session, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in range(2)))
    new = new_segment(2, aids=Aids(wifi=scans()))
    write(database, lambda uow: uow.jobs.add(queued_job("job_2", seq=2)))
    write(database, lambda uow: uow.sessions.add_segment("ses_1", new, "job_2", LATER))
    write(database, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in (3, 4)))
    with database() as uow:
        assert list(uow.sessions.load_segments("ses_1", 9)) == []
    ends = {0: JobState.DONE, 1: JobState.FAILED, 2: JobState.DONE, 3: JobState.DONE}
    for seq, state in ends.items():
        write(database, lambda uow: uow.jobs.claim(limit=1, now=LATER))
        write(database, lambda uow, seq=seq, state=state: uow.jobs.finish(f"job_{seq}", state, LATER))
    with database() as uow:
        loaded = uow.sessions.load_segments("ses_1", 9)
        starts = [new_segment(seq).samples.t[0] for seq in (0, 2, 3)]
        assert [segment.samples.t[0] for segment in loaded] == starts
        np.testing.assert_array_equal(loaded[1].samples.mag, new.samples.mag)
        assert [segment.aids.wifi is None for segment in loaded] == [True, False, True]
        assert [segment.samples.t[0] for segment in uow.sessions.load_segments("ses_1", 2)] == starts[:2]
        assert list(uow.sessions.load_segments("ses_2", 9)) == []


def test_a_segment_out_of_turn_is_not_stored(database: Database) -> None:
    write(database, add_session, lambda uow: add_segment(uow, 0))
    for seq in (0, 2):
        with pytest.raises(SequenceGapError) as caught:
            write(database, lambda uow, seq=seq: add_segment(uow, seq) if seq else _again(uow))
        assert caught.value.expected == 1
    with database() as uow:
        assert uow.jobs.count(*JobState) == 1


def _again(uow: UnitOfWork) -> None:
    uow.jobs.add(queued_job("job_again"))
    uow.sessions.add_segment("ses_1", new_segment(0), "job_again", LATER)


def test_results_number_the_fixes_and_replace_the_state(database: Database) -> None:
    write(database, add_session, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in range(4)))
    fixes = [fix(1.79e9 + i, level_id="lvl_1", x=float(i)) for i in range(6)]
    fixes[5] = replace(fixes[5], walk_on_m=4.5, sure=False)
    states = [TrackerState("particle", bytes([i]) * 100, float(i)) for i in range(3)]
    with database() as uow:
        assert uow.sessions.state("ses_1") is None
    for seq, chunk in ((0, fixes[:4]), (1, []), (3, fixes[4:])):
        write(
            database,
            lambda uow, seq=seq, chunk=chunk: uow.sessions.record_result(
                "ses_1", seq, states[min(seq, 2)], chunk, LATER
            ),
        )
    write(database, lambda uow: uow.sessions.record_failure("ses_1", 2, "worker died", LATER))
    with database() as uow:
        assert uow.sessions.state("ses_1") == states[2]
        everything = uow.sessions.list_positions("ses_1", seq=None, cursor=None, limit=100)
        assert [position.fix for position in everything.items] == fixes
        assert [position.number for position in everything.items] == list(range(6))
        assert [position.seq for position in everything.items] == [0, 0, 0, 0, 3, 3]
        page = uow.sessions.list_positions("ses_1", seq=0, cursor="1", limit=1)
        assert ([position.number for position in page.items], page.next_cursor) == ([2], "2")
        page = uow.sessions.list_positions("ses_1", seq=3, cursor=None, limit=2)
        assert ([position.number for position in page.items], page.next_cursor) == ([4, 5], None)
        for seq in (1, 2):
            assert uow.sessions.list_positions("ses_1", seq=seq, cursor=None, limit=9).items == ()
        assert uow.sessions.get_segment("ses_1", 2).error == "worker died"
        assert uow.sessions.get_segment("ses_1", 1).processed_at == LATER


def test_kinds_of_fixes_are_numbered_each_for_itself(database: Database) -> None:
    write(database, add_session, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in range(4)))
    told = [fix(1.79e9 + i, level_id="lvl_1", x=float(i)) for i in range(6)]
    later = [replace(one, x=one.x + 0.5, walk_on_m=3.0, kind=FixKind.FIXED_LAG) for one in told[:5]]
    state = TrackerState("particle", b"", None)
    for seq, fixes, lagged in ((0, told[:4], []), (1, told[4:], later[:2]), (2, [], later[2:])):
        write(
            database,
            lambda uow, seq=seq, fixes=fixes, lagged=lagged: uow.sessions.record_result(
                "ses_1", seq, state, fixes, LATER, lagged=lagged
            ),
        )
    with database() as uow:
        for kind, expected, by in (
            (FixKind.FILTERED, told, [0, 0, 0, 0, 1, 1]),
            (FixKind.FIXED_LAG, later, [1, 1, 2, 2, 2]),
        ):
            page = uow.sessions.list_positions("ses_1", seq=None, cursor=None, limit=99, kind=kind)
            assert [position.fix for position in page.items] == expected
            assert [position.number for position in page.items] == list(range(len(expected)))
            assert [position.seq for position in page.items] == by
        page = uow.sessions.list_positions("ses_1", seq=2, cursor="2", limit=1, kind=FixKind.FIXED_LAG)
        assert ([position.number for position in page.items], page.next_cursor) == ([3], "3")
        for seq, fixes, lagged in ((0, told[:4], []), (1, told[4:], later[:2]), (2, [], later[2:]), (3, [], [])):
            result = uow.sessions.get_result("ses_1", seq)
            assert (result.segment, result.fixes, result.lagged) == (
                uow.sessions.get_segment("ses_1", seq), tuple(fixes), tuple(lagged),
            )  # fmt: skip


def test_claims_take_the_oldest_of_each_key_and_none_of_a_busy_one(database: Database) -> None:
    keys = ["a", "a", "b", "a", "c", "b"]
    write(
        database,
        *(lambda uow, i=i, key=key: uow.jobs.add(queued_job(f"job_{i}", key=key)) for i, key in enumerate(keys)),
    )

    def claim(limit: int) -> list[str]:
        with database(write=True) as uow:
            return [job.id for job in uow.jobs.claim(limit=limit, now=LATER)]

    assert claim(2) == ["job_0", "job_2"]
    assert claim(9) == ["job_4"]
    assert claim(9) == []
    write(database, lambda uow: uow.jobs.finish("job_0", DONE, LATER))
    assert claim(9) == ["job_1"]
    write(database, lambda uow: uow.jobs.finish("job_2", FAILED, LATER))
    write(database, lambda uow: uow.jobs.finish("job_1", CANCELLED, LATER))
    assert claim(9) == ["job_3", "job_5"]


def test_claims_follow_arrival_also_when_the_clock_was_set_back(database: Database) -> None:
    write(database, *(lambda uow, id_=id_: uow.jobs.add(queued_job(id_, key="a")) for id_ in ("job_9", "job_1")))
    with database(write=True) as uow:
        assert [job.id for job in uow.jobs.claim(limit=9, now=LATER)] == ["job_9"]


def test_claims_of_one_kind(database: Database) -> None:
    write(
        database,
        lambda uow: uow.jobs.add(queued_job("job_1", key="lvl_1", kind=JobKind.BUILD_MAP)),
        lambda uow: uow.jobs.add(queued_job("job_2")),
    )
    with database(write=True) as uow:
        assert [job.id for job in uow.jobs.claim(limit=9, now=LATER, kind=JobKind.LOCATE_SEGMENT)] == ["job_2"]
        assert [job.id for job in uow.jobs.claim(limit=9, now=LATER, kind=JobKind.BUILD_MAP)] == ["job_1"]


def test_a_job_goes_its_way(database: Database) -> None:
    write(database, lambda uow: uow.jobs.add(queued_job()))
    with database(write=True) as uow:
        (claimed,) = uow.jobs.claim(limit=1, now=START)
        assert claimed == replace(queued_job(), state=RUNNING, attempts=1, started_at=START)
        uow.jobs.set_progress("job_1", 0.25, "kriging")
    with database(write=True) as uow:
        assert uow.jobs.get("job_1") == replace(claimed, progress=0.25, progress_text="kriging")
        assert uow.jobs.finish("job_1", DONE, LATER, result={"map_id": "map_1", "cpu_s": 0.5, "n": 3}, attempts=1)
        done = uow.jobs.get("job_1")
        assert (done.state, done.progress, done.finished_at) == (DONE, 1.0, LATER)
        assert done.result == {"map_id": "map_1", "cpu_s": 0.5, "n": 3}
        uow.jobs.set_progress("job_1", 0.5, "late")
        assert uow.jobs.get("job_1") == done


@pytest.mark.parametrize("state", [DONE, FAILED, CANCELLED])
def test_final_states_are_final(database: Database, state: JobState) -> None:
    write(database, lambda uow: uow.jobs.add(queued_job()), lambda uow: uow.jobs.claim(limit=1, now=START))
    with database(write=True) as uow:
        assert uow.jobs.finish("job_1", state, LATER)
        for other in (DONE, FAILED, CANCELLED):
            assert not uow.jobs.finish("job_1", other, LATER)
        assert not uow.jobs.requeue("job_1")
        assert uow.jobs.get("job_1").state is state


def test_only_cancellation_ends_a_queued_job(database: Database) -> None:
    write(database, lambda uow: uow.jobs.add(queued_job()))
    with database(write=True) as uow:
        assert not uow.jobs.finish("job_1", DONE, LATER)
        assert not uow.jobs.finish("job_1", FAILED, LATER)
        assert uow.jobs.finish("job_1", CANCELLED, LATER)


def test_an_earlier_attempt_cannot_end_or_requeue_a_job(database: Database) -> None:
    write(database, lambda uow: uow.jobs.add(queued_job()), lambda uow: uow.jobs.claim(limit=1, now=START))
    with database(write=True) as uow:
        assert uow.jobs.requeue("job_1", attempts=1)
        assert not uow.jobs.requeue("job_1", attempts=1)
        (again,) = uow.jobs.claim(limit=1, now=LATER)
        assert again.attempts == 2
        assert not uow.jobs.finish("job_1", DONE, LATER, attempts=1)
        assert not uow.jobs.requeue("job_1", attempts=1)
        assert uow.jobs.finish("job_1", DONE, LATER, attempts=2)


def test_running_jobs_are_queued_again_at_start(database: Database) -> None:
    write(database, *(lambda uow, i=i: uow.jobs.add(queued_job(f"job_{i}", key=f"{i}")) for i in range(4)))
    with database(write=True) as uow:
        uow.jobs.claim(limit=3, now=START)
        uow.jobs.finish("job_0", DONE, LATER)
        assert uow.jobs.count(QUEUED, RUNNING) == 3
        assert uow.jobs.requeue_running() == 2
        assert uow.jobs.count(RUNNING) == 0
        assert uow.jobs.get("job_1") == replace(queued_job("job_1", key="1"), attempts=1)
        assert [job.id for job in uow.jobs.claim(limit=9, now=LATER)] == ["job_1", "job_2", "job_3"]


def test_job_lists_filter(database: Database) -> None:
    write(
        database,
        lambda uow: uow.jobs.add(queued_job("job_1", key="a")),
        lambda uow: uow.jobs.add(queued_job("job_2", key="b")),
        lambda uow: uow.jobs.add(queued_job("job_3", key="lvl", kind=JobKind.BUILD_MAP)),
        lambda uow: uow.jobs.claim(limit=1, now=START),
    )
    with database() as uow:

        def listed(*kinds: JobKind, state: JobState | None = None) -> list[str]:
            return ids(uow.jobs.list(kinds=kinds, state=state, cursor=None, limit=9))

        assert listed() == ["job_3", "job_2", "job_1"]
        assert listed(JobKind.BUILD_MAP) == ["job_3"]
        assert listed(JobKind.BUILD_MAP, JobKind.LOCATE_SEGMENT) == ["job_3", "job_2", "job_1"]
        assert listed(state=RUNNING) == ["job_1"]
        assert listed(JobKind.LOCATE_SEGMENT, state=QUEUED) == ["job_2"]


def test_keys(database: Database) -> None:
    key = ApiKey("key_1", "phone", frozenset({Scope.LOCATE, Scope.SURVEY}), START, None, None)
    write(database, lambda uow: uow.keys.add(key, "a" * 64))
    with database(write=True) as uow:
        assert uow.keys.find("a" * 64) == key
        assert uow.keys.find("b" * 64) is None
        uow.keys.touch("key_1", LATER)
        assert uow.keys.get("key_1") == replace(key, last_used_at=LATER)
        revoked = uow.keys.revoke("key_1", LATER)
        assert revoked.revoked_at == LATER
        assert uow.keys.revoke("key_1", LATER + timedelta(hours=1)) == revoked
        assert uow.keys.list(cursor=None, limit=9) == Page((revoked,), None)
        assert uow.keys.count() == 1


def test_two_keys_cannot_have_one_secret(database: Database) -> None:
    key = ApiKey("key_1", "phone", frozenset({Scope.LOCATE}), START, None, None)
    write(database, lambda uow: uow.keys.add(key, "a" * 64))
    with pytest.raises(IntegrityError):
        write(database, lambda uow: uow.keys.add(replace(key, id="key_2"), "a" * 64))


def test_idempotency_keys_are_kept_for_a_day(database: Database) -> None:
    write(database, lambda uow: uow.idempotency.add("key_1", "abc", "h" * 64, "ven_1", START))
    with database(write=True) as uow:
        assert uow.idempotency.find("key_1", "abc") == ("h" * 64, "ven_1")
        assert uow.idempotency.find("key_2", "abc") is None
        uow.idempotency.add("key_1", "def", "i" * 64, "ven_2", START + timedelta(hours=23))
        assert uow.idempotency.find("key_1", "abc") is not None
        uow.idempotency.add("key_1", "ghi", "j" * 64, "ven_3", START + timedelta(hours=25))
        assert uow.idempotency.find("key_1", "abc") is None
        assert uow.idempotency.find("key_1", "def") is not None


def test_stats_count_what_is_there(database: Database) -> None:
    write(database, add_session, lambda uow: uow.surveys.add(Survey("srv_1", "lvl_1", "first", 0, START)))
    write(database, lambda uow: uow.surveys.add_walk(walk(), new_walk()))
    write(database, lambda uow: uow.sessions.add(session("ses_2")), lambda uow: uow.sessions.close("ses_2", LATER))
    write(database, *(lambda uow, seq=seq: add_segment(uow, seq) for seq in range(3)))
    state = TrackerState("particle", b"", None)
    write(
        database,
        lambda uow: uow.jobs.claim(limit=1, now=START),
        lambda uow: uow.sessions.record_result("ses_1", 0, state, [fix(), fix()], LATER),
    )
    with database() as uow:
        stats = uow.stats()
    counts = (stats.venues, stats.levels, stats.surveys, stats.walks, stats.maps, stats.segments, stats.fixes)
    assert counts == (1, 1, 1, 1, 1, 3, 2)
    assert (stats.sessions_open, stats.sessions) == (1, 2)
    assert stats.jobs_by_state == {QUEUED: 2, RUNNING: 1, DONE: 0, FAILED: 0, CANCELLED: 0}
