"""JSON of phones: parsed exactly and within bounds."""

from __future__ import annotations

import json

import orjson

from app.exchange.phones.errors import FormatError


def parsed(content: bytes, what: str) -> object:
    """What a JSON text holds; integers exact to 64 bits.

    ``NaN`` is no JSON, but some senders write it: it is read as not a number.

    Raises
    ------
    FormatError
        No JSON, or nested beyond reason.
    """
    try:
        found: object = orjson.loads(content)
    except orjson.JSONDecodeError as error:
        if b"NaN" not in content and b"Infinity" not in content:
            raise FormatError(what, f"is no JSON ({str(error)[:80]}); send it as the application writes it") from error
        found = _lenient(content, what)
    return found


def _lenient(content: bytes, what: str) -> object:
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FormatError(what, f"is no JSON ({str(error)[:80]}); send it as the application writes it") from error
