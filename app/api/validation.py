"""From pydantic's errors to field, message and remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_SOURCES = frozenset({"body", "query", "path", "header"})

NAME_PATTERN = r"^[^\x00-\x1f\x7f]*[^\x00-\x20\x7f][^\x00-\x1f\x7f]*$"
LINE_PATTERN = r"^[^\x00-\x1f\x7f]*$"
ID_PATTERN = r"^[a-z0-9_]+$"

PATTERN_WORDS: Mapping[str, tuple[str, str]] = {
    NAME_PATTERN: ("shows nothing, or holds control characters", "send a line of text"),
    LINE_PATTERN: ("holds control characters", "send a line of text"),
    ID_PATTERN: ("is not an id or cursor of this service", "send it as it was answered: a-z, 0-9 and _"),
}
"""What a string lacks that does not match: regular expressions are for programs."""

_MEMBER = re.compile(r"<\w+\.\w+: ('[^']*')>")
_NO_OBJECT = frozenset({"model_type", "model_attributes_type", "dict_type"})

_REMEDIES: Mapping[str, str] = {
    "missing": "add this field",
    "extra_forbidden": "remove it or correct its name; unknown fields are not taken",
    "finite_number": "send a finite number",
    "json_invalid": "send valid JSON",
    "list_type": "send an array",
    "tuple_type": "send an array",
    "string_type": "send a string",
    "string_unicode": "send valid Unicode",
    "string_too_short": "send a longer string",
    "string_too_long": "send a shorter string",
    "bool_type": "send true or false",
    "int_type": "send an integer",
    "int_parsing": "send an integer",
    "int_from_float": "send an integer",
    "float_type": "send a number",
    "float_parsing": "send a number",
    "too_short": "send more values",
    "too_long": "send fewer values",
}


@dataclass(frozen=True, slots=True)
class FieldError:
    """One field that cannot be accepted: where it is, what is wrong, what would be accepted."""

    field: str
    message: str
    remedy: str


def field_path(location: Sequence[str | int]) -> str:
    """Join a location: ``("body", "survey_ids", 0)`` is ``survey_ids.0``."""
    parts = location[1:] if location and location[0] in _SOURCES else location
    return ".".join(str(part) for part in parts) or "body"


def field_errors(errors: Sequence[Mapping[str, Any]]) -> tuple[FieldError, ...]:
    """Translate pydantic's error list."""
    return tuple(_field_error(error) for error in errors)


def _field_error(error: Mapping[str, Any]) -> FieldError:
    kind = str(error["type"])
    message = str(error["msg"])
    context = error.get("ctx") or {}
    field = field_path(error["loc"])
    if kind == "missing" and field == "body":
        return FieldError(field, "is empty", "send a JSON object")
    if context.get("pattern") in PATTERN_WORDS:
        return FieldError(field, *PATTERN_WORDS[context["pattern"]])
    if kind in _NO_OBJECT:
        # pydantic's words name the class, which is nobody's business
        return FieldError(field, "is not an object", "send an object")
    if kind == "literal_error":
        # members of an enum inside a Literal are told by their repr
        context = {**context, "expected": _MEMBER.sub(r"\1", str(context["expected"]))}
        message = _MEMBER.sub(r"\1", message)
    remedy = str(context.get("remedy", "")) or _remedy(kind, context)
    return FieldError(field, message[:1].lower() + message[1:], remedy)


def _remedy(kind: str, context: Mapping[str, Any]) -> str:
    for bound, words in (("ge", "at least"), ("gt", "more than"), ("le", "at most"), ("lt", "less than")):
        if bound in context:
            return f"send a value of {words} {context[bound]}"
    if kind in {"enum", "literal_error"}:
        return f"send {context['expected']}"
    return _REMEDIES.get(kind, "correct the value; /docs shows what is taken")
