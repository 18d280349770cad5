"""Recipes: which walks a map is built from and with which settings, as a small TOML file."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.engine.types import FeatureSet, MapBuildSettings
from app.evaluation.errors import DataSetError


@dataclass(frozen=True, slots=True)
class Recipe:
    """A way to build one map."""

    format: str
    level: str
    split: str
    settings: MapBuildSettings


def load_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises
    ------
    DataSetError
        The file cannot be read, lacks a key, has one too many or a value of another kind.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error
    source = _section(path, content, "source", {"format": str, "level": str, "split": str})
    settings = _section(path, content, "map", {"features": str, "cell_m": float, "mapped_m": float})
    try:
        features = FeatureSet(settings["features"])
    except ValueError as error:
        raise DataSetError(path, f"map.features: {error}") from error
    return Recipe(
        format=source["format"],
        level=source["level"],
        split=source["split"],
        settings=MapBuildSettings(features, cell_m=settings["cell_m"], mapped_m=settings["mapped_m"]),
    )


def _section(path: Path, content: dict[str, Any], name: str, kinds: dict[str, type]) -> dict[str, Any]:
    section = content.get(name)
    if not isinstance(section, dict) or set(section) != set(kinds):
        raise DataSetError(path, f"needs a section [{name}] with exactly {', '.join(kinds)}")
    for key, kind in kinds.items():
        if kind is float and isinstance(section[key], int) and not isinstance(section[key], bool):
            section[key] = float(section[key])
        if not isinstance(section[key], kind):
            raise DataSetError(path, f"{name}.{key}: needs a {kind.__name__}, got {section[key]!r}")
    return section
