"""``/openapi.json``, and ``/docs``: the same as one plain page, without scripts and without a request elsewhere."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Iterable
from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse, JSONResponse

from app.api.auth import public
from app.api.routing import api_router

router = api_router("docs")

_STYLE = """
:root { color-scheme: light dark; --line: #8886; --soft: #8882; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
details { border: 1px solid var(--line); border-radius: 6px; margin: .5rem 0; padding: .4rem .8rem; }
summary { cursor: pointer; }
summary code { font-weight: 600; }
.method { display: inline-block; min-width: 4.2rem; font: 600 .85rem ui-monospace, monospace; }
.scope { float: right; opacity: .7; font-size: .85rem; }
pre { background: var(--soft); padding: .7rem; border-radius: 6px; overflow-x: auto; font-size: .85rem; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
td, th { text-align: left; padding: .25rem .6rem .25rem 0; vertical-align: top; border-top: 1px solid var(--line); }
nav a { margin-right: .8rem; }
"""
_SCOPES = {"none": "open", "any": "any key", "token": "token in the path"}
# No source but this page's own style: nothing else on it can load or run.
_STYLE_HASH = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
_POLICY = (
    f"default-src 'none'; style-src 'sha256-{_STYLE_HASH}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@router.get("/openapi.json", include_in_schema=False, dependencies=[public()])
async def openapi_document(request: Request) -> JSONResponse:
    """Return the OpenAPI document."""
    return JSONResponse(request.app.openapi())


@router.get("/docs", include_in_schema=False, dependencies=[public()])
def docs(request: Request) -> HTMLResponse:
    """Show all calls."""
    return HTMLResponse(
        page(request.app.openapi()), headers={"Content-Security-Policy": _POLICY, "Referrer-Policy": "no-referrer"}
    )


def page(document: dict[str, Any]) -> str:
    """Render the page of an OpenAPI document."""
    info = document["info"]
    tags = document.get("tags", [])
    nav = " ".join(f'<a href="#{_text(tag["name"])}">{_text(tag["name"])}</a>' for tag in tags)
    sections = "".join(_section(document, tag) for tag in tags)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_text(info['title'])} API</title><style>{_STYLE}</style></head><body>"
        f"<h1>{_text(info['title'])} API <small>{_text(info['version'])}</small></h1>"
        f'<p>{_text(info.get("summary", ""))} Machine-readable: <a href="/openapi.json">openapi.json</a>.</p>'
        f"<pre>{_text(info.get('description', ''))}</pre><nav>{nav}</nav>{sections}</body></html>"
    )


def _section(document: dict[str, Any], tag: dict[str, Any]) -> str:
    name = tag["name"]
    calls = "".join(
        _call(document, method, path, operation)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        if name in operation.get("tags", [])
    )
    return f'<h2 id="{_text(name)}">{_text(name)}</h2><p>{_text(tag.get("description", ""))}</p>{calls}'


def _call(document: dict[str, Any], method: str, path: str, operation: dict[str, Any]) -> str:
    declared = operation["x-isodyn-scope"]
    scope = _SCOPES.get(declared, declared)
    parts = [
        f"<p>{_text(operation.get('description', ''))}</p>",
        _parameters(operation.get("parameters", [])),
        _body(document, operation.get("requestBody", {})),
        _answers(document, operation["responses"]),
    ]
    return (
        f'<details><summary><span class="method">{_text(method.upper())}</span> <code>{_text(path)}</code> '
        f'{_text(operation.get("summary", ""))}<span class="scope">{_text(scope)}</span></summary>'
        f"{''.join(parts)}</details>"
    )


def _parameters(parameters: list[dict[str, Any]]) -> str:
    rows = (
        (
            parameter["name"],
            parameter["in"],
            "required" if parameter.get("required") else "",
            parameter.get("description", ""),
        )
        for parameter in parameters
    )
    return _table(("parameter", "in", "", ""), rows) if parameters else ""


def _body(document: dict[str, Any], body: dict[str, Any]) -> str:
    blocks = "".join(
        f"<p><b>Body</b> <code>{_text(kind)}</code></p>{_example(document, media)}"
        for kind, media in body.get("content", {}).items()
    )
    note = f"<p>{_text(body['description'])}</p>" if body.get("description") else ""
    return blocks + note


def _answers(document: dict[str, Any], responses: dict[str, Any]) -> str:
    rows = ((status, answer.get("description", "")) for status, answer in responses.items())
    shown = "".join(
        f"<p><b>{_text(status)}</b> <code>{_text(kind)}</code></p>{_example(document, media)}"
        for status, answer in responses.items()
        if status.startswith("2")
        for kind, media in answer.get("content", {}).items()
    )
    return _table(("answer", ""), rows) + shown


def _example(document: dict[str, Any], media: dict[str, Any]) -> str:
    value = media.get("example")
    if value is None:
        schema = media.get("schema", {})
        reference = schema.get("$ref", "").rpartition("/")[2]
        schema = document["components"]["schemas"].get(reference, schema)
        value = next(iter(schema.get("examples", [])), None)
    return "" if value is None else f"<pre>{_text(json.dumps(value, indent=2))}</pre>"


def _table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{_text(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _text(value: object) -> str:
    return html.escape(str(value))
