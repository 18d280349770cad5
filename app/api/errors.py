"""Problems: every error an answer can carry, in one table (RFC 9457).

::

    ApiError
    ├── UnauthorizedError       no key, or one that is not known
    ├── RateLimitedError        the key asks too often
    ├── MalformedBodyError      not JSON, msgpack or gzip at all
    ├── BodyTooLargeError
    ├── MediaTypeError          a content type or encoding that is not taken
    ├── RejectedError           fields that cannot be accepted: each with its remedy
    ├── IdempotencyReuseError   the same ``Idempotency-Key`` with another request
    ├── NoAnchorError           WGS 84 is asked for, and the venue has no anchor
    └── NotReadyError           a part of the service does not work

Services and engine raise their own errors; :data:`PROBLEM_OF` says what each becomes. ``docs/api.md`` lists every
problem; a test keeps the two in step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from app.api.validation import FieldError, field_errors
from app.engine.errors import InputError, MapError, StateError
from app.services import errors as service
from app.services.ports import WorkerLostError

PROBLEM_JSON = "application/problem+json"
TYPE_BASE = "https://isodyn.dev/problems/"
_SECRET = re.compile(r"\bis[ik]_[\w-]+")
"""Push addresses hold one; an answer that is kept somewhere must not."""
MAX_ERRORS = 20
"""An answer names so many fields, and how many more there are."""


@dataclass(frozen=True, slots=True)
class ProblemType:
    """A stable sort of problem: the end of its type URI, its status and title."""

    slug: str
    status: int
    title: str

    @property
    def uri(self) -> str:
        """The ``type`` member."""
        return TYPE_BASE + self.slug


MALFORMED_BODY = ProblemType("malformed-body", 400, "The body cannot be read")
UNAUTHORIZED = ProblemType("unauthorized", 401, "A valid API key is needed")
FORBIDDEN = ProblemType("forbidden", 403, "The key lacks a scope")
NOT_FOUND = ProblemType("not-found", 404, "There is no such thing")
METHOD_NOT_ALLOWED = ProblemType("method-not-allowed", 405, "The path does not take this method")
CONFLICT = ProblemType("conflict", 409, "The request contradicts what is stored")
SEQUENCE_CONFLICT = ProblemType("sequence-conflict", 409, "The segment number was used with other content")
SEQUENCE_GAP = ProblemType("sequence-gap", 409, "An earlier segment is missing")
SESSION_CLOSED = ProblemType("session-closed", 409, "The session is closed")
NO_MAP = ProblemType("no-map", 409, "There is no map")
NO_ANCHOR = ProblemType("no-anchor", 409, "The venue has no anchor")
BODY_TOO_LARGE = ProblemType("body-too-large", 413, "The body is too large")
UNSUPPORTED_MEDIA_TYPE = ProblemType("unsupported-media-type", 415, "The body's format is not taken")
INVALID = ProblemType("invalid", 422, "A value cannot be accepted")
IDEMPOTENCY_REUSE = ProblemType("idempotency-reuse", 422, "The Idempotency-Key was used for another request")
RATE_LIMITED = ProblemType("rate-limited", 429, "Too many requests")
INTERNAL = ProblemType("internal", 500, "The service failed")
OVERLOADED = ProblemType("overloaded", 503, "Too much work is queued")
NOT_READY = ProblemType("not-ready", 503, "The service is not ready")
WORKER_LOST = ProblemType("worker-lost", 503, "The worker died over this request")

PROBLEM_TYPES = (
    MALFORMED_BODY,
    UNAUTHORIZED,
    FORBIDDEN,
    NOT_FOUND,
    METHOD_NOT_ALLOWED,
    CONFLICT,
    SEQUENCE_CONFLICT,
    SEQUENCE_GAP,
    SESSION_CLOSED,
    NO_MAP,
    NO_ANCHOR,
    BODY_TOO_LARGE,
    UNSUPPORTED_MEDIA_TYPE,
    INVALID,
    IDEMPOTENCY_REUSE,
    RATE_LIMITED,
    INTERNAL,
    OVERLOADED,
    NOT_READY,
    WORKER_LOST,
)


class ApiError(Exception):
    """Base of the errors that only HTTP knows; ``headers`` go with the answer."""

    def __init__(self, detail: str, *, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.headers = dict(headers or {})


class UnauthorizedError(ApiError):
    """No key, or one that is not known."""

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"WWW-Authenticate": 'Bearer realm="isodyn"'})


class RateLimitedError(ApiError):
    """The key asks too often."""

    def __init__(self, retry_after_s: int) -> None:
        super().__init__(
            f"this key has used up its requests; retry after {retry_after_s} s",
            headers={"Retry-After": str(retry_after_s)},
        )


class MalformedBodyError(ApiError):
    """The body is not what its content type says."""


class BodyTooLargeError(ApiError):
    """The body is larger than the service takes; nothing more of it is read."""

    def __init__(self, detail: str) -> None:
        # What is left of the body is never read, so the connection cannot carry another request.
        super().__init__(detail, headers={"Connection": "close"})


class MediaTypeError(ApiError):
    """A content type or encoding that is not taken; the headers of RFC 9110 (15.5.16) list those that are."""

    def __init__(self, detail: str, *, accept: str | None = None, accept_encoding: str | None = None) -> None:
        named = {"Accept": accept, "Accept-Encoding": accept_encoding}
        super().__init__(detail, headers={name: value for name, value in named.items() if value is not None})
        self.field = "Content-Type" if accept_encoding is None else "Content-Encoding"
        self.remedy = f"send one of: {accept or accept_encoding}"


class RejectedError(ApiError):
    """Fields that cannot be accepted."""

    def __init__(self, errors: Sequence[FieldError]) -> None:
        super().__init__(summary(errors))
        self.errors = tuple(errors)


class IdempotencyReuseError(ApiError):
    """The same ``Idempotency-Key`` came with another request."""


class NoAnchorError(ApiError):
    """WGS 84 is asked for, and the venue has no anchor."""


class NotReadyError(ApiError):
    """A part of the service does not work; ``parts`` names them."""

    def __init__(self, parts: Sequence[str]) -> None:
        super().__init__(f"not working: {', '.join(parts)}", headers={"Retry-After": "1"})


PROBLEM_OF: Mapping[type[Exception], ProblemType] = {
    UnauthorizedError: UNAUTHORIZED,
    RateLimitedError: RATE_LIMITED,
    MalformedBodyError: MALFORMED_BODY,
    BodyTooLargeError: BODY_TOO_LARGE,
    MediaTypeError: UNSUPPORTED_MEDIA_TYPE,
    RejectedError: INVALID,
    IdempotencyReuseError: IDEMPOTENCY_REUSE,
    NoAnchorError: NO_ANCHOR,
    NotReadyError: NOT_READY,
    service.NotFoundError: NOT_FOUND,
    service.ConflictError: CONFLICT,
    service.SequenceConflictError: SEQUENCE_CONFLICT,
    service.SequenceGapError: SEQUENCE_GAP,
    service.SessionClosedError: SESSION_CLOSED,
    service.UnfitSessionError: CONFLICT,
    service.NoEvidenceError: CONFLICT,
    service.InvalidError: INVALID,
    service.NoMapError: NO_MAP,
    service.ForbiddenError: FORBIDDEN,
    service.OverloadedError: OVERLOADED,
    InputError: INVALID,
    MapError: CONFLICT,
    StateError: CONFLICT,
    WorkerLostError: WORKER_LOST,
    ClientDisconnect: MALFORMED_BODY,
}

FIELD_OF: Mapping[ProblemType, tuple[str, str]] = {
    MALFORMED_BODY: ("body", "send the whole body, as Content-Type and Content-Encoding say"),
    BODY_TOO_LARGE: ("body", "send smaller pieces"),
    UNSUPPORTED_MEDIA_TYPE: ("Content-Type", "send a type that /docs shows for this call"),
    SEQUENCE_CONFLICT: ("seq", "send new samples under the session's next_seq"),
    SEQUENCE_GAP: ("seq", "send the missing segments first"),
    SESSION_CLOSED: ("session_id", "open a new session with POST /v1/sessions"),
    NO_MAP: ("level_id", "upload survey walks and POST /v1/maps"),
    NO_ANCHOR: ("anchor", "set it with PATCH /v1/venues/{venue_id}, or ask for application/json"),
    IDEMPOTENCY_REUSE: ("Idempotency-Key", "send a new one"),
}
"""What is at fault, and the remedy, where the problem itself says it and its error names nothing closer."""

_TYPE_OF_STATUS = {404: NOT_FOUND, 405: METHOD_NOT_ALLOWED, 413: BODY_TOO_LARGE, 415: UNSUPPORTED_MEDIA_TYPE}


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem as it is answered."""

    type: ProblemType
    detail: str
    errors: tuple[FieldError, ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)

    def response(self, instance: str) -> Response:
        """Render for the request path ``instance``."""
        return Response(
            orjson.dumps(self.document(instance)),
            status_code=self.type.status,
            headers=dict(self.headers),
            media_type=PROBLEM_JSON,
        )

    def document(self, instance: str) -> dict[str, Any]:
        """As plain values, for a request of this path."""
        body: dict[str, Any] = {
            "type": self.type.uri,
            "title": self.type.title,
            "status": self.type.status,
            "detail": _cut(self.detail, 1000),
            "instance": instance,
        }
        if self.errors:
            body["errors"] = [_shown(error) for error in self.errors[:MAX_ERRORS]]
            if len(self.errors) > MAX_ERRORS:
                more = FieldError("body", f"and {len(self.errors) - MAX_ERRORS} more", "correct these first")
                body["errors"].append(_shown(more))
        return body


