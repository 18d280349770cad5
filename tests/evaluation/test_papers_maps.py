"""Maps of flight lines: nothing of a left-out line is in them, and they say how wrong they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.matching import read_map
from app.engine.types import FeatureSet
from app.evaluation.datasets.aero import AeroSurvey, open_aero
from app.evaluation.errors import DataSetError
from app.evaluation.papers import anomalies
from app.evaluation.papers.anomalies import (
    AnomalySettings,
    LineSurvey,
    PlacedSegment,
    cached_map,
    crop,
    inset,
    map_path,
    overview_map,
    place_survey,
    stretches,
    thin,
    window_map,
    windows_of,
)
from tests.evaluation.surveys import SETTINGS, anomaly_nt, write_aero

EXTENT = (200.0, -8600.0, 17_800.0, 8600.0)


@pytest.fixture(scope="module", autouse=True)
def few_points() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(anomalies, "_FIT_POINTS", 300)
        yield


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> AeroSurvey:
    folder = tmp_path_factory.mktemp("data")
    write_aero(folder / "aero")
    return open_aero(folder).survey("rio")


@pytest.fixture(scope="module")
def placed(survey: AeroSurvey) -> LineSurvey:
    return place_survey(survey, SETTINGS)


def test_whole_lines_are_left_out_and_ties_never(placed: LineSurvey) -> None:
    known, left_out = ({segment.line for segment in part} for part in (placed.known, placed.left_out))
    assert not known & left_out
    assert len(left_out) == 7  # one of five of 37
    assert sum(segment.tie for segment in placed.known) == 2
    across = sorted(float(segment.xy[:, 0].mean()) for segment in placed.left_out)
    np.testing.assert_allclose(np.diff(across), 5000.0, rtol=0.01)


def test_lines_lie_where_they_were_flown(placed: LineSurvey) -> None:
    for segment in placed.known[:5]:
        expected = 1e-3 * anomaly_nt(*segment.xy.T)
        np.testing.assert_allclose(segment.values, expected, atol=2e-3)
        assert np.all(np.diff(segment.way) > 0.0)


def test_left_out_lines_do_not_change_the_map(placed: LineSurvey) -> None:
    elsewhere = tuple(replace(segment, values=segment.values + 9.0) for segment in placed.left_out)
    maps = [window_map(one, EXTENT, SETTINGS) for one in (placed, replace(placed, left_out=elsewhere))]
    np.testing.assert_array_equal(maps[0].mean, maps[1].mean)
    known = tuple(replace(segment, values=segment.values + 9.0) for segment in placed.known)
    assert np.abs(window_map(replace(placed, known=known), EXTENT, SETTINGS).mean - maps[0].mean).min() > 8.0


def test_the_map_says_how_wrong_it_is(placed: LineSurvey) -> None:
    grid_map = window_map(placed, EXTENT, SETTINGS)
    inside = stretches(placed.left_out, EXTENT, 5000.0)
    assert len(inside) == 4
    for_left_out = []
    for segment in inside:
        reading = read_map(grid_map, FeatureSet.TOTAL, *segment.xy.T)
        sd = np.hypot(reading.sd[:, 0], grid_map.noise_sd[0])
        for_left_out.append((segment.values - reading.mean[:, 0]) / sd)
    assert 0.3 < float(np.sqrt(np.mean(np.concatenate(for_left_out) ** 2))) < 2.0
    assert grid_map.features is FeatureSet.TOTAL
    assert float(np.std(grid_map.mean)) == pytest.approx(0.06, rel=0.5)  # microtesla, not nanotesla


def test_windows_tell_smooth_from_rough(placed: LineSurvey) -> None:
    overview = overview_map(placed, SETTINGS)
    west, east = sorted(windows_of(placed, overview, SETTINGS, 12_000.0), key=lambda window: window.extent[0])
    assert east.gradient_nt_km > 1.3 * west.gradient_nt_km
    assert windows_of(placed, overview, replace(SETTINGS, lines=5), 12_000.0) == []
    assert windows_of(placed, overview, SETTINGS, 16_000.0) == []  # no line is so long inside the inset


def test_a_crop_reads_like_the_whole(placed: LineSurvey) -> None:
    whole = overview_map(placed, SETTINGS)
    part = crop(whole, EXTENT)
    assert part.extent[0] >= EXTENT[0]
    assert part.extent[3] <= EXTENT[3]
    x, y = np.array([1000.0, 9000.0]), np.array([0.0, -3000.0])
    for one in ("mean", "sd", "gradient"):
        a, b = (getattr(read_map(m, FeatureSet.TOTAL, x, y), one) for m in (whole, part))
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_stretches_end_at_gaps_and_edges() -> None:
    x = np.concatenate([np.arange(0.0, 5000.0, 100.0), np.arange(8000.0, 12_000.0, 100.0)])
    segment = PlacedSegment("a", "a", False, np.stack([x, np.zeros_like(x)], axis=1), np.zeros_like(x))
    found = stretches([segment], (1000.0, -1.0, 11_000.0, 1.0), 2000.0)
    assert [(part.xy[0, 0], part.xy[-1, 0]) for part in found] == [(1000.0, 4900.0), (8000.0, 11_000.0)]
    assert stretches([segment], (1000.0, -1.0, 11_000.0, 1.0), 3500.0)[0].xy[0, 0] == 1000.0
    assert stretches([segment], (1000.0, 5.0, 11_000.0, 9.0), 1.0) == []


def test_thinning_keeps_means() -> None:
    x = np.arange(0.0, 1000.0, 50.0)
    segment = PlacedSegment("a", "a", False, np.stack([x, np.zeros_like(x)], axis=1), 2.0 * x)
    xy, values = thin(segment, 200.0)
    assert len(values) == 5
    np.testing.assert_allclose(values, 2.0 * xy[:, 0])


def test_the_cache_gives_the_same_map(survey: AeroSurvey, placed: LineSurvey, tmp_path: Path) -> None:
    path = map_path(tmp_path, survey, SETTINGS, EXTENT)
    first = cached_map(path, lambda: window_map(placed, EXTENT, SETTINGS))
    again = cached_map(path, lambda: pytest.fail("built anew"))
    np.testing.assert_array_equal(first.mean, again.mean)
    assert map_path(tmp_path, survey, SETTINGS, None) != path
    assert map_path(tmp_path, survey, AnomalySettings(), EXTENT) != path
    assert map_path(None, survey, SETTINGS, EXTENT) is None


def test_too_few_lines(tmp_path: Path) -> None:
    write_aero(tmp_path / "aero", spacing_m=40_000.0)
    with pytest.raises(DataSetError, match="too few flight lines"):
        place_survey(open_aero(tmp_path).survey("rio"), replace(SETTINGS, every=9))


def test_the_inset() -> None:
    assert inset((0.0, 1.0, 10_000.0, 10_001.0), SETTINGS) == (1500.0, 1501.0, 8500.0, 8501.0)
