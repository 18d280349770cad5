from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from app.storage import Database
from tests.support.builders import World, database_at
from tests.support.locks import between_processes

POSTGRESQL = "ISODYN_TEST_POSTGRESQL"
"""URL of an empty PostgreSQL database; without it the contract suite runs on SQLite only."""


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    made = World.at(tmp_path)
    yield made
    made.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """An empty, migrated database of each kind at hand."""
    if request.param == "sqlite":
        made = database_at(tmp_path / "isodyn.db")
        yield made
        made.close()
    elif url := os.environ.get(POSTGRESQL):
        with between_processes(Path(tempfile.gettempdir()) / "isodyn-postgresql.lock"):  # one database for all tests
            yield from _emptied(url)
    else:
        pytest.skip(f"{POSTGRESQL} is not set")


def _emptied(url: str) -> Iterator[Database]:
    made = Database(url)
    with made.engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    made.migrate()
    yield made
    made.close()
