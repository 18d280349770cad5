from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from PIL import Image

from app.api import rendering
from app.api.colours import COLOURS
from app.api.errors import RejectedError
from app.api.rendering import CHANNELS, Channel, ColourRange, Statistic
from app.engine.types import FeatureSet
from tests.support.builders import grid_map

masks = npst.arrays(np.bool_, npst.array_shapes(min_dims=2, max_dims=2, max_side=12))


@given(mapped=masks)
def test_run_lengths_give_back_the_mask(mapped: np.ndarray) -> None:
    runs = rendering.run_lengths(mapped)
    assert sum(runs) == mapped.size
    assert all(run > 0 for run in runs[1:])
    values = np.arange(len(runs)) % 2 == 1
    np.testing.assert_array_equal(np.repeat(values, runs).reshape(mapped.shape), mapped)


@pytest.mark.parametrize("features", list(FeatureSet))
@pytest.mark.parametrize("statistic", list(Statistic))
def test_every_channel_a_map_has_can_be_shown(features: FeatureSet, statistic: Statistic) -> None:
    grid = grid_map(features=features)
    for channel in CHANNELS[features]:
        values = rendering.field(grid, channel, statistic)
        assert (values.shape, values.dtype) == (grid.shape, np.float32)
        known = np.ones(grid.shape, dtype=bool) if statistic is Statistic.SUPPORT else grid.mapped
        np.testing.assert_array_equal(np.isfinite(values), known)
    for channel in set(Channel) - set(CHANNELS[features]):
        if statistic is not Statistic.SUPPORT:
            with pytest.raises(RejectedError):
                rendering.field(grid, channel, statistic)


def test_norms_of_the_vector() -> None:
    grid = grid_map(features=FeatureSet.VECTOR)
    x, y, z = grid.mean
    for channel, expected in (
        (Channel.H, np.hypot(x, y)),
        (Channel.V, z),
        (Channel.TOTAL, np.sqrt(x**2 + y**2 + z**2)),
    ):
        values = rendering.field(grid, channel, Statistic.MEAN)
        np.testing.assert_allclose(values[grid.mapped], expected[grid.mapped], rtol=1e-6)


def test_the_deviation_of_a_norm_is_that_of_simulated_fields() -> None:
    grid = grid_map(features=FeatureSet.VECTOR, rows=6, columns=6)
    grid = replace(grid, sd=np.full_like(grid.sd, 0.5) * np.array([1.0, 2.0, 3.0], np.float32)[:, None, None])
    rng = np.random.default_rng(1)
    drawn = grid.mean + grid.sd * rng.standard_normal((4000, *grid.mean.shape))
    simulated = np.sqrt((drawn**2).sum(axis=1)).std(axis=0)
    shown = rendering.field(grid, Channel.TOTAL, Statistic.SD)
    np.testing.assert_allclose(shown[grid.mapped], simulated[grid.mapped], rtol=0.08)


def test_a_zero_field_has_a_finite_deviation() -> None:
    grid = grid_map(features=FeatureSet.VECTOR, rows=4, columns=4)
    grid = replace(grid, mean=np.zeros_like(grid.mean))
    assert np.isfinite(rendering.field(grid, Channel.H, Statistic.SD)[grid.mapped]).all()


def test_the_image_is_north_up_and_clear_where_nothing_is_known() -> None:
    values = np.array([[0.0, 1.0], [np.nan, 0.5]], dtype=np.float32)
    pixels = np.asarray(Image.open(io.BytesIO(rendering.png(values, ColourRange(0.0, 1.0)))))
    np.testing.assert_array_equal(pixels[..., 3], [[0, 255], [255, 255]])
    np.testing.assert_array_equal(pixels[1, 0, :3], COLOURS[0])
    np.testing.assert_array_equal(pixels[1, 1, :3], COLOURS[-1])
    np.testing.assert_array_equal(pixels[0, 1, :3], COLOURS[128])


@given(values=npst.arrays(np.float32, (4, 5), elements=st.floats(-1e6, 1e6, width=32) | st.just(float("nan"))))
def test_any_raster_can_be_drawn(values: np.ndarray) -> None:
    shown = rendering.colour_range(values, None, None)
    assert shown.high > shown.low
    assert rendering.png_size(rendering.png(values, shown)) == (5, 4)


def test_a_chosen_range_is_kept() -> None:
    values = np.array([[0.0, 100.0]], dtype=np.float32)
    assert rendering.colour_range(values, 20.0, 60.0) == ColourRange(20.0, 60.0)
    assert rendering.colour_range(values, 60.0, 20.0).low == 60.0


def test_raw_is_little_endian_rows() -> None:
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert np.frombuffer(rendering.raw(values), "<f4").tolist() == [0, 1, 2, 3, 4, 5]


def test_lightness_rises_evenly() -> None:
    """CIE lightness of the colours: an independent measure (the table is made in OKLCH)."""
    linear = np.where(COLOURS <= 0.04045 * 255, COLOURS / 255 / 12.92, ((COLOURS / 255 + 0.055) / 1.055) ** 2.4)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    lightness = 116 * np.cbrt(luminance) - 16
    steps = np.diff(lightness[::16])
    assert (steps > 0).all()
    assert steps.max() < 2.0 * steps.min()
    assert lightness[-1] - lightness[0] > 60
