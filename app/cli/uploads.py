"""Data-set folders as a service needs them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.errors import InputFileError
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk
from app.evaluation.drivers import LevelUpload

if TYPE_CHECKING:
    from app.evaluation.datasets.ilc20 import Split


def open_level(folder: Path) -> Ilc20Level:
    """The level in a data-set folder (the folder of one level, with ``floor.json`` and ``traces.parquet``)."""
    if not (folder / "floor.json").is_file():
        raise InputFileError(folder, "holds no floor.json; name the folder of one level, such as ilc20/site1-F2")
    return Ilc20Level(folder.resolve().name, folder)


def level_upload(level: Ilc20Level) -> LevelUpload:
    """A level with its plans."""
    image = level.plan_png_path
    return LevelUpload(
        site=level.site,
        name=level.floor,
        ordinal=level.ordinal,
        extent=level.extent,
        plan_png=image.read_bytes() if image else None,
        vector_plan=level.vector_plan,
    )


def choose_walks(level: Ilc20Level, split: Split | None, names: Sequence[str], limit: int | None) -> list[RecordedWalk]:
    """Walks of a split, only those named (by the start of their id) if any are, at most ``limit``."""
    walks = [walk for walk in level.walks(split) if not names or walk.walk_id.startswith(tuple(names))]
    if not walks:
        wanted = f" that start with {' or '.join(names)}" if names else ""
        raise InputFileError(level.folder, f"holds no walks of split {split or 'any'}{wanted}")
    return walks[:limit]
