"""docs/operations.md lists every table with its filters and every rule, and its examples run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from app.services import stats
from app.services.alarm_rules import PER_RULE, RULES
from app.services.ground_truth import MAX_POINTS
from app.services.records import Scope
from tests.api.harness import Api, plain, segment_body
from tests.api.test_docs import run

PAGE = (Path(__file__).parents[2] / "docs" / "operations.md").read_text()
_OF_ALL = {"format"}


def test_every_rule_is_listed_as_it_is() -> None:
    rows = re.findall(r"^\| `([a-z-]+)` \| (critical|warning|info) \| (.+?) \| (.+) \|$", PAGE, flags=re.MULTILINE)
    assert rows == [(rule.name, rule.severity.value, rule.when, rule.remedy) for rule in RULES]
    assert f"at most {PER_RULE} subjects" in PAGE


def test_rules_say_the_threshold_that_they_use() -> None:
    """The number in the words is the number in the table."""
    for rule in RULES:
        numbers = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", rule.when)}
        assert numbers & {rule.threshold, rule.threshold * 100}, rule.name


def test_every_table_is_listed_with_its_filters(api: Api) -> None:
    rows = dict(re.findall(r"^\| `([a-z]+)` \| .+? \| ((?:`\w+`(?:, )?)*) ?\|$", PAGE, flags=re.MULTILINE))
    paths: dict[str, Any] = api.ok("GET", "/openapi.json")["paths"]
    served = {
        path.removeprefix("/v1/stats/"): {one["name"] for one in verbs["get"].get("parameters", ())} - _OF_ALL
        for path, verbs in paths.items()
        if path.startswith("/v1/stats/")
    }
    assert {name: set(re.findall(r"\w+", filters)) for name, filters in rows.items()} == served


def test_bounds_are_those_of_the_code() -> None:
    for bound in (
        stats.MAX_BUCKETS,
        stats.MAX_JOBS,
        stats.MAX_TIMES,
        stats.MAX_FIX_SEGMENTS,
        stats.MAX_POINTS,
        MAX_POINTS,
    ):
        assert f"{bound:,}" in PAGE, bound


def test_the_examples_run(api: Api) -> None:
    session_id = api.session_id()
    api.ok("POST", f"/v1/sessions/{session_id}/segments", json=plain(segment_body()))
    level_id = api.ok("GET", f"/v1/sessions/{session_id}")["level_id"]
    key = api.secrets[Scope.ADMIN]
    names = {"URL": "http://isodyn.test", "KEY": key, "SESSION": session_id, "LEVEL": level_id}
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    commands = [command for block in blocks for command in block.strip().splitlines()]
    for command in commands:
        run(api, command, names, {})
    assert len(commands) > 10
