"""``isodyn db``: the SQLite file of a service."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import FAILED, NAMED, reported

if TYPE_CHECKING:
    from app.storage.database import Database

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Migrate, check and back up the database file.")

DataDir = Annotated[
    Path | None, typer.Option(help="Data directory of the service.", show_default="ISODYN_DATA_DIR or data")
]


@app.command("migrate")
@reported
def migrate(data_dir: DataDir = None) -> None:
    """Bring the schema up to date (the service does so itself at every start).

    Example:  isodyn db migrate --data-dir data
    """
    path = database_path(data_dir)
    before = _revision(path) if path.is_file() else None
    with opened(data_dir, must_exist=False):
        pass
    after = _revision(path)
    typer.echo(f"{path}: {after}" + (" (as it was)" if before == after else f" (was {before or 'not there'})"))


@app.command("check")
@reported
def check(data_dir: DataDir = None) -> None:
    """Check the file's integrity, its references and its schema; exit status 1 if something is wrong.

    Works while the service runs.

    Example:  isodyn db check --data-dir data
    """
    path = _existing(data_dir)
    with closing(_read_only(path)) as connection:
        findings = [str(row[0]) for row in connection.execute("PRAGMA integrity_check") if row[0] != "ok"]
        findings += [
            f"row {row[1]} of {row[0]} refers to nothing" for row in connection.execute("PRAGMA foreign_key_check")
        ]
    revision, head = _revision(path), _head()
    if revision != head:
        findings.append(f"schema is at {revision or 'no revision'}, this program needs {head}: run isodyn db migrate")
    for finding in findings:
        typer.secho(finding, fg=typer.colors.RED, err=True)
    if findings:
        raise typer.Exit(FAILED)
    typer.echo(f"{path}: whole, schema {revision}, {path.stat().st_size / 2**20:.1f} MiB")


@app.command("backup")
@reported
def backup(
    file: Annotated[Path, typer.Argument(help="The copy to write; must not exist yet.")], data_dir: DataDir = None
) -> None:
    """Copy the database to one file, consistently, also while the service runs.

    To restore: stop the service, put the copy in place of isodyn.db, delete isodyn.db-wal and isodyn.db-shm.

    Example:  isodyn db backup isodyn-2026-11-22.db
    """
    from app.cli.errors import InputFileError

    path = _existing(data_dir)
    if file.exists():
        raise InputFileError(file, "is there already; name a new file")
    partial = file.with_name(file.name + ".part")
    with closing(_read_only(path)) as source, closing(sqlite3.connect(partial)) as target:
        source.backup(target)
    partial.replace(file)
    typer.echo(f"{file}: {file.stat().st_size / 2**20:.1f} MiB")


def database_path(data_dir: Path | None) -> Path:
    """The database file of a data directory (None: that of the settings)."""
    from app.settings import Settings

    return (Settings(data_dir=data_dir) if data_dir else Settings()).database_path


@contextmanager
def opened(data_dir: Path | None, *, must_exist: bool = True) -> Iterator[Database]:
    """The database of a data directory, migrated."""
    from app.storage.database import Database

    database = Database.at(_existing(data_dir) if must_exist else database_path(data_dir))
    try:
        database.migrate()
        yield database
    finally:
        database.close()


def _existing(data_dir: Path | None) -> Path:
    from app.cli.errors import InputFileError

    path = database_path(data_dir)
    if not path.is_file():
        raise InputFileError(path, "is not there; name the service's folder with --data-dir")
    return path


def _read_only(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)


def _revision(path: Path) -> str | None:
    with closing(_read_only(path)) as connection:
        try:
            row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
        except sqlite3.OperationalError:  # no such table: never migrated
            return None
    return str(row[0]) if row else None


def _head() -> str | None:
    from alembic.config import Config
    from alembic.script import ScriptDirectory

    from app.storage import migrations

    config = Config()
    config.set_main_option("script_location", str(Path(migrations.__path__[0])))
    config.set_main_option("path_separator", "os")
    return ScriptDirectory.from_config(config).get_current_head()
