"""What a file of a phone holds, whichever application wrote it; and archives of files, read within bounds."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from app.engine.errors import InputError
from app.exchange.maps.archive import DAMAGED_ZIP, member
from app.exchange.maps.text import lines_of
from app.exchange.phones.assembly import PhoneFrame
from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import Readings

MAX_ROWS = 3_000_000
"""Of one file: two hours of four sensors at 100 Hz."""
MAX_INFLATED = 256 * 2**20
"""Bytes of all tables of an archive together."""
MAX_FILES = 1000
MAX_CELLS = 200
MAX_LINE = 64 * 1024
_DELIMITERS = (",", ";", "\t", "|")


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording.

    Attributes
    ----------
    readings : Readings
    frame : PhoneFrame or None
        Signs of the readings; None where the file does not tell.
    ignored : tuple of str
        Sensors and files in it that are not taken.
    dropped : int
        Rows without a value, or with one that no sensor reads.
    assumed : tuple of str
        In words.
    """

    readings: Readings
    frame: PhoneFrame | None = None
    ignored: tuple[str, ...] = ()
    dropped: int = 0
    assumed: tuple[str, ...] = ()


def is_zip(content: bytes) -> bool:
    """Whether bytes begin like an archive with something in it."""
    return content.startswith(b"PK\x03\x04")


@dataclass
class Archive:
    """The tables (CSV files) of a zip file, by path; other files (sound, pictures) are passed over unread."""

    content: bytes
    others: list[str] = field(default_factory=list)

    def tables(self) -> Iterator[tuple[PurePosixPath, bytes]]:
        """Path and content of each table.

        Raises
        ------
        FormatError
            Damaged, encrypted, more than 1000 files or 256 MiB of tables.
        """
        try:
            with zipfile.ZipFile(io.BytesIO(self.content)) as archive:
                entries = [entry for entry in archive.infolist() if not entry.is_dir()]
                tables = [entry for entry in entries if entry.filename.lower().endswith(".csv")]
                self.others = [entry.filename[:80] for entry in entries if entry not in tables][:20]
                if len(entries) > MAX_FILES or sum(entry.file_size for entry in tables) > MAX_INFLATED:
                    raise FormatError("file", f"holds more than {MAX_FILES} files or {MAX_INFLATED} bytes of tables")
                for entry in tables:
                    yield PurePosixPath(entry.filename), member(archive, entry)
        except DAMAGED_ZIP as error:
            if isinstance(error, InputError):
                raise
            raise FormatError(
                "file", f"is a damaged archive ({str(error)[:80]}); export the recording again"
            ) from error


@dataclass(frozen=True, slots=True)
class Table:
    """A CSV file: names of its columns, and its rows with their line numbers; never a second time in memory."""

    name: str
    header: tuple[str, ...]
    delimiter: str
    content: bytes

    @classmethod
    def of(cls, name: str, content: bytes) -> Table | None:
        """Read the header; None for a file without one."""
        _, first = next(lines_of(io.BytesIO(content), longest=MAX_LINE), (0, ""))
        if not first.strip():
            return None
        # units in quoted labels may hold any of the separators
        bare = "".join(part for i, part in enumerate(first.split('"')) if i % 2 == 0) or first
        delimiter = max(_DELIMITERS, key=bare.count)
        header = next(_cells(content, delimiter, name))
        if len(header) > MAX_CELLS:
            raise FormatError(name, f"has {len(header)} columns; at most {MAX_CELLS} are read")
        return cls(name, tuple(one.strip() for one in header), delimiter, content)

    def label(self, place: int) -> str:
        """What a column is called, for an error."""
        return self.header[place][:40] if place < len(self.header) else f"column {place + 1}"

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line number and cells of each row below the header; of empty lines no cells."""
        cells = _cells(self.content, self.delimiter, self.name)
        next(cells, None)
        yield from enumerate(cells, start=2)


def _cells(content: bytes, delimiter: str, name: str) -> Iterator[list[str]]:
    lines = (f"{line}\n" for _, line in lines_of(io.BytesIO(content), longest=MAX_LINE))
    # strict: a quote that never ends would make the rest of the file one cell
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    while True:
        try:
            row = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise FormatError(f"{name} line {reader.line_num}", f"is no CSV ({error}); export it again") from error
        yield row
