"""Migrating an empty database gives exactly the tables of the models."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, inspect

from app.storage import Database
from app.storage.migrations import config_for
from app.storage.models import metadata


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
