"""What of the machine matters to operators (the port ``Host``): the disk of the data folder, and the workers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from app.services.stats_records import DiskUsage


class LocalHost:
    """The disk that holds the data folder, and the workers of this process.

    Parameters
    ----------
    database : Path
        The SQLite file; its log lies beside it and counts too.
    map_cache : Path
        Folder of the unpacked maps, a flat one.
    alive : callable
        How many workers are ready for segments.
    wanted : int
        How many there should be.
    """

    def __init__(self, database: Path, map_cache: Path, *, alive: Callable[[], int], wanted: int) -> None:
        self._database = database
        self._map_cache = map_cache
        self._alive = alive
        self._wanted = wanted

    def disk(self) -> DiskUsage:
        """Bytes of the database and the cached maps, and what is left of their disk."""
        folder = next((one for one in (self._database, *self._database.parents) if one.exists()), Path("/"))
        disk = shutil.disk_usage(folder)
        files = (self._database.with_name(self._database.name + end) for end in ("", "-wal", "-shm"))
        with os.scandir(self._map_cache) as entries:
            cached = sum(map(_size, entries))
        return DiskUsage(
            database=sum(map(_size, files)),
            map_cache=cached,
            free=disk.free,
            total=disk.total,
        )

    def workers(self) -> tuple[int, int]:
        """Workers for segments that are ready, and how many there should be."""
        return self._alive(), self._wanted


def _size(file: Path | os.DirEntry[str]) -> int:
    try:
        return file.stat().st_size
    except FileNotFoundError:  # the cache makes room, and the database folds its log, whenever they like
        return 0
