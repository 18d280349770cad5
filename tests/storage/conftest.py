from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from app.storage import Database
from tests.support.builders import World

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
        made = Database.at(tmp_path / "isodyn.db")
    elif url := os.environ.get(POSTGRESQL):
        made = Database(url)
        with made.engine.begin() as connection:
            connection.execute(text("DROP SCHEMA public CASCADE"))
            connection.execute(text("CREATE SCHEMA public"))
    else:
        pytest.skip(f"{POSTGRESQL} is not set")
    made.migrate()
    yield made
    made.close()
