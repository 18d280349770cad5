"""Pieces of OpenAPI that routes share: declared problems, raw bodies, examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from app.api import errors
from app.api.body import JSON, MSGPACK
from app.api.errors import PROBLEM_JSON, ProblemType

Responses = dict[int | str, dict[str, Any]]

PROBLEM_SCHEMA: dict[str, Any] = {
    "title": "Problem",
    "type": "object",
    "description": "A problem (RFC 9457). `type` ends in a stable slug; docs/api.md lists all.",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": {"type": "string", "format": "uri"},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "detail": {"type": "string"},
        "instance": {"type": "string"},
        "errors": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["field", "message", "remedy"],
                "properties": {
                    "field": {"type": "string", "description": "Path in the request: `samples.mag.x`."},
                    "message": {"type": "string"},
                    "remedy": {"type": "string"},
                },
            },
        },
    },
}

PNG = "image/png"
RAW = "application/octet-stream"

ALWAYS = (errors.UNAUTHORIZED, errors.FORBIDDEN, errors.RATE_LIMITED)
"""Problems of every call that needs a key."""
OBJECT = (errors.MALFORMED_BODY, errors.BODY_TOO_LARGE, errors.UNSUPPORTED_MEDIA_TYPE, errors.INVALID)
"""Problems of every call with a body."""

RASTER_HEADERS: dict[str, Any] = {
    "ETag": {"schema": {"type": "string"}},
    "X-Isodyn-Rows": {"schema": {"type": "integer"}},
    "X-Isodyn-Columns": {"schema": {"type": "integer"}},
    "X-Isodyn-X0": {"schema": {"type": "number"}, "description": "Of node [0, 0], m."},
    "X-Isodyn-Y0": {"schema": {"type": "number"}},
    "X-Isodyn-Cell-M": {"schema": {"type": "number"}},
    "X-Isodyn-Low": {"schema": {"type": "number"}, "description": "Value of the first colour (PNG)."},
    "X-Isodyn-High": {"schema": {"type": "number"}, "description": "Value of the last colour (PNG)."},
}
"""What every answer with a raster says about it."""


def raster_answer(description: str) -> dict[str, Any]:
    """Describe an answer that is a raster: a picture or float32."""
    return {
        "description": description,
        "content": {
            media_type: {"schema": {"type": "string", "contentMediaType": media_type}} for media_type in (PNG, RAW)
        },
        "headers": RASTER_HEADERS,
    }


NOT_MODIFIED: Responses = {304: {"description": "The caller has this version already (`If-None-Match`)."}}

RAW_MODELS: dict[str, type[BaseModel]] = {}
"""Models of raw bodies and answers, by name: FastAPI does not see them, so the document is completed with them."""


def problems(*kinds: ProblemType) -> Responses:
    """Declare problems as responses; several of one status share an entry."""
    declared: Responses = {}
    for kind in kinds:
        entry = declared.setdefault(
            kind.status,
            {
                "description": "",
                "content": {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Problem"}, "examples": {}}},
            },
        )
        entry["description"] = f"{entry['description']}; `{kind.slug}`" if entry["description"] else f"`{kind.slug}`"
        entry["content"][PROBLEM_JSON]["examples"][kind.slug] = {
            "summary": kind.title,
            "value": {"type": kind.uri, "title": kind.title, "status": kind.status, "detail": "..."},
        }
    return declared


def guarded(*kinds: ProblemType) -> Responses:
    """Declare these problems and those of every call that needs a key."""
    return problems(*ALWAYS, *kinds)


def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return a reference to a model that only raw bodies or answers use."""
    RAW_MODELS[model.__name__] = model
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def upload(model: type[BaseModel], example: Mapping[str, Any]) -> dict[str, Any]:
    """Describe a raw body of samples for ``openapi_extra``: JSON or msgpack, plain or gzipped."""
    schema = schema_of(model)
    return {
        "requestBody": {
            "required": True,
            "description": (
                "Columns of numbers. In msgpack a column may also be a binary of little-endian values: float64 for "
                "times and plan coordinates, float32 for sensors. `Content-Encoding: gzip` is taken."
            ),
            "content": {JSON: {"schema": schema, "example": dict(example)}, MSGPACK: {"schema": schema}},
        }
    }


def binary(media_type: str, description: str) -> dict[str, Any]:
    """Describe an answer or body of bytes."""
    return {
        "description": description,
        "content": {media_type: {"schema": {"type": "string", "contentMediaType": media_type}}},
    }
