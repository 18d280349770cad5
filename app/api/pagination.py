"""Cursor pages: ``?cursor=&limit=`` in, ``next_cursor`` and a ``Link`` header out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Depends, Query, Request, Response

from app.api.validation import ID_PATTERN
from app.services.base import DEFAULT_LIMIT, MAX_LIMIT


@dataclass(frozen=True, slots=True)
class Paging:
    """Where a page starts and how long it is."""

    cursor: str | None
    limit: int


_Cursor = Query(min_length=1, max_length=64, pattern=ID_PATTERN, description="`next_cursor` of the page before.")


async def _paging(
    cursor: Annotated[str | None, _Cursor] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_LIMIT, description="Items a page.")] = DEFAULT_LIMIT,
) -> Paging:
    return Paging(cursor, limit)


PagingDep = Annotated[Paging, Depends(_paging)]


def link_next(request: Request, response: Response, next_cursor: str | None) -> None:
    """Set the ``Link`` header of RFC 8288 unless this is the last page."""
    if next_cursor is not None:
        response.headers["Link"] = next_link(request, next_cursor)


def next_link(request: Request, next_cursor: str) -> str:
    """Value of the ``Link`` header: this request with another cursor (relative: proxies may rename the host)."""
    query = [(name, value) for name, value in request.query_params.multi_items() if name != "cursor"]
    return f'<{request.url.path}?{urlencode([*query, ("cursor", next_cursor)])}>; rel="next"'
