"""The documents: links lead somewhere, commands exist, Python examples run."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path
from typing import Any

import isodyn_client
import numpy as np
import pytest
import typer.main

from app.cli.convert import samples_of, to_ms
from app.cli.root import app
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / name
    for name in (
        "README.md",
        "docs/quickstart.md",
        "docs/how-it-works.md",
        "docs/uncertainty.md",
        "docs/surveying.md",
        "docs/tutorial-survey.md",
        "docs/maps.md",
        "docs/exchange.md",
        "docs/geofences.md",
        "docs/operations.md",
        "docs/outputs.md",
        "docs/vehicles.md",
        "docs/phones.md",
        "clients/python/README.md",
        "maps/README.md",
    )
]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)#]+)(?:#[^)]*)?\)")


def blocks(page: Path, language: str) -> list[str]:
    return [text for kind, text in _FENCE.findall(page.read_text()) if kind == language]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in _LINK.findall(page.read_text()):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), target


def command_lines(page: Path) -> list[str]:
    text = "\n".join(blocks(page, "sh")).replace("\\\n", " ")
    lines = [line.split("#")[0] for line in text.splitlines()]
    found = [match.group(1) for line in lines for match in [re.search(r"(?:^|\()\s*(isodyn [^)|]+)", line)] if match]
    inline = re.findall(r"`(isodyn [^`]+)`", _FENCE.sub("", page.read_text()))
    return found + inline


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_their_options_exist(page: Path) -> None:
    for line in command_lines(page):
        command: Any = typer.main.get_command(app)
        words = shlex.split(line)[1:]
        while words and hasattr(command, "commands") and words[0] in command.commands:
            command = command.commands[words.pop(0)]
        options = {flag for parameter in command.params for flag in parameter.opts} | {"--help"}
        if hasattr(command, "commands"):
            assert not [word for word in words if not word.startswith("--")], f"{line}: no such command"
        for word in words:
            assert not word.startswith("--") or word in options, f"{line}: no option {word}"


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name != "maps"], ids=name)
def test_python_examples_run(page: Path, service: Service, surveyed: Surveyed, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page run one after the other; recorded samples stand for the reader's own."""
    examples = blocks(page, "python")
    if not examples:
        pytest.skip("no Python on this page")
    monkeypatch.setenv("ISODYN_URL", service.url)
    monkeypatch.setenv("ISODYN_KEY", service.key)
    with service.client() as client:
        level = client.level(surveyed.level_id)
    # the examples take the first level they find, and an address that is not the test's
    monkeypatch.setattr(isodyn_client.Client, "levels", lambda self: iter([level]))
    walk = Ilc20Level("site1-F2", SAMPLE).walks("train")[0]
    samples = samples_of(walk.samples)
    names: dict[str, Any] = {
        **{column: getattr(samples, column) for column in ("t_ms", "mag", "acc", "gyro")},
        "waypoint_t_ms": to_ms(walk.waypoints.t),
        "waypoint_x": walk.waypoints.x,
        "waypoint_y": walk.waypoints.y,
        "np": np,
    }
    output = io.StringIO()
    for example in examples:
        here = example.replace('"http://127.0.0.1:8080", key="isk_..."', "")
        with contextlib.redirect_stdout(output):
            exec(compile(here, name(page), "exec"), names)
    assert output.getvalue()
