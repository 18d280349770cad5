from __future__ import annotations

import base64
import hashlib
import re

from app.services.records import Scope
from tests.api.harness import Api


def test_alive(api: Api) -> None:
    assert api.ok("GET", "/healthz", key=None) == {"status": "ok"}


def test_ready(api: Api) -> None:
    assert api.ok("GET", "/readyz", key=None) == {"status": "ready", "parts": {"database": True, "pool": True}}


def test_not_ready_names_the_part(api: Api) -> None:
    api.parts["pool"] = False
    response = api.get("/readyz", key=None)
    assert response.status_code == 503
    assert response.json()["type"].endswith("/not-ready")
    assert response.json()["detail"] == "not working: pool"
    assert response.headers["Retry-After"] == "1"


def test_metrics(api: Api) -> None:
    response = api.get("/metrics", key=None)
    assert response.headers["Content-Type"].startswith("text/plain")
    assert b"up 1" in response.content


def test_requests_are_counted_by_template(api: Api) -> None:
    level = api.level()
    api.metrics.requests.clear()
    api.get(f"/v1/levels/{level.id}")
    api.get("/v1/levels/lvl_none")
    api.get("/v1/nothing/here")
    api.call("HEAD", "/healthz", key=None)
    assert api.metrics.requests == [
        ("GET", "/v1/levels/{level_id}", 200),
        ("GET", "/v1/levels/{level_id}", 404),
        ("GET", "unmatched", 404),
        ("HEAD", "/healthz", 200),
    ]


def test_head_is_get_without_a_body(api: Api) -> None:
    level = api.mapped_level()
    for path in ("/healthz", f"/v1/maps/{level.current_map_id}/field"):
        whole, head = api.get(path), api.call("HEAD", path)
        assert head.status_code == 200
        assert head.content == b""
        assert head.headers["Content-Length"] == str(len(whole.content))


def test_a_wrong_method_is_told_the_right_ones(api: Api) -> None:
    response = api.call("PUT", "/v1/venues", key=Scope.SURVEY)
    assert response.status_code == 405
    assert response.json()["type"].endswith("/method-not-allowed")
    assert response.headers["Allow"] == "GET, HEAD, POST"


def test_the_documents_load_nothing_from_elsewhere(api: Api) -> None:
    response = api.get("/docs", key=None)
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    style = response.text.partition("<style>")[2].partition("</style>")[0]
    assert base64.b64encode(hashlib.sha256(style.encode()).digest()).decode() in policy
    assert response.headers["Referrer-Policy"] == "no-referrer"
    assert not re.search(r"<script|<link|src=|@import|url\(", response.text)
    for path in api.get("/openapi.json", key=None).json()["paths"]:
        assert path in response.text
