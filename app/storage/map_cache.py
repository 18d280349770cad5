"""Local cache of assembled maps: files that workers memory-map.

A map is ``<hash>.npy`` (all layers, float32) and ``<hash>.json`` (its header, and that of its radio layer if it has
one); the radio layer's bytes are ``<hash>.radio``, in numpy's format, and the survey's lines ``<hash>.routes``, as they
are stored. All appear by renaming, the layers last: whoever
sees them sees all of it, and two processes that fill the same entry write the same bytes.
"""

from __future__ import annotations

import json
import os
import threading
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.errors import MapError
from app.engine.types import GridMap, RouteLines
from app.services.records import MapInfo
from app.services.tasks import MapRef
from app.storage.radio import RadioHeader, radio_header_of, split_radio, stack_radio
from app.storage.routes import pack_routes, unpack_routes
from app.storage.tiles import MapHeader, header_of, split_layers, stack_layers

DEFAULT_MAX_BYTES = 4 * 1024**3
HEADER, RADIO, ROUTES = ".json", ".radio", ".routes"
_RADIO_KEY = "radio"


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
        if grid_map.radio is not None:
            radio = grid_map.radio
            _put(path.with_suffix(RADIO), lambda part: _save(part, stack_radio(radio)))
        if grid_map.routes is not None:
            routes = pack_routes(grid_map.routes)
            _put(path.with_suffix(ROUTES), lambda part: part.write_bytes(routes.data))
        _put(path.with_suffix(HEADER), lambda part: part.write_text(_header_text(grid_map)))
        _put(path, lambda part: _save(part, stack_layers(grid_map)))
        self._prune(keep=path)

    def _prune(self, keep: Path) -> None:
        entries = sorted(((entry.stat().st_mtime, entry) for entry in self._folder.glob("*.npy")), reverse=True)
        total = 0
        for _, entry in entries:
            total += entry.stat().st_size + _size(entry.with_suffix(RADIO)) + _size(entry.with_suffix(ROUTES))
            if total > self._max_bytes and entry != keep:
                # the layers first: without them the rest is no entry
                for file in (entry, *(entry.with_suffix(kind) for kind in (HEADER, RADIO, ROUTES))):
                    file.unlink(missing_ok=True)


def open_map(path: Path) -> GridMap:
    """Memory-map the map in ``path`` (``<hash>.npy``) with the files beside it."""
    try:
        values = json.loads(path.with_suffix(HEADER).read_text())
        radio_values = values.pop(_RADIO_KEY, None)
        layers = _mapped(path)
        radio_layers = None if radio_values is None else _mapped(path.with_suffix(RADIO))
    except FileNotFoundError as error:
        raise MapError(f"map {path.stem} is not in the cache") from error
    radio = None if radio_layers is None else split_radio(RadioHeader.from_values(radio_values), radio_layers)
    return split_layers(MapHeader.from_values(values), layers, radio, _routes(path.with_suffix(ROUTES)))


def _routes(path: Path) -> RouteLines | None:
    """Lines of a map; a map may have none, so their absence is no error."""
    try:
        return unpack_routes(path.read_bytes())
    except FileNotFoundError:
        return None


def _header_text(grid_map: GridMap) -> str:
    values = header_of(grid_map).values()
    if grid_map.radio is not None:
        values[_RADIO_KEY] = radio_header_of(grid_map.radio).values()
    return json.dumps(values)


def _mapped(path: Path) -> NDArray[Any]:
    layers: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    # a plain view: numpy.memmap is a subclass, whose every slice costs microseconds
    return layers.view(np.ndarray)


def _put(target: Path, write: Callable[[Path], object]) -> None:
    part = target.with_suffix(f".{os.getpid()}-{uuid.uuid4().hex}.tmp")
    write(part)
    part.replace(target)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _touch(path: Path) -> bool:
    try:
        os.utime(path)
    except FileNotFoundError:
        return False
    return True


def _save(path: Path, layers: NDArray[Any]) -> None:
    with path.open("wb") as file:
        np.save(file, layers, allow_pickle=False)
