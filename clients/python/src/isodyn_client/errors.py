"""Errors of the client; all of them derive from :class:`IsodynError`.

::

    IsodynError
    ├── ConnectionFailedError        no answer: refused, reset, name unknown
    │   └── RequestTimeoutError      no answer in time
    ├── UnexpectedAnswerError        an answer this client does not understand (a proxy's page, another service)
    ├── ProblemError                 the service said no: status, title, detail, errors (field, message, remedy)
    │   ├── InvalidRequestError      400, 415, 422: a field or a body that cannot be accepted
    │   ├── UnauthorizedError        401: no key, unknown or revoked key
    │   ├── ForbiddenError           403: the key lacks a scope
    │   ├── NotFoundError            404
    │   ├── ConflictError            409: the state of the thing forbids this
    │   │   ├── SequenceConflictError    this ``seq`` was sent before with other samples
    │   │   ├── SequenceGapError         an earlier ``seq`` is missing
    │   │   ├── SessionClosedError
    │   │   ├── NoMapError               the level, or no level of the venue, has a map yet
    │   │   └── NoAnchorError            GeoJSON is asked for, and the venue has no anchor
    │   ├── TooLargeError            413: the body is larger than the service accepts
    │   ├── RateLimitedError         429: too many requests; ``retry_after_s`` says when to come back
    │   └── ServiceFailedError       500 and above: the service's own fault
    │       └── OverloadedError      too much work is queued; ``retry_after_s`` says when to come back
    ├── InvalidSignatureError        a webhook's message is not to be believed (in ``isodyn_client.webhooks``)
    ├── BridgeError                  what a bridge was given cannot work: no anchor, no session of the device
    ├── JobFailedError               a job ended as failed or cancelled (``job`` has the reason)
    └── StillWaitingError            a job or segment was not finished in the time given; it goes on
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import httpx
from pydantic import BaseModel, ConfigDict, ValidationError

if TYPE_CHECKING:
    from isodyn_client.models import Job


class IsodynError(Exception):
    """Base of everything this client raises on purpose."""


class ConnectionFailedError(IsodynError):
    """No answer came: refused, reset or unreachable."""


class RequestTimeoutError(ConnectionFailedError):
    """No answer came in time."""


class UnexpectedAnswerError(IsodynError):
    """An answer that is not the service's: check the address."""


class BridgeError(IsodynError):
    """What a bridge was given cannot work; the message says what to change."""


class JobFailedError(IsodynError):
    """A job ended without its result."""

    def __init__(self, job: Job) -> None:
        super().__init__(f"{job.kind} {job.id} {job.state}: {job.error or 'no reason given'}")
        self.job = job


class StillWaitingError(IsodynError):
    """Not finished in the time given; the service keeps working on it."""


@dataclass(frozen=True, slots=True)
class FieldError:
    """One field that could not be accepted: its path in the request, what is wrong, what would be accepted."""

    field: str
    message: str
    remedy: str

    def __str__(self) -> str:
        text = f"{self.field}: {self.message}" if self.field else self.message
        return f"{text} ({self.remedy})" if self.remedy else text


class ProblemError(IsodynError):
    """The service refused, with RFC 9457 problem details.

    Attributes
    ----------
    status : int
        HTTP status.
    slug : str
        Last part of the problem's ``type``: stable, made for programs.
    title, detail : str
        For people.
    errors : tuple of FieldError
        The fields at fault, when there are any.
    retry_after_s : float or None
        When the service asks to come back, in seconds.
    """

    def __init__(
        self,
        status: int,
        slug: str,
        title: str,
        detail: str = "",
        *,
        errors: tuple[FieldError, ...] = (),
        retry_after_s: float | None = None,
    ) -> None:
        self.status = status
        self.slug = slug
        self.title = title
        self.detail = detail
        self.errors = errors
        self.retry_after_s = retry_after_s
        super().__init__(self._text())

    def _text(self) -> str:
        reasons = "; ".join(str(error) for error in self.errors) or self.detail
        return f"{self.status} {self.title}: {reasons}" if reasons else f"{self.status} {self.title}"

    @property
    def field(self) -> str | None:
        """Path of the first field at fault, or None."""
        return self.errors[0].field if self.errors else None

    @property
    def remedy(self) -> str | None:
        """What would have been accepted instead, or None."""
        return self.errors[0].remedy if self.errors else None


