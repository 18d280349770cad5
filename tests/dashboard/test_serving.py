"""How the files are served: policy, tags, compression, and that the package holds them."""

from __future__ import annotations

import ast
import gzip
import re
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from httpx import Client

from app.dashboard.files import plotly
from tests.e2e.service import Service

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "app" / "dashboard"
NAMES = sorted(path.relative_to(PACKAGE / "static").as_posix() for path in (PACKAGE / "static").rglob("*.*"))


@pytest.fixture
def client(service: Service) -> Client:
    assert service.http is not None
    return service.http


def test_the_page_forbids_what_is_not_a_file_of_ours(client: Client) -> None:
    answer = client.get("/")
    policy = dict(part.strip().split(" ", 1) for part in answer.headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert "unsafe" not in answer.headers["Content-Security-Policy"]
    assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\bon\w+=|\bstyle=", answer.text)


def test_what_the_page_names_is_there(client: Client) -> None:
    named = re.findall(r'(?:href|src)="(/static/[^"]+)"', client.get("/").text)
    assert len(named) > 5
    for path in named:
        assert client.get(path).status_code == 200, path


@pytest.mark.parametrize("name", NAMES)
def test_files_are_served_with_a_tag(client: Client, name: str) -> None:
    content = (PACKAGE / "static" / name).read_bytes()
    answer = client.get(f"/static/{name}")
    assert answer.content == content
    assert answer.headers["Cache-Control"] == "public, no-cache"
    again = client.get(f"/static/{name}", headers={"If-None-Match": answer.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.parametrize(
    "name", ["", "none.js", "../router.py", "..%2frouter.py", "%2e%2e/router.py", "ui", "/etc/passwd"]
)
def test_nothing_else_is_served(client: Client, name: str) -> None:
    assert client.get(f"/static/{name}").status_code == 404


def test_answers_are_compressed_for_those_who_take_it(client: Client) -> None:
    plain = client.get("/static/style.css", headers={"Accept-Encoding": "identity"})
    with client.stream("GET", "/static/style.css", headers={"Accept-Encoding": "gzip"}) as answer:
        raw = b"".join(answer.iter_raw())
        assert answer.headers["Content-Encoding"] == "gzip"
        assert answer.headers["ETag"] != plain.headers["ETag"]
    assert gzip.decompress(raw) == plain.content
    assert "Content-Encoding" not in plain.headers


def test_the_chart_library_is_the_packages(client: Client) -> None:
    answer = client.get("/vendor/plotly.min.js")
    assert answer.content == plotly().content
    assert b"plotly.js v" in answer.content[:1000]


def _code(path: Path) -> str:
    """A script without its comment lines."""
    return "\n".join(line for line in path.read_text().splitlines() if not line.lstrip().startswith(("//", "*", "/*")))


def test_modules_import_only_modules_that_exist() -> None:
    for path in (PACKAGE / "static").rglob("*.js"):
        for target in re.findall(r'(?:\bfrom |\bimport\()"([^"]+)"', _code(path)):
            assert target.startswith("."), f"{path.name} imports {target}"
            assert (path.parent / target).resolve().is_file(), f"{path.name} imports {target}"


def test_the_wheel_holds_every_file() -> None:
    builder = WheelBuilder(str(ROOT))
    packed = {file.distribution_path for file in builder.recurse_included_files()}
    assert {f"app/dashboard/static/{name}" for name in NAMES} <= packed


def test_the_dashboard_knows_the_api_only() -> None:
    for path in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert not name.startswith("app.") or name.startswith(("app.api.", "app.dashboard")), (
                    f"{path.name}: {name}"
                )
