"""The OpenAPI document: FastAPI's, completed with what it cannot see."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import iter_route_contexts
from pydantic.json_schema import models_json_schema

from app.api.auth import scope_word
from app.api.responses import PROBLEM_SCHEMA, RAW_MODELS
from app.api.routing import ApiRoute

DESCRIPTION = """\
Isodyn locates phones, robots and vehicles by the magnetic field: survey a level, build a map of it, open a session
and send segments of samples; each is answered with positions and their uncertainty.

* **Keys**: `Authorization: Bearer <key>` or `X-API-Key: <key>`; scopes `locate`, `survey`, `admin`.
* **Units**: uT, m/s^2, rad/s, metres in the level frame, Unix milliseconds; angles in answers are degrees (`_deg`).
* **Problems**: every error is `application/problem+json` (RFC 9457) with a stable `type`; fields that cannot be
  accepted are named with a remedy.
* **Lists**: `limit` and `cursor`; `next_cursor` and a `Link` header lead on.
* **Limits**: `RateLimit` headers say what is left; 429 and 503 carry `Retry-After`.
"""

TAGS = [
    {"name": "venues", "description": "Places with one local frame."},
    {"name": "levels", "description": "Storeys of venues, with their plans."},
    {"name": "devices", "description": "Physical sensor carriers."},
    {"name": "surveys", "description": "Walks with known positions."},
    {"name": "maps", "description": "Immutable, versioned magnetic maps of levels."},
    {"name": "exchange", "description": "Maps and surveys as files."},
    {"name": "contributions", "description": "What sessions offer to maps, and changes of the field."},
    {"name": "sessions", "description": "Trips of devices."},
    {"name": "segments", "description": "Uploaded stretches of a session."},
    {"name": "positions", "description": "Fixes of a session."},
    {"name": "live", "description": "Sessions as they go."},
    {"name": "ingest", "description": "Phones that push: tokens, messages, recordings, markers."},
    {"name": "geofences", "description": "Areas of levels, and who entered or left them."},
    {"name": "webhooks", "description": "Addresses that are told what happens."},
    {"name": "locate", "description": "One call, no session."},
    {"name": "jobs", "description": "Durable work: map builds, segments."},
    {"name": "methods", "description": "Positioning methods and their parameters."},
    {"name": "keys", "description": "API keys and scopes."},
    {"name": "stats", "description": "Counts for operators."},
    {"name": "health", "description": "For those who run the service."},
]

_REF = "#/components/schemas/{model}"


def document(app: FastAPI) -> dict[str, Any]:
    """Build the document."""
    described = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        routes=app.routes,
        tags=app.openapi_tags,
    )
    schemas = described.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(_raw_schemas())
    schemas["Problem"] = PROBLEM_SCHEMA
    for operations in described["paths"].values():
        for operation in operations.values():
            _drop_fastapi_validation(operation["responses"])
    for name, method, access in _declared(app):
        described["paths"][name.replace(":path}", "}")][method]["x-isodyn-scope"] = access
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    return described


def install(app: FastAPI) -> None:
    """Serve the completed document, built once."""

    def cached() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = document(app)
        return app.openapi_schema

    serve: Callable[[], dict[str, Any]] = cached
    app.openapi = serve  # type: ignore[method-assign]  # FastAPI's documented way to extend the document


def _declared(app: FastAPI) -> Iterator[tuple[str, str, str]]:
    """Path, method and scope (``any`` key, ``token``, ``none``) of every call that is shown."""
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        if isinstance(route, ApiRoute) and route.include_in_schema:
            for method in route.methods or ():
                yield route.path, method.lower(), scope_word(route.access)


def _raw_schemas() -> dict[str, Any]:
    models = [(model, "validation") for model in RAW_MODELS.values()]
    _, schema = models_json_schema(models, ref_template=_REF)  # type: ignore[arg-type]
    definitions: dict[str, Any] = schema.get("$defs", {})
    return definitions


def _drop_fastapi_validation(responses: dict[str, Any]) -> None:
    """FastAPI adds its own 422 to every call with a parameter; a path parameter alone cannot be invalid here."""
    content = responses.get("422", {}).get("content", {})
    if "application/json" in content and "application/problem+json" not in content:
        del responses["422"]
