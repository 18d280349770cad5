"""Rules of the engine that a reader relies on."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import app.engine

MODULES = sorted(m.name for m in pkgutil.walk_packages(app.engine.__path__, "app.engine."))
TREES = {path: ast.parse(path.read_text()) for path in Path("app").rglob("*.py") if "migrations" not in path.parts}


def public_objects(name: str) -> Iterator[tuple[str, object]]:
    module = importlib.import_module(name)
    for key, value in vars(module).items():
        own = getattr(value, "__module__", None) == name
        if not key.startswith("_") and own and (inspect.isclass(value) or inspect.isfunction(value)):
            yield f"{name}.{key}", value


@pytest.mark.parametrize("name", MODULES)
def test_public_names_are_documented_and_annotated(name: str) -> None:
    for path, value in public_objects(name):
        assert inspect.getdoc(value), f"{path} has no docstring"
        if inspect.isfunction(value) and ".kernels." not in name:
            signature = inspect.signature(value)
            bare = [p.name for p in signature.parameters.values() if p.annotation is inspect.Parameter.empty]
            assert not bare, f"{path}: {bare} are not annotated"
            assert signature.return_annotation is not inspect.Signature.empty, f"{path} has no return annotation"


@pytest.mark.parametrize("name", [m for m in MODULES if ".kernels." in m])
def test_every_kernel_module_is_tested_against_a_twin(name: str) -> None:
    twins = "".join(path.read_text() for path in Path("tests/reference").glob("test_*.py"))
    assert name in twins or f"from app.engine.kernels import {name.rsplit('.', 1)[1]}" in twins


def test_functions_keep_to_their_size() -> None:
    """At most 50 lines without the docstring, 90 in kernels."""
    too_long = []
    for path, tree in TREES.items():
        limit = 90 if "kernels" in path.parts else 50
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                if body and (node.end_lineno or 0) - body[0].lineno + 1 > limit:
                    too_long.append(f"{path}:{node.lineno} {node.name}")
    assert not too_long


def test_nothing_draws_from_global_randomness() -> None:
    allowed = {"default_rng", "Generator", "SeedSequence"}
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Attribute)
                and node.value.attr == "random"
            ):
                assert node.attr in allowed, f"{path}:{node.lineno} uses numpy.random.{node.attr}"
