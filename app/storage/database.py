"""The database: engine set-up and units of work.

Everything that concerns SQLite alone is here. It runs in WAL mode: readers never wait, writers queue. One process
lets its own writers queue at a lock, in which threads sleep and are woken; SQLite's own waiting polls with growing
pauses of up to 100 ms and is left to writers of *other* processes (``isodyn keys`` while the service runs).
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Connection, Engine, create_engine, event, select
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import OperationalError, SQLAlchemyError

from app.services.errors import OverloadedError, StorageError
from app.storage.migrations import upgrade
from app.storage.unit_of_work import SqlUnitOfWork

_log = structlog.get_logger(__name__)
_WRITE_OPTION = "isodyn_write"
_POOL_SIZE = 16
_POOL_OVERFLOW = 48  # the web server's thread pool and the runner may all be inside a transaction
_RETRY_AFTER_S = 1.0
_CACHE_KIB = 4 * 1024  # of each connection


class BrokenReferencesError(RuntimeError):
    """A migration would leave rows that refer to none; nothing is changed."""


class Database:
    """An open database; called, it opens a transaction (the port ``UnitOfWorkFactory``).

    Parameters
    ----------
    url : str
        SQLAlchemy URL. See :meth:`at` for a SQLite file.
    power_safe : bool
        Commits survive a loss of power (``synchronous=FULL``), at about twice the price of a commit. Without it
        they survive the death of any process, and after a loss of power the database is intact but may lack the
        last moments.
    busy_timeout_s : float
        How long a writer waits for another before it gives up with ``OverloadedError``.
    """

    def __init__(self, url: str, *, power_safe: bool = False, busy_timeout_s: float = 10.0) -> None:
        self._busy_timeout_s = busy_timeout_s
        self._write_lock = threading.Lock()
        self.engine = create_engine(
            url,
            pool_size=_POOL_SIZE,
            max_overflow=_POOL_OVERFLOW,
            hide_parameters=True,  # errors go to the log; positions must not
        )
        self._is_sqlite = self.engine.dialect.name == "sqlite"
        if self._is_sqlite:
            _set_up_sqlite(self.engine, power_safe=power_safe, busy_timeout_s=busy_timeout_s)

    @classmethod
    def at(cls, path: Path, *, power_safe: bool = False, busy_timeout_s: float = 10.0) -> Database:
        """Open (and create, if missing) the SQLite file ``path``."""
        path.parent.mkdir(parents=True, exist_ok=True)
        return cls(f"sqlite:///{path}", power_safe=power_safe, busy_timeout_s=busy_timeout_s)

    def migrate(self) -> None:
        """Bring the schema up to date, in one transaction.

        SQLite alters a table by building it anew. Rows that refer to it would lose their hold in between, so references
        are checked at the end instead.
        """
        with self._transaction(write=True, check_references=False) as connection:
            changed = upgrade(connection)
            if changed and self._is_sqlite and _has_broken_references(connection):
                raise BrokenReferencesError("rows refer to others that are not there; the schema stays as it was")

    def ping(self) -> bool:
        """Whether the database answers."""
        try:
            with self.engine.connect() as connection:
                connection.execute(select(1)).one()
        except SQLAlchemyError:
            return False
        return True

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

    @contextmanager
    def __call__(self, *, write: bool = False) -> Iterator[SqlUnitOfWork]:
        """One transaction: commits on normal exit, rolls back on an exception."""
        with self._transaction(write=write) as connection:
            yield SqlUnitOfWork(connection, writable=write)

    @contextmanager
    def _transaction(self, *, write: bool, check_references: bool = True) -> Iterator[Connection]:
        try:
            with self._turn(write=write), self.engine.connect() as connection:
                connection.execution_options(**{_WRITE_OPTION: write})
                unchecked = self._is_sqlite and not check_references
                with _references_unchecked(connection) if unchecked else nullcontext(), _begin(connection):
                    yield connection
        except OperationalError as error:
            # a full disk, a lost connection: passing trouble, which no caller can mend but by trying again
            _log.warning("database trouble", error=str(error.orig))
            raise StorageError from error

    @contextmanager
    def _turn(self, *, write: bool) -> Iterator[None]:
        if not (write and self._is_sqlite):
            yield
            return
        if not self._write_lock.acquire(timeout=self._busy_timeout_s):
            raise OverloadedError(_RETRY_AFTER_S)
        try:
            yield
        finally:
            self._write_lock.release()


@contextmanager
def _references_unchecked(connection: Connection) -> Iterator[None]:
    """Switch SQLite's check of references off around a transaction; inside one the switch does nothing."""
    cursor = connection.connection.cursor()
    cursor.execute("PRAGMA foreign_keys=OFF")
    try:
        yield
    finally:
        cursor.execute("PRAGMA foreign_keys=ON")
        cursor.close()


def _has_broken_references(connection: Connection) -> bool:
    return connection.exec_driver_sql("PRAGMA foreign_key_check").first() is not None


@contextmanager
def _begin(connection: Connection) -> Iterator[None]:
    try:
        transaction = connection.begin()
    except OperationalError as error:
        if _is_busy(error):
            raise OverloadedError(_RETRY_AFTER_S) from error
        raise
    with transaction:
        yield


def _is_busy(error: OperationalError) -> bool:
    # the low byte: there are several ways of being busy
    return (
        isinstance(error.orig, sqlite3.OperationalError) and error.orig.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
    )


def _set_up_sqlite(engine: Engine, *, power_safe: bool, busy_timeout_s: float) -> None:
    synchronous = "FULL" if power_safe else "NORMAL"

    @event.listens_for(engine, "connect")
    def connect(connection: DBAPIConnection, _record: Any) -> None:
        # the driver must not open transactions on its own: it would begin them deferred, and a deferred
        # transaction that turns into a writing one fails at once when another wrote in between
        connection.isolation_level = None
        cursor = connection.cursor()
        for pragma in (
            f"busy_timeout={int(busy_timeout_s * 1000)}",
            "journal_mode=WAL",
            f"synchronous={synchronous}",
            "foreign_keys=ON",
            f"cache_size=-{_CACHE_KIB}",
            "temp_store=MEMORY",
        ):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        write = connection.get_execution_options().get(_WRITE_OPTION, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
