"""Write a new revision from the difference between the models and the migrated schema."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from alembic import command

from app.storage.database import Database
from app.storage.migrations import config_for


def main() -> None:
    """Migrate an empty database to the newest revision and write the next one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("message", help="what the revision changes")
    parser.add_argument("--id", required=True, help="identifier of the revision: r0002, r0003, ...")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        database = Database.at(Path(folder) / "empty.db")
        database.migrate()
        with database.engine.begin() as connection:
            command.revision(config_for(connection), arguments.message, autogenerate=True, rev_id=arguments.id)
        database.close()


if __name__ == "__main__":
    main()
