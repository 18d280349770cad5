"""What is committed below maps/: registry, licence, hash, recipe, and the script that makes it."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.engine.types import FeatureSet
from app.evaluation.datasets.ilc20 import WIFI_MAX_AGE_MS, open_ilc20
from app.evaluation.errors import DataSetError
from app.evaluation.protocol import EvaluationOptions
from app.evaluation.recipes import load_recipe

MAPS = Path(__file__).parents[2] / "maps"
REGISTRY: dict[str, Any] = tomllib.loads((MAPS / "registry.toml").read_text())
SAMPLES: list[dict[str, str]] = REGISTRY["samples"]


def test_every_sample_folder_is_registered() -> None:
    found = {path.parent.relative_to(MAPS).as_posix() for path in (MAPS / "samples").rglob("PROVENANCE.md")}
    data = {path.parent.relative_to(MAPS).as_posix() for path in (MAPS / "samples").rglob("*.parquet")}
    assert found == data == {entry["path"] for entry in SAMPLES}


@pytest.mark.parametrize("entry", SAMPLES, ids=lambda entry: entry["name"])
def test_sample_is_what_the_registry_says(entry: dict[str, str]) -> None:
    folder = MAPS / entry["path"]
    names = sorted(path.name for path in folder.iterdir() if path.name not in ("LICENSE", "PROVENANCE.md"))
    lines = "".join(f"{hashlib.sha256((folder / n).read_bytes()).hexdigest()}  {n}\n" for n in names)
    assert hashlib.sha256(lines.encode()).hexdigest() == entry["sha256"]
    licence = (folder / "LICENSE").read_text()
    assert entry["licence"] == "MIT"
    assert "Permission is hereby granted, free of charge" in licence
    assert entry["copyright"].removeprefix("(c) ") in licence
    provenance = (folder / "PROVENANCE.md").read_text()
    assert entry["source"] in provenance
    assert f"age_ms <= {WIFI_MAX_AGE_MS}" in provenance


def test_samples_stay_small() -> None:
    assert sum(path.stat().st_size for path in (MAPS / "samples").rglob("*") if path.is_file()) <= 8_000_000


@pytest.mark.parametrize("entry", SAMPLES, ids=lambda entry: entry["name"])
def test_recipe_of_a_sample(entry: dict[str, str]) -> None:
    recipe = load_recipe(MAPS / entry["recipe"])
    assert recipe.level in open_ilc20(MAPS / "samples").levels()
    assert (recipe.format, recipe.split) == (entry["format"], "train")
    assert recipe.settings.features is FeatureSet.VECTOR
    assert recipe.settings == EvaluationOptions(MAPS).map_settings


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('features = "vector"', 'features = "smell"', "map.features"),
        ("cell_m = 0.5", 'cell_m = "half"', "map.cell_m: needs a float"),
        ("cell_m = 0.5", "cell_m = true", "map.cell_m: needs a float"),
        ("cell_m = 0.5", "", r"needs a section \[map\]"),
        ("[source]", "[sauce]", r"needs a section \[source\]"),
        ("[map]", "[map", "cannot be read"),
    ],
)
def test_a_faulty_recipe_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (MAPS / SAMPLES[0]["recipe"]).read_text()
    assert old in text
    (tmp_path / "r.toml").write_text(text.replace(old, new))
    with pytest.raises(DataSetError, match=message):
        load_recipe(tmp_path / "r.toml")


def test_the_script_keeps_every_value(tmp_path: Path) -> None:
    script = [sys.executable, str(MAPS / "make_sample.py")]
    assert "--data" in subprocess.run([*script, "--help"], check=True, capture_output=True, text=True).stdout
    subprocess.run([*script, "--data", str(MAPS / "samples"), "--out", str(tmp_path)], check=True, capture_output=True)
    ours, again = (open_ilc20(folder).level("site1-F2") for folder in (MAPS / "samples", tmp_path))
    for a, b in zip(ours.walks(), again.walks(), strict=True):
        for name in ("t", "mag", "acc", "gyro"):
            np.testing.assert_array_equal(getattr(a.samples, name), getattr(b.samples, name))
        np.testing.assert_array_equal(a.waypoints.x, b.waypoints.x)
        assert (a.wifi is None) == (b.wifi is None)
        assert a.wifi is None or b.wifi is None or a.wifi.address == b.wifi.address
    assert ours.vector_plan == again.vector_plan
