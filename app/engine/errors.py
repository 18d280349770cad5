"""Errors of the engine.

::

    EngineError
    ├── InputError            samples or waypoints that cannot be used (names the field)
    ├── MapError              a map that cannot be built or read
    └── StateError            a tracker state of another version, or damaged

They know no HTTP; ``app.api.errors`` maps them to problem types.
"""


class EngineError(Exception):
    """Base of all errors the engine raises on purpose."""


class InputError(EngineError, ValueError):
    """Input that no method can use.

    Parameters
    ----------
    field : str
        Name of the offending field, as the caller knows it (``"mag"``, ``"waypoints.t"``).
    message : str
        What is wrong and what would be right.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(f"{field}: {message}")
        self.field = field
        self.message = message


class MapError(EngineError):
    """A map cannot be built from these walks, or does not fit its header."""


class StateError(EngineError):
    """Tracker state bytes are of another version or damaged."""
