"""Checkpoints of map builds: placed and adjusted walks as files, so that an interrupted build goes on with kriging.

One file a build, in numpy's format, named by the content that the build started from. It appears by renaming and is
deleted when the build is through; of those left behind by builds that were never taken up again, the newest stay.
"""

from __future__ import annotations

import json
import os
import uuid
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from app.engine.mapping.placing import PlacedWalks
from app.engine.mapping.samples import PlacedSamples
from app.engine.types import Float64Array, WalkReport

KEPT = 8
_LABELLED, _ADJUSTED = "labelled", "adjusted"


@dataclass(frozen=True, slots=True)
class FileCheckpoints:
    """Checkpoints in one folder (the port ``Checkpoints``); pickles, so that workers can have it."""

    folder: Path

    def load(self, key: str) -> PlacedWalks | None:
        """What was put under the key; None if there is nothing, or it is damaged."""
        try:
            with np.load(self._path(key), allow_pickle=False) as stored:
                return _unpack({name: stored[name] for name in stored.files})
        except (OSError, KeyError, ValueError, zipfile.BadZipFile):
            return None  # only time is lost: the walks are placed anew

    def put(self, key: str, placed: PlacedWalks) -> None:
        """Keep it under the key."""
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self.folder / f"{os.getpid()}-{uuid.uuid4().hex}.tmp"
        with part.open("wb") as file:
            np.savez(file, **_pack(placed))  # type: ignore[arg-type]
        part.replace(self._path(key))
        files = sorted(self.folder.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in files[KEPT:]:
            old.unlink(missing_ok=True)

    def drop(self, key: str) -> None:
        """Delete what is under the key, if there is something."""
        self._path(key).unlink(missing_ok=True)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def _pack(placed: PlacedWalks) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
    walks = placed.labelled
    plain = {
        "walks": [[walk.walk_id, walk.stride_scale, len(walk)] for walk in walks],
        "rejected": [asdict(report) for report in placed.rejected],
    }
    return {
        "plain": np.frombuffer(json.dumps(plain).encode(), np.uint8),
        "t": _joined([walk.t for walk in walks], ()),
        "heading": _joined([walk.heading for walk in walks], ()),
        "mag": _joined([walk.mag for walk in walks], (3,)),
        _LABELLED: _joined([walk.xy for walk in walks], (2,)),
        _ADJUSTED: _joined([walk.xy for walk in placed.adjusted], (2,)),
    }


def _joined(parts: list[Float64Array], width: tuple[int, ...]) -> Float64Array:
    return np.concatenate(parts) if parts else np.empty((0, *width))


def _unpack(stored: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]) -> PlacedWalks:
    plain = json.loads(stored["plain"].tobytes())
    ends = np.cumsum([n for _, _, n in plain["walks"]])[:-1]
    cut = {name: np.split(stored[name], ends) for name in ("t", "heading", "mag", _LABELLED, _ADJUSTED)}

    def walks(positions: str) -> tuple[PlacedSamples, ...]:
        return tuple(
            PlacedSamples(walk_id, cut["t"][i], cut[positions][i], cut["heading"][i], cut["mag"][i], scale)
            for i, (walk_id, scale, _) in enumerate(plain["walks"])
        )

    rejected = tuple(WalkReport(**{**one, "offset": tuple(one["offset"])}) for one in plain["rejected"])
    return PlacedWalks(walks(_LABELLED), walks(_ADJUSTED), rejected)
