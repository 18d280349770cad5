"""Migrating an empty database gives exactly the tables of the models; what was stored before can still be read."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, inspect, text

from app.engine.localization.codec import calibration_from
from app.engine.types import DeviceCalibration, FixKind, Hypothesis, Prior
from app.services.aids import NO_AIDS
from app.services.records import LevelMap
from app.services.search import Near, Search
from app.storage import Database
from app.storage.columns import encode_samples, encode_scans
from app.storage.database import BrokenReferencesError
from app.storage.migrations import config_for, upgrade
from app.storage.models import metadata
from tests.support.builders import samples, scans


@pytest.fixture
def migrated(tmp_path: Path) -> Iterator[Database]:
    database = Database.at(tmp_path / "migrated.db")
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def created(tmp_path: Path) -> Iterator[Database]:
    database = Database.at(tmp_path / "created.db")
    with database.engine.begin() as connection:
        metadata.create_all(connection)
    yield database
    database.close()


def _schema(engine: Engine) -> dict[str, object]:
    inspector = inspect(engine)
    return {
        name: {
            "columns": {c["name"]: (repr(c["type"]), c["nullable"]) for c in inspector.get_columns(name)},
            "primary": inspector.get_pk_constraint(name),
            "foreign": sorted(map(str, inspector.get_foreign_keys(name))),
            "unique": sorted(map(str, inspector.get_unique_constraints(name))),
            "indexes": sorted(map(str, inspector.get_indexes(name))),
            "options": inspector.get_table_options(name),
        }
        for name in inspector.get_table_names()
        if name != "alembic_version"
    }


def test_alembic_finds_no_difference(migrated: Database) -> None:
    with migrated.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []


def test_migrated_and_created_schemas_are_the_same(migrated: Database, created: Database) -> None:
    # alembic does not compare everything (primary keys, table options): the database's own view does
    assert _schema(migrated.engine) == _schema(created.engine)


def test_migrating_again_changes_nothing(migrated: Database) -> None:
    before = _schema(migrated.engine)
    migrated.migrate()
    assert _schema(migrated.engine) == before


def test_revisions_form_one_line(migrated: Database) -> None:
    with migrated.engine.connect() as connection:
        script = ScriptDirectory.from_config(config_for(connection))
    assert len(script.get_heads()) == 1
    assert len(script.get_bases()) == 1


_NOW = "2026-11-22 08:00:00.000000"
_VENUE = f"INSERT INTO venues VALUES ('ven', 'House', 'indoor', NULL, NULL, NULL, NULL, '{_NOW}', '{_NOW}')"
_LEVEL = f"INSERT INTO levels VALUES ('lvl', 'ven', '1', 0, 0, 0, 9, 9, 0, 0, '{_NOW}', '{_NOW}')"
_MAP = f"""INSERT INTO maps VALUES ('map', 'lvl', 1, NULL, 'h', 'hv', 0, 0, 0.5, 2, 2, 1.5, '[1, 1]', 1, 1, 1, 9, 2,
    '[1, 1]', '[]', 1, 0, '{_NOW}')"""
_SESSION = f"""INSERT INTO sessions VALUES ('ses', 'ven', 'lvl', 'map', NULL, 'particle', '{{}}',
    '{{"level_id": "lvl", "x": null, "y": null, "radius_m": 3.0, "heading": null, "heading_sd": 0.35}}',
    'open', 1, '{_NOW}', NULL)"""
_STATE = "INSERT INTO tracker_states VALUES ('ses', 'particle', x'00', 5.0)"
_FIX = """INSERT INTO fixes VALUES ('ses', 0, 0, 1.0, 'lvl', 1, 2, 1, 0, 1, 0, 'ambiguous', 0.5, 0, NULL,
    '[[1.0, 2.0, 1.0, 0.0, 1.0, 0.75]]')"""
"""Rows as they were stored at revision r0002."""


def _at_revision(folder: Path, revision: str) -> Database:
    database = Database.at(folder / "old.db")
    with database.engine.begin() as connection:
        upgrade(connection, revision)
    return database


def test_a_session_of_before_keeps_its_map_its_state_and_its_fixes(tmp_path: Path) -> None:
    database = _at_revision(tmp_path, "r0002")
    with database.engine.begin() as connection:
        for statement in (_VENUE, _LEVEL, _MAP, _SESSION, _STATE, _FIX):
            connection.exec_driver_sql(statement)
    database.migrate()
    with database() as uow:
        session = uow.sessions.get("ses")
        state = uow.sessions.state("ses")
        (position,) = uow.sessions.list_positions("ses", seq=None, cursor=None, limit=9).items
    assert (session.level_id, session.maps, session.prior) == ("lvl", (LevelMap("lvl", "map"),), Prior("lvl"))
    assert state is not None
    assert state.payload == b"\0"
    assert position.fix.hypotheses == (Hypothesis("lvl", 1.0, 2.0, 1.0, 0.0, 1.0, 0.75),)
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1
    database.close()


def test_rows_that_refer_to_none_stop_a_migration(tmp_path: Path) -> None:
    database = _at_revision(tmp_path, "r0002")
    with database.engine.connect() as connection:
        connection.connection.execute("PRAGMA foreign_keys=OFF")
        with connection.begin():
            connection.exec_driver_sql(_LEVEL)
    with pytest.raises(BrokenReferencesError):
        database.migrate()
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar() == "r0002"
    database.close()


_JOB = f"""INSERT INTO jobs VALUES (1, 'job', 'locate_segment', 'queued', 'ses', '{{}}', 0, 0, '', '{{}}',
    NULL, '{_NOW}', NULL, NULL)"""
_SEGMENT = f"INSERT INTO segments VALUES ('ses', 0, 'h', 250, 0, 5, 'job', NULL, NULL, NULL, '{_NOW}', NULL)"


def test_a_session_of_before_has_no_aids_and_taught_nothing(tmp_path: Path) -> None:
    database = _at_revision(tmp_path, "r0002")
    with database.engine.begin() as connection:
        for statement in (_VENUE, _LEVEL, _MAP, _SESSION, _STATE, _JOB, _SEGMENT):
            connection.exec_driver_sql(statement)
        connection.execute(
            text("INSERT INTO segment_samples VALUES ('ses', 0, :samples, :wifi)"),
            {"samples": encode_samples(samples()), "wifi": encode_scans(scans())},
        )
    database.migrate()
    with database() as uow:
        session = uow.sessions.get("ses")
        assert (session.calibration_epoch, session.prior.calibration) == ("", None)
        assert uow.sessions.learned("ses") is None
        recording = uow.sessions.load_segment("ses", 0)
        assert recording.aids.wifi is not None
        assert replace(recording.aids, wifi=None) == NO_AIDS
    database.close()


def test_a_device_of_before_is_remembered_without_soft_iron(tmp_path: Path) -> None:
    """As is what its open sessions learned; going back keeps the rest."""
    database = _at_revision(tmp_path, "r0007")
    learned = '{"offset": [1, 2, 3], "offset_sd": [2, 2, 2], "stride_scale": 1.1, "stride_scale_sd": 0.05}'
    with database.engine.begin() as connection:
        connection.exec_driver_sql(f"INSERT INTO devices VALUES ('dev', 'phone', NULL, '{_NOW}')")
        connection.exec_driver_sql(
            f"INSERT INTO device_calibrations VALUES ('dev', '', 1, 2, 3, 2, 2, 2, 1.1, 0.05, 4, '{_NOW}')"
        )
    database.migrate()
    expected = DeviceCalibration((1.0, 2.0, 3.0), (2.0, 2.0, 2.0), 1.1, 0.05)
    with database() as uow:
        (memory,) = uow.devices.memories("dev")
    assert memory.calibration == expected == calibration_from(json.loads(learned))
    with database.engine.begin() as connection:
        command.downgrade(config_for(connection), "r0007")
    database.migrate()
    with database() as uow:
        assert uow.devices.memories("dev") == (memory,)
    database.close()


def test_segments_of_before_told_nothing_later_and_the_way_back_keeps_them(tmp_path: Path) -> None:
    database = _at_revision(tmp_path, "r0002")
    done = _SEGMENT.replace("NULL, NULL, NULL", "NULL, 0, 1").replace("NULL)", f"'{_NOW}')")
    with database.engine.begin() as connection:
        for statement in (_VENUE, _LEVEL, _MAP, _SESSION, _JOB, done, _FIX):
            connection.exec_driver_sql(statement)
    database.migrate()
    with database() as uow:
        result = uow.sessions.get_result("ses", 0)
        later = uow.sessions.list_positions("ses", seq=0, cursor=None, limit=9, kind=FixKind.FIXED_LAG)
    assert ([fix.x for fix in result.fixes], result.lagged, later.items) == ([1.0], (), ())
    with database.engine.begin() as connection:
        command.downgrade(config_for(connection), "r0006")
    assert "lagged_fixes" not in inspect(database.engine).get_table_names()
    assert not {"first_lagged", "n_lagged"} & {c["name"] for c in inspect(database.engine).get_columns("segments")}
    database.migrate()
    with database() as uow:
        assert uow.sessions.get_result("ses", 0) == result
    database.close()


def test_builds_of_before_are_published_and_their_maps_are_known(tmp_path: Path) -> None:
    """As far as their jobs tell; the log begins empty. Going back forgets it."""
    database = _at_revision(tmp_path, "r0002")
    settings = json.dumps({"features": "hv", "cell_m": 0.5, "mapped_m": 1.5, "extent": None})
    with database.engine.begin() as connection:
        for statement in (_VENUE, _LEVEL, _MAP, _JOB):
            connection.exec_driver_sql(statement)
        connection.execute(text("UPDATE jobs SET result = :result"), {"result": json.dumps({"map_id": "map"})})
        connection.execute(
            text("INSERT INTO map_builds (job_id, level_id, settings, survey_ids) VALUES ('job', 'lvl', :told, '[]')"),
            {"told": settings},
        )
    for _ in range(2):
        database.migrate()
        with database() as uow:
            build = uow.maps.build_of("map")
            assert build is not None
            assert (build.publish, build.key_id, build.settings.cell_m) == (True, None, 0.5)
            assert uow.publications.latest("lvl") is None
        with database.engine.begin() as connection:
            command.downgrade(config_for(connection), "r0011")
        assert "publications" not in inspect(database.engine).get_table_names()


def test_places_and_models_of_before_are_found(tmp_path: Path) -> None:
    database = _at_revision(tmp_path, "r0010")
    memory = f"'bias', 1, 2, 3, 2, 2, 2, 1.1, 0.05, 4, '{_NOW}', NULL"
    with database.engine.begin() as connection:
        connection.exec_driver_sql(
            f"INSERT INTO venues VALUES ('ven', 'Old Mall', 'indoor', 48.0, 11.0, 30.0, 0.0, '{_NOW}', '{_NOW}')"
        )
        connection.exec_driver_sql(_VENUE.replace("'ven'", "'ven_nowhere'"))
        connection.exec_driver_sql(_LEVEL)
        connection.exec_driver_sql(f"INSERT INTO devices VALUES ('dev', 'phone', 'M1', '{_NOW}')")
        connection.exec_driver_sql(f"INSERT INTO device_calibrations VALUES ('dev', {memory})")
    database.migrate()
    with database() as uow:
        for search in (Search(near=Near(48.0, 11.0, 50.0)), Search(words=("old", "mal"))):
            assert [one.item.id for one in uow.venues.find(search, cursor=None, limit=9).items] == ["ven"]
            assert [one.item.id for one in uow.levels.find(search, venue_id=None, cursor=None, limit=9).items] == [
                "lvl"
            ]
        assert [known.offset for known in uow.device_models.memories("M1", limit=9)] == [(1.0, 2.0, 3.0)]
        assert uow.device_models.get("M1").n_devices == 1
    with database.engine.begin() as connection:
        command.downgrade(config_for(connection), "r0010")
    assert "name_words" not in inspect(database.engine).get_table_names()
    database.migrate()
    with database() as uow:
        assert len(uow.levels.find(Search(near=Near(48.0, 11.0)), venue_id=None, cursor=None, limit=9).items) == 1
    database.close()
