"""What a warping costs here and in dtaidistance, the fastest library that does the same on one processor core.

Each function makes its data of the generator and gives ``(ours, peer, units)``: two calls without arguments, the second
None where dtaidistance is not installed or has no such thing, and how many windows or searches one call of *each* is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from app.engine.kernels.dtw import classic_subsequence, classic_windows, skipping_windows
from app.engine.kernels.lanes import FAR, LANES
from app.engine.matching.dtw.bands import Band, full_band, itakura_band
from app.engine.matching.dtw.library import into_lanes, out_of_lanes
from app.engine.matching.dtw.placing import warp
from app.engine.matching.dtw.quantize import quantize
from app.engine.matching.dtw.search import Steps
from app.engine.types import Float64Array

Call = Callable[[], object]
Timed = tuple[Call, Call | None, int]

_POINTS = 120
_WINDOWS = 64 * LANES
_PROFILE = 100_000


def dtw_f32(rng: np.random.Generator) -> Timed:
    """One channel, all pairs, squared differences in float32: a window."""
    query, windows = _windows(rng, 1)
    ours = _over_windows(query.astype(np.float32), windows.astype(np.float32), full_band(_POINTS, _POINTS))
    return ours, _peer_windows(query, windows), _WINDOWS


def dtw_u16(rng: np.random.Generator) -> Timed:
    """One channel, all pairs, absolute differences in quanta of 0.1 uT: a window."""
    query, windows = _windows(rng, 1)
    low = np.array([min(query.min(), windows.min())])
    ours = _over_windows(quantize(query, low), quantize(windows, low), full_band(_POINTS, _POINTS))
    return ours, _peer_windows(query, windows), _WINDOWS


def dtw_itakura_3d(rng: np.random.Generator) -> Timed:
    """Three channels, skipping steps inside the parallelogram, float32; the peer takes all pairs: a window."""
    query, windows = _windows(rng, 3)
    band = itakura_band(_POINTS, _POINTS)
    assert band is not None  # noqa: S101
    return _over_windows(query.astype(np.float32), windows.astype(np.float32), band), _peer_3d(query, windows), _WINDOWS


def subsequence_dtw(rng: np.random.Generator) -> Timed:
    """One channel over a profile of 100,000 points with open ends, float32, and the path of the best: a search."""
    profile = _profile(rng, _PROFILE, 1)
    at = 40_000 + 1.1 * np.arange(_POINTS)
    query = np.interp(at, np.arange(_PROFILE), profile[:, 0])[:, None] + rng.standard_normal((_POINTS, 1))
    lanes = into_lanes(profile, 2 * _POINTS, 0)[0].astype(np.float32)

    def ours() -> object:
        column = np.full((_POINTS, LANES), FAR["float32"])
        out = np.empty((len(lanes), LANES), dtype=np.float32)
        classic_subsequence(query.astype(np.float32), lanes, (0,), column, out)
        end = int(np.argmin(out_of_lanes(out[2 * _POINTS :].astype(np.float64), _PROFILE)))
        first = max(end - 2 * _POINTS, 0)
        stretch = profile[first : end + 1]
        band = full_band(_POINTS, len(stretch))
        return warp(query, stretch, first, band, Steps.CLASSIC, open_ends=(True, False))

    return ours, _peer_subsequence(query[:, 0].copy(), profile[:, 0].copy()), 1


def _profile(rng: np.random.Generator, n: int, channels: int) -> Float64Array:
    """A field that changes over some points, sd 8 uT, about 50 uT."""
    width = 8
    noise = rng.standard_normal((n + width, channels))
    total = np.cumsum(noise, axis=0)
    return np.asarray(50.0 + 8.0 * (total[width:] - total[:-width]) / np.sqrt(width))


def _windows(rng: np.random.Generator, channels: int) -> tuple[Float64Array, Float64Array]:
    """A query, and windows (count, n, channels) of which one is much like it."""
    profile = _profile(rng, 8 * _WINDOWS + _POINTS, channels)
    views = np.lib.stride_tricks.sliding_window_view(profile, _POINTS, axis=0)[::8][:_WINDOWS]
    windows = np.ascontiguousarray(views.transpose(0, 2, 1))
    return windows[_WINDOWS // 3] + rng.standard_normal((_POINTS, channels)), windows


def _over_windows(query: np.ndarray, windows: np.ndarray, band: Band) -> Call:
    """One query against all windows, stored for it."""
    count, n, channels = windows.shape
    stored = windows.reshape(count // LANES, LANES, n, channels).transpose(0, 2, 3, 1)
    x = np.ascontiguousarray(stored).reshape(-1, channels, LANES)
    kernel = classic_windows if band[1][0] == n - 1 else skipping_windows
    row, out = np.empty((n + 2, LANES), query.dtype), np.empty((count // LANES, LANES), query.dtype)

    def ours() -> object:
        kernel(query, x, n, n, *band, (0,) * channels, None, row, out)
        return out

    return ours


def _peer_windows(query: Float64Array, windows: Float64Array) -> Call | None:
    try:
        from dtaidistance import dtw
    except ImportError:
        return None
    series = [query[:, 0].copy(), *(np.ascontiguousarray(one[:, 0]) for one in windows)]
    block = ((0, 1), (1, len(series)))
    return lambda: dtw.distance_matrix_fast(series, block=block, compact=True, parallel=False)


def _peer_3d(query: Float64Array, windows: Float64Array) -> Call | None:
    try:
        from dtaidistance import dtw_ndim
    except ImportError:
        return None
    query = np.ascontiguousarray(query)
    return lambda: [dtw_ndim.distance_fast(query, window) for window in windows]


def _peer_subsequence(query: Float64Array, profile: Float64Array) -> Call | None:
    try:
        from dtaidistance.subsequence.dtw import subsequence_alignment
    except ImportError:
        return None
    return lambda: subsequence_alignment(query, profile, use_c=True).best_match().path
