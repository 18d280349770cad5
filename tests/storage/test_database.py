"""Transactions: all or nothing, writers in turn, readers never waiting, busy said in time."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event, text
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from app.services.errors import NotFoundError, OverloadedError, StorageError
from app.services.records import Device
from app.storage import Database
from app.storage.repositories.base import ReadOnlyTransactionError
from tests.support.builders import START

ROOT = Path(__file__).parents[2]


@pytest.fixture
def impatient(tmp_path: Path) -> Iterator[Database]:
    made = Database.at(tmp_path / "isodyn.db", busy_timeout_s=0.05)
    made.migrate()
    yield made
    made.close()


def _device(id_: str) -> Device:
    return Device(id_, "phone", None, START)


def test_an_exception_rolls_everything_back(impatient: Database) -> None:
    def interrupted() -> None:
        with impatient(write=True) as uow:
            uow.devices.add(_device("dev_1"))
            raise KeyError("after the first statement")

    with pytest.raises(KeyError):
        interrupted()
    with impatient() as uow, pytest.raises(NotFoundError):
        uow.devices.get("dev_1")


def test_a_reading_transaction_refuses_to_write(impatient: Database) -> None:
    with impatient() as uow, pytest.raises(ReadOnlyTransactionError):
        uow.devices.add(_device("dev_1"))


def test_a_reader_sees_one_moment_while_a_writer_commits(impatient: Database) -> None:
    with impatient() as reader:
        assert reader.stats().venues == 0  # the moment is that of the first read
        with impatient(write=True) as writer:
            writer.devices.add(_device("dev_1"))
        with pytest.raises(NotFoundError):
            reader.devices.get("dev_1")
    with impatient() as later:
        assert later.devices.get("dev_1") == _device("dev_1")


def test_a_second_writer_of_this_process_gives_up_in_time(impatient: Database) -> None:
    with impatient(write=True), pytest.raises(OverloadedError), impatient(write=True):
        pytest.fail("two writers at once")
    with impatient(write=True) as uow:
        uow.devices.add(_device("dev_1"))


def test_a_second_writer_of_another_process_gives_up_in_time(impatient: Database, tmp_path: Path) -> None:
    other = Database.at(tmp_path / "isodyn.db", busy_timeout_s=0.05)  # has its own lock, as another process has
    with impatient(write=True), pytest.raises(OverloadedError), other(write=True):
        pytest.fail("two writers at once")
    with other(write=True) as uow:
        uow.devices.add(_device("dev_1"))
    other.close()


@pytest.mark.parametrize(("power_safe", "level"), [(False, 1), (True, 2)])
def test_connections_are_set_up(tmp_path: Path, power_safe: bool, level: int) -> None:
    database = Database.at(tmp_path / "new" / "x.db", power_safe=power_safe)
    with database.engine.connect() as connection:

        def pragma(name: str) -> object:
            return connection.execute(text(f"PRAGMA {name}")).scalar_one()

        assert pragma("journal_mode") == "wal"
        assert pragma("synchronous") == level
        assert pragma("foreign_keys") == 1
        assert pragma("busy_timeout") == 10_000
    database.close()


def test_foreign_keys_hold(impatient: Database) -> None:
    def orphan() -> None:
        with impatient(write=True) as uow:
            uow.levels.set_plan_image("lvl_none", b"", START)

    with pytest.raises(NotFoundError):
        orphan()
    with pytest.raises(IntegrityError), impatient.engine.begin() as connection:
        connection.execute(text("INSERT INTO level_plans VALUES ('lvl_none', 'image', x'00')"))


def test_ping(tmp_path: Path) -> None:
    database = Database.at(tmp_path / "x.db")
    assert database.ping()
    database.close()
    unreachable = Database(f"sqlite:///{tmp_path}/no/such/folder/x.db")
    assert not unreachable.ping()
    unreachable.close()


def test_what_was_committed_survives_kill_9(tmp_path: Path) -> None:
    script = (
        "import sys, itertools; from pathlib import Path\n"
        "from app.storage import Database; from app.services.records import Device\n"
        "from tests.support.builders import START\n"
        "database = Database.at(Path(sys.argv[1])); database.migrate()\n"
        "for i in itertools.count():\n"
        "    with database(write=True) as uow:\n"
        "        uow.devices.add(Device(f'dev_{i:09d}', 'phone', None, START))\n"
        "    print(i, flush=True)\n"
    )
    path = tmp_path / "killed.db"
    command = [sys.executable, "-c", script, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as child:
        assert child.stdout is not None
        for _ in range(20):
            acknowledged = int(child.stdout.readline())
        child.kill()
        rest = child.stdout.read().split()
    acknowledged = max([acknowledged, *map(int, rest[:-1])])
    database = Database.at(path)
    with database() as uow:
        for i in range(acknowledged + 1):
            assert uow.devices.get(f"dev_{i:09d}").name == "phone"
    database.close()


def test_a_full_disk_is_said_as_such_and_nothing_is_stored(tmp_path: Path) -> None:
    database = Database.at(tmp_path / "isodyn.db")
    try:
        database.migrate()
        database.close()  # connections made from here on meet the limit

        @event.listens_for(database.engine, "connect")
        def limit(connection: Any, _record: Any) -> None:
            connection.execute("PRAGMA max_page_count=1")  # SQLite takes the present size instead

        def fill() -> None:
            with database(write=True) as uow:
                for i in range(2000):
                    uow.devices.add(Device(f"dev_{i:026x}", "x" * 500, None, START))

        with pytest.raises(StorageError):
            fill()
        with database() as uow:
            assert uow.devices.list(cursor=None, limit=10).items == ()
    finally:
        database.close()


def test_an_error_does_not_carry_the_rows_into_the_log(tmp_path: Path) -> None:
    database = Database.at(tmp_path / "isodyn.db")
    try:
        with pytest.raises(SQLAlchemyError) as error, database.engine.connect() as connection:
            connection.execute(text("INSERT INTO nowhere VALUES (:secret)"), {"secret": "12.345678"})
        assert "12.345678" not in str(error.value)
    finally:
        database.close()
