"""What a planned route has in store: expected errors, and stretches where the position will be lost or doubtful."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.engine.mapping.forecast import LOST_M, PHONE, RouteForecast, WalkerErrors, forecast_route
from app.engine.mapping.similarity import Rivals, find_rivals
from app.engine.types import BoolArray, Float64Array, GridMap

SHORTEST_M = 1.0
"""Stretches shorter than this are not worth telling."""


class Trouble(StrEnum):
    """What is wrong with a stretch."""

    UNMAPPED = "unmapped"
    """No map: only dead reckoning goes on."""
    LOST = "lost"
    """The expected error is above 5 m."""
    AMBIGUOUS = "ambiguous"
    """The 40 m before it look like another place: a session that starts on the way may be put there."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a route, metres walked from and to; ``rival_m``: how far off the other place is, where ambiguous."""

    trouble: Trouble
    from_m: float
    to_m: float
    rival_m: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RouteOutlook:
    """Forecast of a route with its summary.

    Attributes
    ----------
    forecast : RouteForecast
    stretches : tuple of Stretch
        In order of trouble, then of the way.
    mapped_share : float
    mean_m, p90_m : float, m
        Mean and 90th percentile of the expected error along the way.
    """

    forecast: RouteForecast
    stretches: tuple[Stretch, ...]
    mapped_share: float
    mean_m: float
    p90_m: float


def route_outlook(grid_map: GridMap, route: Float64Array, errors: WalkerErrors = PHONE) -> RouteOutlook:
    """Expected accuracy along a route, shape (k, 2) corners in level metres, and where it will be poor.

    Raises
    ------
    InputError
        Fewer than two different points.
    MapError
        The map is smaller than two by two nodes.
    """
    forecast = forecast_route(grid_map, route, errors)
    rivals = find_rivals(grid_map, forecast, errors)
    way = forecast.way
    stretches = [
        *(Stretch(Trouble.UNMAPPED, a, b) for a, b in _runs(way, ~forecast.mapped)),
        *(Stretch(Trouble.LOST, a, b) for a, b in _runs(way, forecast.error > LOST_M)),
        *(Stretch(Trouble.AMBIGUOUS, a, b, _rival(rivals, a, b)) for a, b in _runs(way, rivals.ambiguous(way))),
    ]
    return RouteOutlook(
        forecast=forecast,
        stretches=tuple(stretches),
        mapped_share=float(forecast.mapped.mean()),
        mean_m=float(forecast.error.mean()),
        p90_m=float(np.percentile(forecast.error, 90)),
    )


def _runs(way: Float64Array, mask: BoolArray) -> list[tuple[float, float]]:
    """Parts of the way where a mask holds, m."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    runs = [(float(way[a]), float(way[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in runs if b - a >= SHORTEST_M]


def _rival(rivals: Rivals, from_m: float, to_m: float) -> float | None:
    """Distance of the most alike place of a stretch."""
    on = np.flatnonzero((rivals.way >= from_m - 1e-9) & (rivals.way <= to_m + 1e-9) & np.isfinite(rivals.nats))
    return float(rivals.distance[on[rivals.nats[on].argmin()]]) if len(on) else None