class InvalidRequestError(ProblemError):
    """A field that cannot be accepted; ``errors`` names it and the remedy."""


class UnauthorizedError(ProblemError):
    """No API key, or one that is unknown or revoked."""


class ForbiddenError(ProblemError):
    """The API key lacks a scope."""


class NotFoundError(ProblemError):
    """There is no such thing."""


class ConflictError(ProblemError):
    """The request contradicts what is stored."""


class SequenceConflictError(ConflictError):
    """This ``seq`` was sent before with other samples."""


class SequenceGapError(ConflictError):
    """An earlier ``seq`` has not arrived yet."""


class SessionClosedError(ConflictError):
    """The session takes no more segments."""


class NoMapError(ConflictError):
    """The level, or no level of the venue, has a map yet: upload survey walks and build one."""


class NoAnchorError(ConflictError):
    """WGS 84 is asked for, and the venue has no anchor."""


class TooLargeError(ProblemError):
    """The body is larger than the service accepts."""


class RateLimitedError(ProblemError):
    """Too many requests with this key."""


class ServiceFailedError(ProblemError):
    """The service could not do its part."""


class OverloadedError(ServiceFailedError):
    """More work is queued than the service accepts at once."""


_BY_SLUG: dict[str, type[ProblemError]] = {
    "sequence-conflict": SequenceConflictError,
    "sequence-gap": SequenceGapError,
    "session-closed": SessionClosedError,
    "no-map": NoMapError,
    "no-anchor": NoAnchorError,
    "overloaded": OverloadedError,
}
_BY_STATUS: dict[int, type[ProblemError]] = {
    400: InvalidRequestError,
    401: UnauthorizedError,
    403: ForbiddenError,
    404: NotFoundError,
    409: ConflictError,
    413: TooLargeError,
    415: InvalidRequestError,
    422: InvalidRequestError,
    429: RateLimitedError,
}


class _ProblemField(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    field: str = ""
    message: str = ""
    remedy: str = ""


class _Problem(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    type: str = "about:blank"
    title: str
    detail: str | None = None
    errors: tuple[_ProblemField, ...] = ()


def problem_from(response: httpx.Response, retry_after_s: float | None = None) -> IsodynError:
    """Exception for an answer that is not a success."""
    try:
        problem = _Problem.model_validate_json(response.content)
    except ValidationError:
        problem = None
    if problem is None:
        return _without_problem(response, retry_after_s)
    slug = problem.type.rsplit("/", 1)[-1]
    return _class_for(response.status_code, slug)(
        response.status_code,
        slug,
        problem.title,
        problem.detail or "",
        errors=tuple(FieldError(e.field, e.message, e.remedy) for e in problem.errors),
        retry_after_s=retry_after_s,
    )


def _class_for(status: int, slug: str) -> type[ProblemError]:
    fallback = ServiceFailedError if status >= 500 else ProblemError
    return _BY_SLUG.get(slug) or _BY_STATUS.get(status, fallback)


def _without_problem(response: httpx.Response, retry_after_s: float | None) -> IsodynError:
    """A refusal without problem details comes from something in between: a proxy, a load balancer."""
    status = response.status_code
    if status >= 500 or status in {401, 403, 413, 429}:
        reason = response.reason_phrase or "refused"
        return _class_for(status, "")(status, "about:blank", reason, retry_after_s=retry_after_s)
    return UnexpectedAnswerError(f"{status} from {response.request.url} is not an answer of Isodyn; check the address")
