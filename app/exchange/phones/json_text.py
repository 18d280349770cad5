"""JSON of phones: parsed exactly and within bounds."""

from __future__ import annotations

import json

import orjson

from app.exchange.phones.errors import FormatError


def parsed(content: bytes, what: str, *, most: int) -> object:
    """What a JSON text holds; integers exact to 64 bits.

    ``NaN`` is no JSON, but some senders write it: it is read as not a number.

    Parameters
    ----------
    content : bytes
    what : str
        Names it in errors.
    most : int
        Values, arrays and objects at most: three bytes of an empty one become sixty in memory.

    Raises
    ------
    FormatError
        No JSON, too much of it, or nested beyond reason.
    """
    # commas in texts count too: what is sent has few texts
    if sum(content.count(mark) for mark in (b",", b"[", b"{")) > most:
        raise FormatError(what, f"holds more than {most} values; send it in parts")
    try:
        found: object = orjson.loads(content)
    except orjson.JSONDecodeError as error:
        if b"NaN" not in content and b"Infinity" not in content:
            raise FormatError(what, f"is no JSON ({str(error)[:80]}); send it as the application writes it") from error
        found = _lenient(content, what)
    return found


def _lenient(content: bytes, what: str) -> object:
    try:
        found: object = json.loads(content)
        # half of a character, escaped, passes here (not above), and can neither be stored nor shown
        json.dumps(found, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise FormatError(what, f"is no JSON ({str(error)[:80]}); send it as the application writes it") from error
    return found
