"""Placing the walks of a build, or going on from where an interrupted attempt at the same build was."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from app.engine.mapping.placing import PLACING, SHARE, PlacedWalks, place_walks
from app.engine.types import Progress, SurveyWalk
from app.services.ports import Checkpoints


@contextmanager
def placed_once(
    checkpoints: Checkpoints, walks: Sequence[SurveyWalk], *, align: bool, progress: Progress
) -> Iterator[PlacedWalks]:
    """Walks as an attempt placed them that did not end; else they are placed, and kept until the build is through."""
    key = content_key(walks, align=align)
    placed = checkpoints.load(key)
    if placed is None:
        placed = place_walks(walks, align=align, progress=lambda f, what: progress(SHARE * f, what))
        checkpoints.put(key, placed)
    yield placed
    checkpoints.drop(key)  # not when the build was cut short: then the next attempt wants it


def content_key(walks: Sequence[SurveyWalk], *, align: bool) -> str:
    """Hash of all that placing depends on: the walks with their samples, and the way it is done."""
    digest = hashlib.sha256(f"placing {PLACING} numpy {np.__version__} align {align}".encode())
    for walk in walks:
        digest.update(f"\n{walk.walk_id} {walk.device_heading!r}".encode())
        samples, waypoints = walk.samples, walk.waypoints
        arrays = (samples.t, samples.mag, samples.acc, samples.gyro, waypoints.t, waypoints.x, waypoints.y)
        for values in arrays:
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
