from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.api.harness import Api, Options


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    made = Api(tmp_path)
    yield made
    made.close()


@pytest.fixture
def make_api(tmp_path: Path) -> Iterator[Callable[..., Api]]:
    """Build an application with other settings."""
    made: list[Api] = []

    def make(*, max_queued: int = 1000, **options: object) -> Api:
        api = Api(tmp_path / f"api{len(made)}", Options(**options), max_queued=max_queued)  # type: ignore[arg-type]
        made.append(api)
        return api

    yield make
    for api in made:
        api.close()
