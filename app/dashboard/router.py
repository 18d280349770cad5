"""Serves the dashboard: ``/``, ``/static/...`` and the chart library. Open to everybody: it holds no data."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.exceptions import HTTPException

from app.api.auth import public
from app.api.etag import headers, not_modified
from app.api.routing import api_router
from app.dashboard.files import StaticFile, plotly, static_file

router = api_router("dashboard")

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""No inline script, no inline style, nothing from elsewhere: text that an API answer brings cannot run here."""
_PAGE_HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_REVALIDATE = "public, no-cache"
"""The files change with the service: ask each time, with the tag."""
_A_WEEK = "public, max-age=604800"


@router.get("/", include_in_schema=False, dependencies=[public()])
def dashboard(request: Request) -> Response:
    """The page that all others are drawn in."""
    return _answer(request, _found("index.html"), _REVALIDATE, _PAGE_HEADERS)


@router.get("/static/{name:path}", include_in_schema=False, dependencies=[public()])
def static(name: str, request: Request) -> Response:
    """A script, a style or a picture of the dashboard."""
    return _answer(request, _found(name), _REVALIDATE)


@router.get("/vendor/plotly.min.js", include_in_schema=False, dependencies=[public()])
def chart_library(request: Request) -> Response:
    """Plotly, from its Python package: pages that draw charts load it, once a week."""
    return _answer(request, plotly(), _A_WEEK)


def _found(name: str) -> StaticFile:
    file = static_file(name)
    if file is None:
        raise HTTPException(404)
    return file


def _answer(request: Request, file: StaticFile, cache: str, extra: dict[str, str] | None = None) -> Response:
    fields = {**headers(file.tag, cache), "Vary": "Accept-Encoding", **(extra or {})}
    unchanged = not_modified(request, file.tag, cache)
    if unchanged is not None:
        return unchanged
    zipped = file.zipped if "gzip" in request.headers.get("accept-encoding", "") else None
    if zipped is None:
        return Response(file.content, media_type=file.media_type, headers=fields)
    # another representation, so another tag; it is weak, which is all that revalidation needs
    fields |= {"Content-Encoding": "gzip", "ETag": f"W/{file.tag}"}
    return Response(zipped, media_type=file.media_type, headers=fields)
