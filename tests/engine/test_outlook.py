"""What a planned route has in store."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.forecast import LOST_M, forecast_route
from app.engine.mapping.outlook import RouteOutlook, Stretch, Trouble, route_outlook
from app.engine.mapping.similarity import Rivals, find_rivals
from app.engine.types import GridMap
from tests.support.fields import field_map

ROUTE = np.array([[-8.0, -10.0], [52.0, -10.0]])


def level(seed: int = 1, **changes: object) -> GridMap:
    """70 m by 40 m from (-10, -20) on."""
    grid = field_map(np.random.default_rng(seed), shape=(80, 140), sd_ut=0.5)
    return replace(grid, noise_sd=(1.0, 1.0, 1.0), **changes)


def stretches(outlook: RouteOutlook, trouble: Trouble) -> list[Stretch]:
    return [one for one in outlook.stretches if one.trouble is trouble]


def test_a_good_map_gives_no_trouble() -> None:
    outlook = route_outlook(level(), ROUTE)
    assert outlook.stretches == ()
    assert outlook.mapped_share == 1.0
    assert outlook.mean_m < 1.5
    assert outlook.p90_m == pytest.approx(np.percentile(outlook.forecast.error, 90))


def test_a_gap_is_told_and_the_error_grows_in_it() -> None:
    support = np.zeros((80, 140), np.float32)
    support[:, 60:100] = 8.0  # x from 20 to 39.5 m: 28 to 47.5 m of the way
    outlook = route_outlook(level(support=support), ROUTE)
    (gap,) = stretches(outlook, Trouble.UNMAPPED)
    assert (gap.from_m, gap.to_m) == (pytest.approx(28.0, abs=0.5), pytest.approx(47.5, abs=0.5))
    way, error = outlook.forecast.way, outlook.forecast.error
    inside = (way >= gap.from_m) & (way <= gap.to_m)
    assert (np.diff(error[inside]) > 0).all()
    assert error[way > gap.to_m + 3.0].max() < error[inside].max()
    assert outlook.mapped_share == pytest.approx(1 - 40 / 121, abs=0.02)


def test_a_route_off_the_map_gets_lost() -> None:
    outlook = route_outlook(level(), np.array([[0.0, 0.0], [0.0, 500.0]]))
    (lost,) = stretches(outlook, Trouble.LOST)
    forecast = outlook.forecast
    at = int(np.searchsorted(forecast.way, lost.from_m))
    assert forecast.error[at] > LOST_M >= forecast.error[at - 1]
    assert lost.to_m == pytest.approx(500.0)


def test_a_corridor_that_has_a_double_is_ambiguous() -> None:
    grid = level()
    mean = grid.mean.copy()
    mean[:, 40:80] = mean[:, :40] + 3.0  # the same field 20 m further north, with another offset
    outlook = route_outlook(replace(grid, mean=mean), ROUTE)
    (double,) = stretches(outlook, Trouble.AMBIGUOUS)
    assert double.to_m == pytest.approx(60.0)
    assert double.rival_m == pytest.approx(20.0, abs=0.1)


def test_rivals_are_told_apart_by_the_noise_of_the_map() -> None:
    grid = level()
    forecast = forecast_route(grid, ROUTE)
    noisy = replace(grid, noise_sd=(30.0, 30.0, 30.0))
    sharp, blurred = find_rivals(grid, forecast), find_rivals(noisy, forecast)
    assert len(sharp.way) == len(blurred.way) == 5
    assert np.isinf(sharp.nats).all()
    assert (blurred.nats < 4.0).all()
    assert (blurred.distance >= 6.0).all()


def test_short_routes_are_not_compared() -> None:
    grid = replace(level(), noise_sd=(30.0, 30.0, 30.0))
    ways = [
        find_rivals(grid, forecast_route(grid, np.array([[-8.0, -10.0], [length - 8.0, -10.0]]))).way.tolist()
        for length in (19.0, 30.0, 47.0)
    ]
    assert ways == [[], [30.0], [40.0, 45.0]]


def test_a_route_shorter_than_a_stretch_looks_like_nothing() -> None:
    none = np.empty(0)
    assert not Rivals(none, none, none).ambiguous(np.linspace(0.0, 7.0, 8)).any()
