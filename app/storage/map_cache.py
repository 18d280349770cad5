"""Local cache of assembled maps: files that workers memory-map.

A map is ``<hash>.npy`` (all layers, float32) and ``<hash>.json`` (its header). Both appear by renaming, the array
last: whoever sees it sees all of it, and two processes that fill the same entry write the same bytes.
"""

from __future__ import annotations

import os
import threading
import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np

from app.engine.errors import MapError
from app.engine.types import Float32Array, GridMap
from app.services.records import MapInfo
from app.services.tasks import MapRef
from app.storage.tiles import MapHeader, header_of, split_layers, stack_layers

DEFAULT_MAX_BYTES = 4 * 1024**3


class FileMapCache:
    """Maps by content hash in one folder (the port ``MapCache``).

    Beyond ``max_bytes`` the entries that were unused for longest are deleted, never the one just filled. A worker
    that has an entry mapped keeps it: deleting a file does not unmap it.
    """

    def __init__(self, folder: Path, *, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._fill_lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)

    def ref(self, info: MapInfo, load: Callable[[], GridMap]) -> MapRef:
        """File of this map, filled by ``load`` if it is missing."""
        path = self._folder / f"{info.hash}.npy"
        if not _touch(path):
            with self._fill_lock:  # not two threads at once: assembling costs memory
                if not _touch(path):
                    self._fill(path, load())
        return MapRef(level_id=info.level_id, hash=info.hash, path=path)

    def open(self, ref: MapRef) -> GridMap:
        """Memory-map a cached map; its arrays are read-only."""
        return open_map(ref.path)

    def _fill(self, path: Path, grid_map: GridMap) -> None:
        unique = f".{os.getpid()}-{uuid.uuid4().hex}.tmp"
        header, array = path.with_suffix(".json"), path
        for target, write in (
            (header, lambda part: part.write_text(header_of(grid_map).to_json())),
            (array, lambda part: _save(part, stack_layers(grid_map))),
        ):
            part = target.with_suffix(unique)
            write(part)
            part.replace(target)
        self._prune(keep=path)

    def _prune(self, keep: Path) -> None:
        entries = sorted(
            ((entry.stat().st_mtime, entry.stat().st_size, entry) for entry in self._folder.glob("*.npy")), reverse=True
        )
        total = 0
        for _, size, entry in entries:
            total += size
            if total > self._max_bytes and entry != keep:
                entry.unlink(missing_ok=True)
                entry.with_suffix(".json").unlink(missing_ok=True)


def open_map(path: Path) -> GridMap:
    """Memory-map the map in ``path`` (``<hash>.npy`` beside ``<hash>.json``)."""
    try:
        header = MapHeader.from_json(path.with_suffix(".json").read_text())
        layers: Float32Array = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError as error:
        raise MapError(f"map {path.stem} is not in the cache") from error
    # a plain view: numpy.memmap is a subclass, whose every slice costs microseconds
    return split_layers(header, layers.view(np.ndarray))


def _touch(path: Path) -> bool:
    try:
        os.utime(path)
    except FileNotFoundError:
        return False
    return True


def _save(path: Path, layers: Float32Array) -> None:
    with path.open("wb") as file:
        np.save(file, layers, allow_pickle=False)
