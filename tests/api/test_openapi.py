"""The document is complete: every call has words, examples and its problems; every example is true."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

from app.api import schemas
from app.api.auth import scope_word
from app.api.errors import PROBLEM_TYPES
from app.api.ingest import SHOWN
from app.api.schemas import (
    contributions,
    device_models,
    devices,
    geofences,
    ground_truth,
    health,
    ingest,
    jobs,
    keys,
    levels,
    locate,
    maps,
    methods,
    planning,
    positions,
    replays,
    segments,
    sessions,
    stats,
    stats_tables,
    surveys,
    venues,
    versions,
    waypoints,
    webhooks,
)
from app.api.schemas import samples as sample_schemas
from app.engine.localization.registry import METHODS
from tests.api.harness import Api
from tests.api.test_access import TABLE

MODULES = [
    contributions,
    device_models,
    devices,
    ground_truth,
    geofences,
    health,
    ingest,
    jobs,
    keys,
    levels,
    locate,
    maps,
    methods,
    planning,
    positions,
    replays,
    sample_schemas,
    segments,
    sessions,
    stats,
    stats_tables,
    surveys,
    venues,
    versions,
    waypoints,
    webhooks,
]
HIDDEN = {"GET /docs", "GET /openapi.json"}


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> Any:
    api = Api(tmp_path_factory.mktemp("openapi"))
    yield api.get("/openapi.json", key=None).json()
    api.close()


def operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, methods_ in document["paths"].items():
        for method, operation in methods_.items():
            yield f"{method.upper()} {path}", operation


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if isinstance(value.get("$ref"), str):
            yield value["$ref"]
        for item in value.values():
            yield from references(item)
    elif isinstance(value, list):
        for item in value:
            yield from references(item)


def test_all_calls_are_described(document: dict[str, Any]) -> None:
    described = dict(operations(document))
    assert set(described) == set(TABLE) - HIDDEN
    tags = {tag["name"] for tag in document["tags"]}
    for name, operation in described.items():
        assert operation["summary"], name
        assert operation["description"], name
        assert set(operation["tags"]) <= tags, name
        assert operation["responses"].keys() & {"200", "201", "202", "204"}, name


def test_calls_have_short_unique_names_and_their_scope(document: dict[str, Any]) -> None:
    described = dict(operations(document))
    names = [operation["operationId"] for operation in described.values()]
    assert len(set(names)) == len(names)
    assert "add_segment" in names
    for name, operation in described.items():
        assert operation["x-isodyn-scope"] == scope_word(TABLE[name]), name


def test_references_lead_somewhere(document: dict[str, Any]) -> None:
    known = document["components"]["schemas"]
    for reference in references(document):
        assert reference.startswith("#/components/schemas/"), reference
        assert reference.rpartition("/")[2] in known, reference


def test_guarded_calls_declare_key_and_problems(document: dict[str, Any]) -> None:
    for name, operation in operations(document):
        if TABLE[name].public:
            assert "security" not in operation, name
            continue
        assert operation["security"] == [{"bearer": []}, {"header": []}], name
        assert {"401", "403", "429"} <= set(operation["responses"]), name
        if "requestBody" in operation:
            assert {"400", "413", "415", "422"} <= set(operation["responses"]), name
        if "{" in name and name.startswith(("GET /v1", "PUT", "PATCH", "DELETE")):
            assert "404" in operation["responses"], name


def test_refusals_are_problem_details(document: dict[str, Any]) -> None:
    slugs = {kind.slug for kind in PROBLEM_TYPES}
    for name, operation in operations(document):
        for status, answer in operation["responses"].items():
            if int(status) >= 400 and int(status) != SHOWN:  # text that a phone shows
                ((kind, media),) = answer["content"].items()
                assert kind == "application/problem+json", f"{name} {status}"
                assert set(media["examples"]) <= slugs, f"{name} {status}"


def test_bodies_and_answers_have_examples(document: dict[str, Any]) -> None:
    known = document["components"]["schemas"]

    def has_example(media: dict[str, Any]) -> bool:
        schema = media.get("schema", {})
        name = schema.get("$ref", "").rpartition("/")[2]
        return "example" in media or bool(known.get(name, schema).get("examples"))

    for name, operation in operations(document):
        contents = [operation.get("requestBody", {}).get("content", {})]
        contents += [answer.get("content", {}) for status, answer in operation["responses"].items() if status < "300"]
        for content in contents:
            for kind, media in content.items():
                if kind.endswith("json"):
                    assert has_example(media), f"{name} {kind}"


def test_creating_calls_take_idempotency_keys(document: dict[str, Any]) -> None:
    taking = {
        name
        for name, operation in operations(document)
        if any(parameter["name"] == "Idempotency-Key" for parameter in operation.get("parameters", []))
    }
    assert taking == {
        "POST /v1/venues",
        "POST /v1/venues/{venue_id}/levels",
        "POST /v1/devices",
        "POST /v1/surveys",
        "POST /v1/sessions",
        "POST /v1/geofences",
    }


def models() -> list[type[BaseModel]]:
    found = {
        value
        for module in MODULES
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, BaseModel) and value.__module__.startswith(schemas.__name__)
    }
    return sorted(found, key=lambda model: model.__name__)


@pytest.mark.parametrize("model", models(), ids=lambda model: model.__name__)
def test_examples_are_true(model: type[BaseModel]) -> None:
    extra = model.model_config.get("json_schema_extra")
    if isinstance(extra, dict):
        for example in extra["examples"]:  # type: ignore[union-attr]
            model.model_validate(example)


def test_uploads_show_their_columns(document: dict[str, Any]) -> None:
    operation = dict(operations(document))["POST /v1/sessions/{session_id}/segments"]
    content = operation["requestBody"]["content"]
    assert set(content) == {"application/json", "application/msgpack"}
    schema = document["components"]["schemas"]["SegmentIn"]
    assert schema["required"] == ["seq", "samples"]
    assert schema["additionalProperties"] is False
    samples = document["components"]["schemas"]["SamplesIn"]["properties"]
    assert samples["t_ms"]["type"] == "array"
    assert samples["t_ms"]["items"] == {"type": "number"}


def test_methods_are_an_enum(document: dict[str, Any]) -> None:
    method = document["components"]["schemas"]["SessionIn"]["properties"]["method"]
    assert method["enum"] == [*METHODS, "auto"]
