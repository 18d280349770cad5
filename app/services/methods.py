"""Checks of a method's name and parameters against the engine's registry."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from app.engine.errors import InputError
from app.engine.localization.registry import METHODS, create_tracker
from app.services.errors import InvalidError

MethodCheck = Callable[[str, Mapping[str, object]], None]
"""``check(method, parameters)`` raises :class:`InvalidError` for what the engine would refuse."""


def check_method(method: str, parameters: Mapping[str, object]) -> None:
    """Refuse methods and parameters that the engine does not know, before anything is stored."""
    if method not in METHODS:
        raise InvalidError("method", f"{method!r} is unknown", f"choose one of {', '.join(sorted(METHODS))}")
    try:
        create_tracker(method, parameters)
    except InputError as error:
        remedy = f"see GET /v1/methods/{method} for names, types and ranges"
        raise InvalidError(error.field, error.message, remedy) from error
