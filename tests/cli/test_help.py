"""Every command explains itself, and quickly."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer.main

from app.cli.common import reflowed
from app.cli.root import app
from tests.cli.conftest import run

HEAVY = ("numpy", "httpx", "pydantic", "fastapi", "sqlalchemy", "numba", "scipy", "matplotlib", "isodyn_client")


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if hasattr(group, "commands"):
        for name, command in group.commands.items():
            yield from commands(command, (*path, name))
    else:
        yield path, group


ALL = dict(commands(typer.main.get_command(app)))


def test_the_commands_of_the_design_are_there() -> None:
    named = "serve demo survey map contributions locate replay stream session geofence webhook bridge evaluate bench"
    phones = "device recording markers follow"
    assert {path[0] for path in ALL} == {*named.split(), *phones.split(), "keys", "db"}


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_help_has_an_example_and_explains_every_parameter(path: tuple[str, ...]) -> None:
    command = ALL[path]
    assert f"Example:  isodyn {' '.join(path)}" in (command.help or "")
    for parameter in command.params:
        if parameter.name != "help":
            assert getattr(parameter, "help", None), parameter.name
    result = run(*path, "--help")
    assert result.exit_code == 0
    assert "Example:" in result.output


def test_paragraphs_flow_and_examples_stand_alone() -> None:
    text = """One
    two.

    .csv: a
    .json: b
    c
    Example:  x
    Example:  y
    """
    assert reflowed(text) == "One two.\n\n.csv: a\n.json: b c\nExample:  x\nExample:  y"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, contextlib, io\n"
        "from typer.testing import CliRunner\n"
        "from app.cli.root import app\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
