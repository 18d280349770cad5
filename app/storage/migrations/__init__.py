"""Schema migrations (alembic).

:func:`upgrade` runs at every start. A new revision: change ``app.storage.models``, then
``python -m app.storage.migrations --id r0002 "what changes"``; read what it wrote, run the tests.
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from sqlalchemy import Connection


def config_for(connection: Connection) -> Config:
    """Alembic's configuration; there is no ini file."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config


def upgrade(connection: Connection, revision: str = "head") -> bool:
    """Bring the schema to ``revision`` inside the caller's transaction; returns whether it changed."""
    before = _revision_of(connection)
    command.upgrade(config_for(connection), revision)
    return _revision_of(connection) != before


def _revision_of(connection: Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()