def _shown(error: FieldError) -> dict[str, str]:
    return {"field": _cut(error.field, 200), "message": _cut(error.message, 300), "remedy": error.remedy}


def _cut(text: str, length: int) -> str:
    # Names of unknown fields are the caller's: an answer does not grow with them.
    return text if len(text) <= length else text[: length - 3] + "..."


def summary(errors: Sequence[FieldError]) -> str:
    """One sentence about all: the first, and how many more."""
    if not errors:
        return "the request was refused"
    first = f"{errors[0].field}: {errors[0].message}"
    return first if len(errors) == 1 else f"{first} (and {len(errors) - 1} more)"


def problem_of(error: Exception) -> Problem:
    """Say what an error becomes; one that is not in the table is the service's own failure."""
    if isinstance(error, RequestValidationError):
        errors = field_errors(error.errors())
        return Problem(INVALID, summary(errors), errors)
    if isinstance(error, HTTPException):
        return _of_http_exception(error)
    kind = next((PROBLEM_OF[base] for base in type(error).__mro__ if base in PROBLEM_OF), None)
    if kind is None:
        # The detail of an unforeseen error may hold anything (SQL, paths): it goes to the log, not to the caller.
        return Problem(INTERNAL, "an unexpected error; the log of the service has it")
    detail = str(error) or kind.title
    return Problem(kind, detail, _errors_in(error) or _errors_of(kind, detail), _headers_of(error))


