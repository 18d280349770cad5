"""Gatherings of particles."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.filtering import Cloud, find_modes


def cloud_of(*places: tuple[float, float, int], spread: float = 0.5) -> Cloud:
    rng = np.random.default_rng(0)
    n = sum(count for *_, count in places)
    cloud = Cloud.empty(n)
    at = 0
    for x, y, count in places:
        cloud.p[0, at : at + count] = x + spread * rng.standard_normal(count)
        cloud.p[1, at : at + count] = y + spread * rng.standard_normal(count)
        at += count
    return cloud


def test_two_places_are_two_modes() -> None:
    first, second = find_modes(cloud_of((10.0, 5.0, 700), (60.0, -20.0, 300)))
    assert (first.x, first.y) == pytest.approx((10.0, 5.0), abs=0.1)
    assert (second.x, second.y) == pytest.approx((60.0, -20.0), abs=0.1)
    assert (first.weight, second.weight) == pytest.approx((0.7, 0.3), abs=1e-3)
    assert first.cov_xx == pytest.approx(0.25, rel=0.2)


def test_weights_count_not_heads() -> None:
    cloud = cloud_of((0.0, 0.0, 900), (50.0, 0.0, 100))
    cloud.p[14, 900:] *= 50.0
    cloud.p[14] /= cloud.p[14].sum()
    assert find_modes(cloud)[0].x == pytest.approx(50.0, abs=0.2)


def test_no_particle_counts_twice() -> None:
    rng = np.random.default_rng(1)
    cloud = Cloud.empty(5000)
    cloud.p[0], cloud.p[1] = rng.uniform(0, 100, (2, 5000))
    modes = find_modes(cloud)
    assert sum(mode.weight for mode in modes) <= 1.0 + 1e-9
    assert 1 <= len(modes) <= 5


def test_a_single_particle_is_a_mode() -> None:
    (mode,) = find_modes(cloud_of((3.0, 4.0, 1), spread=0.0))
    assert (mode.x, mode.y, mode.weight, mode.cov_xx) == (3.0, 4.0, pytest.approx(1.0), 0.0)


def test_a_cloud_over_a_continent_is_still_looked_at() -> None:
    """Cells grow with the spread: two-metre ones over a thousand kilometres would fill terabytes."""
    first, second = find_modes(cloud_of((0.0, 0.0, 600), (1e6, 1e6, 400)), most=2)
    assert (first.weight, second.weight) == pytest.approx((0.6, 0.4), abs=1e-3)
