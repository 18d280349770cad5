from __future__ import annotations

from dataclasses import fields

from app.engine.localization.registry import DEFAULT_METHOD, METHODS
from app.services.records import Scope
from tests.api.harness import Api


def test_the_registry_is_shown_whole(api: Api) -> None:
    shown = {item["name"]: item for item in api.ok("GET", "/v1/methods", key=Scope.SURVEY)["items"]}
    assert set(shown) == set(METHODS)
    for name, method in METHODS.items():
        assert api.ok("GET", f"/v1/methods/{name}") == shown[name]
        assert shown[name]["default"] == (name == DEFAULT_METHOD)
        parameters = {item["name"]: item for item in shown[name]["parameters"]}
        assert set(parameters) == {item.name for item in fields(method.parameters)}
        for parameter in parameters.values():
            assert parameter["description"], f"{name}.{parameter['name']} is not described"
            bound = method.bounds.get(parameter["name"])
            assert (parameter["minimum"], parameter["maximum"]) == ((bound.low, bound.high) if bound else (None, None))


def test_what_is_shown_is_accepted(api: Api) -> None:
    level = api.mapped_level()
    for method in api.ok("GET", "/v1/methods")["items"]:
        parameters = {item["name"]: item["default"] for item in method["parameters"]}
        body = {"level_id": level.id, "method": method["name"], "parameters": parameters}
        if method["needs_prior"]:
            assert api.post("/v1/sessions", json=body).json()["errors"][0]["field"] == "prior"
            body["prior"] = {"x": 5.0, "y": 5.0}
        if method["needs_routes"]:  # the map of the fixture has no lines
            assert api.post("/v1/sessions", json=body).json()["errors"][0]["field"] == "method"
        else:
            assert api.ok("POST", "/v1/sessions", json=body)["parameters"] == parameters


def test_auto_says_what_it_chose_and_why(api: Api) -> None:
    level = api.mapped_level()
    session = api.ok("POST", "/v1/sessions", json={"level_id": level.id, "method": "auto"})
    assert session["method"] == DEFAULT_METHOD
    assert "indoors" in session["method_reason"]
    assert api.ok("GET", f"/v1/sessions/{session['id']}")["method_reason"] == session["method_reason"]


def test_unknown_method(api: Api) -> None:
    assert api.get("/v1/methods/magic").status_code == 404
