"""Zip archives of single layers: written in one go, read within bounds."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from typing import BinaryIO, Self

from app.engine.errors import InputError
from app.exchange.maps.document import Value

METADATA = "metadata.json"
_MAX_FILES = 64
MAX_INFLATED = 128 * 2**20
"""Bytes of all files of an archive together."""
_MAX_METADATA = 256 * 1024
DAMAGED_ZIP = (
    zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError, NotImplementedError, IndexError,
    OverflowError,
)  # fmt: skip
"""What the standard library raises over damaged, encrypted or exotic archives (IndexError: a file without a name,
OverflowError: one that begins beyond all files)."""
_METHODS = frozenset({zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED})
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Time of every file of an archive: equal content gives equal bytes."""


def is_zip(content: bytes) -> bool:
    """Whether bytes begin like an archive with something in it."""
    return content.startswith(b"PK\x03\x04")


class ArchiveWriter:
    """Puts files into an archive, one after the other."""

    def __init__(self, target: BinaryIO, *, compressed: bool = True) -> None:
        self._method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
        self._zip = zipfile.ZipFile(target, "w", self._method)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def add(self, name: str, content: bytes) -> None:
        """Add a file."""
        entry = zipfile.ZipInfo(name, _EPOCH)
        entry.compress_type = self._method
        entry.external_attr = 0o644 << 16
        self._zip.writestr(entry, content, compresslevel=6)

    def add_metadata(self, attributes: Mapping[str, object]) -> None:
        """Add what is known about all files."""
        self.add(METADATA, json.dumps(attributes, indent=2, ensure_ascii=False, default=list).encode())


def read_archive(content: bytes) -> dict[str, bytes]:
    """Files of an archive by name, without folders.

    Raises
    ------
    InputError
        Damaged, encrypted, more than 64 files or 128 MiB inflated.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = [entry for entry in archive.infolist() if not entry.is_dir()]
            if len(entries) > _MAX_FILES or sum(entry.file_size for entry in entries) > MAX_INFLATED:
                raise InputError(
                    "file", f"holds more than {_MAX_FILES} files or {MAX_INFLATED} bytes; send fewer layers"
                )
            return {entry.filename.rpartition("/")[2]: member(archive, entry) for entry in entries}
    except DAMAGED_ZIP as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "file", f"is a damaged archive ({str(error)[:80]}); send a whole, unencrypted zip file"
        ) from error


def member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """A file of an archive, as many bytes as it announces at most."""
    if entry.compress_type not in _METHODS:  # others ask for as much memory as they like
        raise InputError(entry.filename[:80], "is compressed in an uncommon way; send a plain (deflated) zip file")
    with archive.open(entry) as source:
        # the announced size may lie: nothing beyond it is inflated
        return source.read(entry.file_size)


def metadata_of(files: Mapping[str, bytes]) -> dict[str, Value]:
    """What an archive says about all of its files."""
    content = files.get(METADATA, b"{}")
    if len(content) > _MAX_METADATA:
        raise InputError(METADATA, f"has {len(content)} bytes; send at most {_MAX_METADATA}")
    try:
        found = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(METADATA, "is not JSON; correct it or leave it out") from error
    if not isinstance(found, dict):
        raise InputError(METADATA, "is not a JSON object; correct it or leave it out")
    values = {str(name): _value(value) for name, value in found.items()}
    return {name: value for name, value in values.items() if value is not None}


def _value(value: object) -> Value | None:
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, list) and all(type(one) in (int, float) for one in value):
        return tuple(float(one) for one in value)
    return None
