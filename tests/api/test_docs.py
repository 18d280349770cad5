"""docs/api.md lists every call and every problem, and its examples run."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

from app.api.auth import scope_word
from app.api.errors import PROBLEM_TYPES, TYPE_BASE
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body, walk_body
from tests.api.test_access import TABLE
from tests.api.test_levels import PLAN, png

PAGE = (Path(__file__).parents[2] / "docs" / "api.md").read_text()


def test_every_call_is_listed_with_its_scope() -> None:
    rows = dict(re.findall(r"^\| `((?:GET|POST|PUT|PATCH|DELETE) \S+)` \| (\w+) \|", PAGE, flags=re.MULTILINE))
    expected = {name: scope_word(access) for name, access in TABLE.items()}
    assert rows == expected


def test_every_problem_is_listed_with_its_status() -> None:
    rows = re.findall(r"^\| `([a-z-]+)` \| (\d{3}) \|", PAGE, flags=re.MULTILINE)
    assert rows == [(kind.slug, str(kind.status)) for kind in PROBLEM_TYPES]
    assert TYPE_BASE in PAGE


def test_json_examples_are_json() -> None:
    blocks = re.findall(r"```json\n(.*?)```", PAGE, flags=re.DOTALL)
    assert blocks
    for block in blocks:
        json.loads(block)


def commands() -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    return [command for block in blocks for command in re.split(r"\n(?=curl )", block.strip())]


def run(api: Api, command: str, names: dict[str, str], files: dict[str, bytes]) -> Any:
    """Run the little of curl that the page uses."""
    for name, value in names.items():
        command = command.replace(f"${name}", value)
    words = iter(shlex.split(command)[1:])
    method, url, headers, content = "", "", {}, None
    for word in words:
        if word in ("-H", "-X", "-o", "--json", "--data-binary"):
            value = next(words)
            if word == "-H":
                key, _, text = value.partition(": ")
                headers[key] = text
            elif word == "-X":
                method = value
            elif word != "-o":
                content = files[value[1:]] if value.startswith("@") else value.encode()
            if word == "--json":
                headers.setdefault("Content-Type", "application/json")
        else:
            assert not word.startswith("-"), f"{word} is not understood here"
            url = word
    method = method or ("POST" if content is not None else "GET")
    response = api.call(method, url, key=None, headers=headers, content=content)
    assert response.is_success, f"{command}\n{response.status_code} {response.text}"
    is_json = response.content and response.headers.get("Content-Type", "").endswith("json")
    return response.json() if is_json else None


def test_the_examples_run_in_order(api: Api) -> None:
    names = {"URL": "http://isodyn.test", "KEY": api.secrets[Scope.ADMIN]}
    files = {
        "plan.png": png(),
        "plan.geojson": json.dumps(PLAN).encode(),
        "walk.json": json.dumps(plain(walk_body())).encode(),
        "segment.json": json.dumps(plain(segment_body())).encode(),
    }
    prefixes = {"ven": "VENUE", "lvl": "LEVEL", "srv": "SURVEY", "ses": "SESSION", "job": "JOB", "dev": "DEVICE"}
    ran = 0
    for command in commands():
        files["locate.json"] = json.dumps(
            plain({"level_id": names.get("LEVEL"), "samples": segment_body()["samples"]})
        ).encode()
        answer = run(api, command, names, files)
        ran += 1
        if isinstance(answer, dict):
            created = str(answer.get("id", ""))
            names.setdefault(prefixes.get(created[:3], "OTHER"), created)
            if "map_id" in answer.get("result", {}):
                names["MAP"] = answer["result"]["map_id"]
    assert ran == len(re.findall(r"^curl ", PAGE, flags=re.MULTILINE))
    assert ran > 15
