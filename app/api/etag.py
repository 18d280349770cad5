"""Entity tags: conditional reads of things that are named by their content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from fastapi import Request, Response

IMMUTABLE = "private, max-age=31536000, immutable"
"""For what never changes under its address: map versions."""
REVALIDATE = "private, no-cache"
"""For what may change: ask each time, with the tag."""


def content_tag(content: bytes) -> str:
    """Strong tag of bytes."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def tag(*parts: str) -> str:
    """Strong tag made of a content hash and what was chosen of it."""
    return f'"{"-".join(parts)}"'


def headers(entity_tag: str, cache: str) -> dict[str, str]:
    """Headers of a tagged answer. The answer depends on the key, so shared caches keep out (``private``)."""
    return {"ETag": entity_tag, "Cache-Control": cache}


def not_modified(request: Request, entity_tag: str, cache: str) -> Response | None:
    """Answer 304 if the caller has this version already, else None. Weak comparison, as RFC 9110 asks for reads."""
    given = request.headers.get("if-none-match")
    if given is None:
        return None
    known = {item.strip().removeprefix("W/") for item in given.split(",")}
    if "*" in known or entity_tag in known:
        return Response(status_code=304, headers=headers(entity_tag, cache))
    return None


def tagged(
    content: bytes, media_type: str, entity_tag: str, cache: str, extra: Mapping[str, str] | None = None
) -> Response:
    """Answer with bytes and their tag."""
    return Response(content, media_type=media_type, headers={**headers(entity_tag, cache), **(extra or {})})
