"""Checkpoints of builds: what is put comes back bit by bit, and files do not pile up."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.placing import PlacedWalks
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import WalkReport
from app.storage.checkpoints import KEPT, FileCheckpoints


def placed(*lengths: int) -> PlacedWalks:
    rng = np.random.default_rng(len(lengths))
    walks = tuple(
        PlacedSamples(
            f"wlk_{i}", rng.normal(size=n), rng.normal(size=(n, 2)), rng.normal(size=n), rng.normal(size=(n, 3)),
            None if i % 2 else 1.0 + i / 10,
        )
        for i, n in enumerate(lengths)
    )  # fmt: skip
    moved = tuple(replace(walk, xy=walk.xy + 0.1) for walk in walks)
    return PlacedWalks(walks, moved, (WalkReport("wlk_x", 0, 0.0, (), 0.0, rejected="stood still"),))


@pytest.mark.parametrize("lengths", [(5, 1, 7), (4,), ()])
def test_what_was_put_comes_back(tmp_path: Path, lengths: tuple[int, ...]) -> None:
    shelf = pickle.loads(pickle.dumps(FileCheckpoints(tmp_path / "new")))
    assert shelf.load("a") is None
    shelf.put("a", placed(*lengths))
    back, given = shelf.load("a"), placed(*lengths)
    assert back is not None
    assert back.rejected == given.rejected
    for name in ("labelled", "adjusted"):
        assert len(getattr(back, name)) == len(lengths)
        for one, other in zip(getattr(back, name), getattr(given, name), strict=True):
            for item in fields(one):
                np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name))
    shelf.drop("a")
    shelf.drop("a")
    assert shelf.load("a") is None


def test_a_damaged_file_is_as_good_as_none(tmp_path: Path) -> None:
    shelf = FileCheckpoints(tmp_path)
    shelf.put("a", placed(5))
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], b"x" * len(whole)):
        file.write_bytes(damaged)
        assert shelf.load("a") is None


def test_only_the_newest_stay(tmp_path: Path) -> None:
    shelf = FileCheckpoints(tmp_path)
    for i in range(KEPT + 3):
        shelf.put(f"{i}", placed(2))
    assert len(list(tmp_path.iterdir())) == KEPT
    assert shelf.load(f"{KEPT + 2}") is not None
