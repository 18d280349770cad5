"""The first stage of a map: survey walks placed between their labels, and moved to where they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.errors import InputError
from app.engine.mapping.adjustment import adjust_walks
from app.engine.mapping.samples import PlacedSamples, place_samples
from app.engine.types import Progress, SurveyWalk, WalkReport

PLACING = 1
"""Number of the way walks are placed: raised with every change of it, lest builds go on from what it made before."""
SHARE = 0.3
"""Of the time that a build takes, about."""
_PLACED = 2 / 3


@dataclass(frozen=True, slots=True)
class PlacedWalks:
    """Walks that could be placed, by their labels and as adjusted to one another, and reports of the others."""

    labelled: tuple[PlacedSamples, ...]
    adjusted: tuple[PlacedSamples, ...]
    rejected: tuple[WalkReport, ...]


def place_walks(walks: Sequence[SurveyWalk], *, align: bool, progress: Progress) -> PlacedWalks:
    """Place walks by steps; with ``align`` also move them to where they agree with one another."""
    placed, rejected = [], []
    for i, walk in enumerate(walks):
        try:
            placed.append(place_samples(walk))
        except InputError as error:
            rejected.append(WalkReport(walk.walk_id, 0, 0.0, (), 0.0, rejected=str(error)))
        progress(_PLACED * ((i + 1) / len(walks)), "placing walks")
    adjusted = placed
    if align and placed:
        adjusted = adjust_walks(placed, progress=lambda f, what: progress(_PLACED + (1.0 - _PLACED) * f, what))
    return PlacedWalks(tuple(placed), tuple(adjusted), tuple(rejected))