def install(app: FastAPI, allowed_methods: Callable[[str], str]) -> None:
    """Answer every error with a problem body; ``allowed_methods`` says what a path takes."""

    async def handle(request: Request, error: Exception) -> Response:
        problem = problem_of(error)
        if problem.type is METHOD_NOT_ALLOWED:
            problem = replace(problem, headers={"Allow": allowed_methods(request.url.path)})
        return problem.response(_SECRET.sub("...", request.url.path))

    for kind in (*PROBLEM_OF, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, handle)


def _of_http_exception(error: HTTPException) -> Problem:
    kind = _TYPE_OF_STATUS.get(error.status_code, MALFORMED_BODY if error.status_code < 500 else INTERNAL)
    detail = "no such path; /docs lists all" if kind is NOT_FOUND else kind.title
    return Problem(kind, detail, _errors_of(kind, detail), dict(error.headers or {}))


def _errors_in(error: Exception) -> tuple[FieldError, ...]:
    if isinstance(error, RejectedError):
        return error.errors
    if isinstance(error, service.InvalidError | service.UnfitSessionError | service.NoEvidenceError):
        return (FieldError(error.field, error.message, error.remedy),)
    if isinstance(error, InputError):
        return (FieldError(error.field, error.message, "see docs/api.md for what this field takes"),)
    if isinstance(error, MediaTypeError):
        return (FieldError(error.field, str(error), error.remedy),)
    if isinstance(error, service.NoMapError):
        return (FieldError(error.field, str(error), FIELD_OF[NO_MAP][1]),)
    if isinstance(error, service.SequenceGapError):
        return (FieldError("seq", str(error), f"send seq {error.expected} first"),)
    return ()


def _errors_of(kind: ProblemType, detail: str) -> tuple[FieldError, ...]:
    if kind not in FIELD_OF:
        return ()
    field_name, remedy = FIELD_OF[kind]
    return (FieldError(field_name, detail, remedy),)


def _headers_of(error: Exception) -> Mapping[str, str]:
    if isinstance(error, ApiError):
        return error.headers
    if isinstance(error, service.OverloadedError):
        return {"Retry-After": str(max(1, round(error.retry_after_s)))}
    if isinstance(error, WorkerLostError):
        return {"Retry-After": "1"}
    return {}
