"""``isodyn db`` and local keys on database files."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from tests.cli.conftest import Service, run


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    assert run("db", "migrate", "--data-dir", folder).exit_code == 0
    return folder


def test_migrating_twice_changes_nothing(tmp_path: Path) -> None:
    first = run("db", "migrate", "--data-dir", tmp_path / "new")
    assert "was not there" in first.output
    assert "as it was" in run("db", "migrate", "--data-dir", tmp_path / "new").output


def test_a_whole_database_passes(data_dir: Path) -> None:
    result = run("db", "check", "--data-dir", data_dir)
    assert result.exit_code == 0
    assert "whole" in result.output


def test_a_dangling_reference_is_found(data_dir: Path) -> None:
    with closing(sqlite3.connect(data_dir / "isodyn.db")) as connection, connection:
        connection.execute("PRAGMA foreign_keys=OFF")
        table, column = "surveys", "level_id"
        columns = list(connection.execute(f"PRAGMA table_info({table})"))
        names = ", ".join(row[1] for row in columns)
        values = [f"nowhere-{row[1]}" if "CHAR" in row[2].upper() or "TEXT" in row[2].upper() else 0 for row in columns]
        assert column in names
        connection.execute(f"INSERT INTO {table} ({names}) VALUES ({', '.join('?' * len(values))})", values)
    result = run("db", "check", "--data-dir", data_dir)
    assert result.exit_code == 1
    assert "surveys refers to nothing" in result.output


def test_an_old_schema_is_found(data_dir: Path) -> None:
    with closing(sqlite3.connect(data_dir / "isodyn.db")) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = 'r0000'")
    result = run("db", "check", "--data-dir", data_dir)
    assert result.exit_code == 1
    assert "run isodyn db migrate" in result.output


def test_a_backup_of_a_running_service_is_whole(service: Service, tmp_path: Path) -> None:
    copy = tmp_path / "copy" / "isodyn.db"
    copy.parent.mkdir()
    assert run("db", "backup", copy, "--data-dir", service.data_dir).exit_code == 0
    assert run("db", "check", "--data-dir", copy.parent).exit_code == 0
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT count(*) FROM api_keys").fetchone()[0] >= 1
    assert list(copy.parent.glob("*.part")) == []


def test_a_backup_overwrites_nothing(data_dir: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"
    copy.write_text("precious")
    assert run("db", "backup", copy, "--data-dir", data_dir).exit_code == 1
    assert copy.read_text() == "precious"


@pytest.mark.parametrize("command", [("db", "check"), ("keys", "create", "k", "--local")])
def test_a_wrong_folder_is_named_and_not_filled(command: tuple[str, ...], tmp_path: Path) -> None:
    result = run(*command, "--data-dir", tmp_path / "nowhere")
    assert result.exit_code == 1
    assert "--data-dir" in result.output
    assert not (tmp_path / "nowhere").exists()
