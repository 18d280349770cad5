"""Calls as values: what to send and how to read the answer, with no input or output of their own.

Both clients send the same calls; :mod:`isodyn_client.endpoints` builds them.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from isodyn_client.encoding import Body
from isodyn_client.errors import UnexpectedAnswerError
from isodyn_client.models import Page

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Call(Generic[T]):
    """One request and the reading of its answer.

    Attributes
    ----------
    method, path : str
    parse : callable
        Turns a successful answer into the result.
    params, headers : mapping
        Query and headers beyond the client's own.
    body : Body or None
    repeatable : bool
        Whether sending it twice does no more than sending it once, so that it may be sent again when nobody
        knows what became of the first.
    wait_s : float
        How long the service was asked to hold its answer; added to the time the client waits for it.
    """

    method: str
    path: str
    parse: Callable[[httpx.Response], T]
    params: Mapping[str, str | int | float | list[str]] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: Body | None = None
    repeatable: bool = True
    wait_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Listing(Generic[T]):
    """A list that comes in pages."""

    call: Call[Page[T]]

    def page(self, cursor: str | None) -> Call[Page[T]]:
        """The call for the page behind ``cursor`` (None: the first)."""
        if cursor is None:
            return self.call
        return replace(self.call, params={**self.call.params, "cursor": cursor})


def as_model(model: type[M]) -> Callable[[httpx.Response], M]:
    """Reader of a JSON answer."""

    def parse(response: httpx.Response) -> M:
        try:
            return model.model_validate_json(response.content)
        except ValidationError as error:
            raise UnexpectedAnswerError(f"{response.request.url} does not answer like Isodyn: {error}") from error

    return parse


def as_bytes(response: httpx.Response) -> bytes:
    """Reader of a binary answer."""
    return response.content


def nothing(response: httpx.Response) -> None:
    """Reader of an answer without content."""


def present(values: Mapping[str, Any]) -> dict[str, Any]:
    """Only what was given: parameters that are None are left out."""
    return {name: value for name, value in values.items() if value is not None}


def fresh_idempotency_key() -> dict[str, str]:
    """Header that makes a creating call repeatable: the service answers a repetition with the first thing made."""
    return {"Idempotency-Key": uuid.uuid4().hex}


def prefer_wait(wait_s: float | None) -> dict[str, str]:
    """Header that asks the service to hold its answer until the work is done."""
    return {} if wait_s is None else {"Prefer": f"wait={wait_s:g}"}
