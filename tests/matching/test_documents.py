"""The page of methods says what the tables in the code say."""

from __future__ import annotations

from pathlib import Path

from app.engine.localization.choice import POLICY
from app.engine.localization.registry import METHODS
from app.engine.matching.criteria import CRITERIA

PAGE = Path("docs/methods.md").read_text()


def test_every_method_is_described() -> None:
    for method in METHODS.values():
        row = next(line for line in PAGE.splitlines() if line.startswith(f"| `{method.name}` |"))
        assert method.summary.rstrip(".") in row
        assert method.reference in row


def test_every_criterion_and_what_it_forgives() -> None:
    for name, note in CRITERIA.items():
        assert f"| `{name}` |" in PAGE
        assert note.forgives in PAGE


def test_the_policy_is_that_of_the_code() -> None:
    rows = [line for line in PAGE.splitlines() if any(line.startswith(f"| {i} |") for i in range(1, len(POLICY) + 1))]
    assert rows == [f"| {i} | `{row.method}` | {row.why} |" for i, row in enumerate(POLICY, 1)]
