"""Errors of the use cases; they know no HTTP.

::

    ServiceError
    ├── NotFoundError         no such thing (names kind and id)
    ├── ConflictError         the thing exists but its state forbids this
    │   ├── SequenceConflictError   this ``seq`` was sent before with other content
    │   ├── SequenceGapError        an earlier ``seq`` is missing (says which is expected)
    │   ├── SessionClosedError
    │   └── UnfitSessionError       this cannot be done with the session (names the field and the remedy)
    │       ├── NotSmoothableError  it has no smoothed trajectory
    │       └── NotReplayableError  it cannot be replayed on other maps
    │   ├── NoEvidenceError         the map was stored without what it rests on (says how to get it)
    ├── InvalidError          a field that cannot be accepted (names the field and the remedy)
    ├── NoMapError            the level, or no level of the venue, has a map yet (says how to get one)
    ├── ForbiddenError        the key lacks a scope
    └── OverloadedError       queue full: come back after ``retry_after_s``
        └── StorageError          the database cannot be written or read now (full disk, lock, lost connection)
"""


class ServiceError(Exception):
    """Base of the errors services raise on purpose."""


class NotFoundError(ServiceError):
    """No thing of this kind has this id."""

    def __init__(self, kind: str, id_: str) -> None:
        super().__init__(f"no {kind} {id_!r}")
        self.kind = kind
        self.id = id_


class ConflictError(ServiceError):
    """The request contradicts what is stored."""


class SequenceConflictError(ConflictError):
    """A segment number was used before with other content."""

    def __init__(self, seq: int) -> None:
        super().__init__(f"seq {seq} was received before with other content; send new samples under a new seq")
        self.seq = seq


class SequenceGapError(ConflictError):
    """A segment arrived before its predecessor."""

    def __init__(self, seq: int, expected: int) -> None:
        super().__init__(f"seq {seq} cannot be taken yet; send seq {expected} first")
        self.seq = seq
        self.expected = expected


class SessionClosedError(ConflictError):
    """The session takes no more segments."""

    def __init__(self, session_id: str) -> None:
        super().__init__(f"session {session_id} is closed; open a new session")


class UnfitSessionError(ConflictError):
    """What is asked for cannot be done with the session; ``field`` names what of it stands against it."""

    def __init__(self, field: str, message: str, remedy: str) -> None:
        super().__init__(f"{field}: {message}; {remedy}")
        self.field = field
        self.message = message
        self.remedy = remedy


class NotSmoothableError(UnfitSessionError):
    """The session's trajectory cannot be smoothed."""


class NotReplayableError(UnfitSessionError):
    """The session cannot be replayed."""


class NoEvidenceError(ConflictError):
    """The map was stored without the evidence that it rests on, and cannot say where its sources disagree."""

    field = "map_id"
    remedy = "build the level's map again with POST /v1/maps, and ask of the new version"

    def __init__(self, map_id: str) -> None:
        self.message = f"map {map_id} was stored without its evidence"
        super().__init__(f"{self.message}; {self.remedy}")


class InvalidError(ServiceError):
    """A value that cannot be accepted.

    ``field`` is the path in the request (``samples.mag.x``), ``message`` says what is wrong, ``remedy`` what
    would be accepted.
    """

    def __init__(self, field: str, message: str, remedy: str) -> None:
        super().__init__(f"{field}: {message}; {remedy}")
        self.field = field
        self.message = message
        self.remedy = remedy


class NoMapError(ServiceError):
    """A level, or no level of a venue, has a map to match against; ``field`` says which of the two was named."""

    def __init__(self, *, level_id: str | None = None, venue_id: str | None = None) -> None:
        what = f"no level of venue {venue_id} has a map" if level_id is None else f"level {level_id} has no map"
        super().__init__(f"{what}; upload survey walks and POST /v1/maps")
        self.field = "venue_id" if level_id is None else "level_id"


class ForbiddenError(ServiceError):
    """The key is valid but lacks a scope."""

    def __init__(self, scope: str) -> None:
        super().__init__(f"this key lacks the scope {scope!r}")
        self.scope = scope


class OverloadedError(ServiceError):
    """The service has as much work as it accepts."""

    def __init__(self, retry_after_s: float) -> None:
        super().__init__(f"too much work queued; retry after {retry_after_s:.0f} s")
        self.retry_after_s = retry_after_s


class StorageError(OverloadedError):
    """The database does not answer now; nothing was stored."""

    def __init__(self, retry_after_s: float = 5.0) -> None:
        ServiceError.__init__(self, f"the database cannot be used now; retry after {retry_after_s:.0f} s")
        self.retry_after_s = retry_after_s
