"""Errors of the evaluation.

::

    EvaluationError
    ├── DataSetError          a data-set folder or file that is not in the expected format (names it)
    ├── OptionsError          options that do not fit each other or the data (names the field)
    └── TransportError        the service refused or could not be reached
"""

from __future__ import annotations

from pathlib import Path


class EvaluationError(Exception):
    """Base of the errors the evaluation raises on purpose."""


class DataSetError(EvaluationError):
    """A folder or file is not in the format of the data set."""

    def __init__(self, path: Path, message: str) -> None:
        super().__init__(f"{path}: {message}")
        self.path = path
        self.message = message


class OptionsError(EvaluationError):
    """An option that cannot be honoured."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field
        self.message = message


class TransportError(EvaluationError):
    """A service refused a request or could not be reached.

    ``accepted`` tells whether a segment was stored all the same (and its processing failed): its ``seq`` is used up.
    """

    def __init__(self, message: str, *, accepted: bool = False) -> None:
        super().__init__(message)
        self.accepted = accepted
