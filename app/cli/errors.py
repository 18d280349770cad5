"""Errors of the command line.

::

    CommandError
    ├── InputFileError     a file that cannot be read as what it should be (names it)
    ├── SettingsError      settings that do not fit (names them)
    └── StartError         the service did not come up (carries what it said)
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


class CommandError(Exception):
    """Base of the errors a command reports itself."""


class InputFileError(CommandError):
    """A file that is not what it should be."""

    def __init__(self, path: Path, message: str) -> None:
        super().__init__(f"{path}: {message}")
        self.path = path


class SettingsError(CommandError):
    """Settings that do not fit: pairs of name and reason."""

    def __init__(self, faults: Sequence[tuple[str, str]]) -> None:
        super().__init__("; ".join(f"ISODYN_{name.upper()}: {reason}" for name, reason in faults))


class StartError(CommandError):
    """The service did not come up."""
