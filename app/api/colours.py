"""A perceptually uniform colour map: lightness rises evenly while the hue turns from blue over green to yellow.

Computed once from OKLCH (B. Ottosson, "A perceptual color space for image processing", 2020,
https://bottosson.github.io/posts/oklab/): equal steps of the value are equal steps of perceived lightness, also for
readers who cannot tell hues apart and on paper in grey.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.types import Float64Array

N_COLOURS = 256
_LIGHTNESS = (0.25, 0.95)
_HUE_DEG = (285.0, 100.0)
_CHROMA = (0.10, 0.16, 0.15)

# OKLab to the cube roots of cone responses, and cone responses to linear sRGB (same source).
_TO_LMS = np.array(
    [[1.0, 0.3963377774, 0.2158037573], [1.0, -0.1055613458, -0.0638541728], [1.0, -0.0894841775, -1.2914855480]]
)
_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def _oklch_to_srgb(lightness: Float64Array, chroma: Float64Array, hue: Float64Array) -> NDArray[np.uint8]:
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    linear = np.clip(((lab @ _TO_LMS.T) ** 3) @ _TO_RGB.T, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    table: NDArray[np.uint8] = np.round(encoded * 255).astype(np.uint8)
    return table


def _table() -> NDArray[np.uint8]:
    u = np.linspace(0.0, 1.0, N_COLOURS)
    lightness = np.interp(u, [0.0, 1.0], _LIGHTNESS)
    chroma = np.interp(u, [0.0, 0.5, 1.0], _CHROMA)
    return _oklch_to_srgb(lightness, chroma, np.radians(np.interp(u, [0.0, 1.0], _HUE_DEG)))


COLOURS = _table()
"""Shape (256, 3), sRGB, from low to high."""
COLOURS.flags.writeable = False
