"""Warping kernels against their slow twins, and the laws of what they compute."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from app.engine.kernels import dtw, lanes
from app.engine.kernels.warping import FAR, warping_path
from app.engine.matching.dtw import bands, signals
from app.engine.matching.dtw.library import into_lanes, out_of_lanes
from app.engine.matching.dtw.quantize import quantize
from app.evaluation.datasets.ilc20 import open_ilc20
from tests.reference import dtw as naive

compiled = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="LLVM's vector types need the compiler")
BANDS = {
    "full": bands.full_band,
    "sakoe_chiba": lambda n, m: bands.sakoe_chiba_band(n, m, max(n, m) // 5),
    "itakura": bands.itakura_band,
}


def windows(q, x, band, *, skipping=False, shift=None):
    """Costs of windows (count, m, channels) in the type of ``q``."""
    count, m, channels = x.shape
    groups = -(-count // lanes.LANES)
    padded = np.concatenate([x, np.repeat(x[-1:], groups * lanes.LANES - count, axis=0)])
    stored = padded.reshape(groups, lanes.LANES, m, channels).transpose(0, 2, 3, 1).astype(q.dtype)
    stored = np.ascontiguousarray(stored).reshape(groups * m, channels, lanes.LANES)
    row = np.empty((m + 2, lanes.LANES), dtype=q.dtype)
    out = np.empty((groups, lanes.LANES), dtype=q.dtype)
    kernel = dtw.skipping_windows if skipping else dtw.classic_windows
    kernel(q, stored, m, m, *band, (0,) * channels, shift, row, out)
    return out.ravel()[:count]


def subsequence(q, x, *, skipping=False, uneven=0, block=10**9):
    """Cost of the best stretch that ends at each point of x (m, channels), by way of chunks."""
    n, channels = q.shape
    top = 65535 if q.dtype == np.uint16 else 1e5
    stored, _ = into_lanes(x, 2 * n, 0, fill=top)
    stored = stored.astype(q.dtype)
    state = np.full((n, 2, lanes.LANES) if skipping else (n, lanes.LANES), lanes.FAR[q.dtype.name], dtype=q.dtype)
    out = np.empty((len(stored), lanes.LANES), dtype=q.dtype)
    for j in range(0, len(stored), block):
        part, costs = stored[j : j + block], out[j : j + block]
        if skipping:
            dtw.skipping_subsequence(q, part, (0,) * channels, q.dtype.type(uneven), state, costs)
        else:
            dtw.classic_subsequence(q, part, (0,) * channels, state, costs)
    return out_of_lanes(out[2 * n :], len(x))


def path_of(q, x, band=None, *, skipping=False, uneven=0.0, open_ends=(False, False)):
    """Cost, and pairs from first to last."""
    n, m = len(q), len(x)
    path = np.empty((n + m, 2), dtype=np.int64)
    moves = np.empty((n, m), dtype=np.int8)
    lo, hi = bands.full_band(n, m) if band is None else band
    cost, first = warping_path(q, x, lo, hi, skipping, uneven, open_ends, np.empty((2, m)), moves, path)
    return cost, path[first:]


def smooth(rng, n, channels):
    """A sequence that changes over some points, about 50 uT."""
    noise = rng.standard_normal((n + 8, channels))
    return 50.0 + 2.0 * sum(noise[k : k + n] for k in range(8))


def adversarial(n, channels):
    """Sequences on which shortcuts of the recursion show: constant, a step at an end, spikes, alternation."""
    flat = np.full((n, channels), 40.0)
    early, late, spikes = flat.copy(), flat.copy(), flat.copy()
    early[0], late[-1], spikes[::7] = 90.0, 90.0, 3.0
    saw = flat + 10.0 * (np.arange(n) % 2)[:, None]
    return np.stack([flat, early, late, spikes, saw])


@compiled
@pytest.mark.parametrize("skipping", [False, True])
@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("kind", BANDS)
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 2), (17, 17), (12, 20), (20, 12)])
def test_windows_cost_what_the_recursion_says(kind, channels, n, m, skipping) -> None:
    rng = np.random.default_rng(n * m)
    band = BANDS[kind](n, m)
    assert band is not None
    x = np.concatenate([np.stack([smooth(rng, m, channels) for _ in range(35)]), adversarial(m, channels)])
    for q in (smooth(rng, n, channels), adversarial(n, channels)[3]):
        lo, hi = band
        expected = [naive.window_cost(q, one, skipping=skipping, lo=lo, hi=hi) for one in x]
        found = windows(q.astype(np.float32), x, band, skipping=skipping)
        reached = np.isfinite(expected)
        np.testing.assert_allclose(found[reached], np.array(expected)[reached], rtol=1e-4, atol=1e-3)
        assert np.all(found[~reached] >= 0.5 * lanes.FAR["float32"])
        words = np.rint(q).astype(np.uint16), np.rint(x)
        exact = [naive.window_cost(words[0], one, squared=False, skipping=skipping, lo=lo, hi=hi) for one in words[1]]
        found = windows(words[0], words[1], band, skipping=skipping)
        np.testing.assert_array_equal(found, np.minimum(exact, 65535))


@compiled
def test_what_is_added_to_the_query_is_each_window_s_own() -> None:
    rng = np.random.default_rng(2)
    q, x = smooth(rng, 20, 2), np.stack([smooth(rng, 20, 2) for _ in range(32)])
    shift = rng.standard_normal((1, 2, 32)).astype(np.float32)
    for kind in BANDS.values():
        band = kind(20, 20)
        expected = [naive.window_cost(q + shift[0, :, k], x[k], lo=band[0], hi=band[1]) for k in range(32)]
        np.testing.assert_allclose(windows(q.astype(np.float32), x, band, shift=shift), expected, rtol=1e-4)


@compiled
def test_words_saturate() -> None:
    q, x = np.zeros((4, 1), dtype=np.uint16), np.full((1, 4, 1), 60000.0)
    assert windows(q, x, bands.full_band(4, 4))[0] == 65535


@compiled
@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize(("n", "m"), [(1, 5), (9, 300), (30, 40), (12, 1001)])
def test_subsequences_in_chunks_cost_what_they_do_in_one_piece(n, m, channels) -> None:
    rng = np.random.default_rng(m)
    for x in (smooth(rng, m, channels), *adversarial(m, channels)):
        q = x[m // 2 :][:n] + rng.standard_normal((min(n, m - m // 2), channels))
        q32 = q.astype(np.float32)
        for uneven in (0.0, 7.0):
            expected = naive.subsequence_costs(q, x, skipping=True, uneven=uneven)
            found = subsequence(q32, x, skipping=True, uneven=uneven)
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=0.05)
        np.testing.assert_array_equal(subsequence(q32, x, skipping=True, block=6), subsequence(q32, x, skipping=True))
        classic = naive.subsequence_costs(q, x)
        found = subsequence(q32, x, block=4)
        assert np.all(found >= classic - 1e-3 * classic - 0.05)
        near = np.isclose(found, classic, rtol=1e-3, atol=0.05)
        for end in np.flatnonzero(~near):  # only stretches that are longer than a chunk's margin may be missed
            _, path = path_of(q, x[: end + 1], open_ends=(True, False))
            assert path[-1, 1] - path[0, 1] >= 2 * len(q)


@compiled
@pytest.mark.parametrize("skipping", [False, True])
def test_subsequences_of_words_are_exact(skipping: bool) -> None:
    rng = np.random.default_rng(3)
    x = np.rint(10.0 * smooth(rng, 500, 3))
    q = np.rint(x[200:230] + 5.0 * rng.standard_normal((30, 3))).astype(np.uint16)
    for uneven in (0, 40) if skipping else (0,):
        expected = naive.subsequence_costs(q, x, squared=False, skipping=skipping, uneven=uneven)
        found = subsequence(q, x, skipping=skipping, uneven=uneven)
        np.testing.assert_array_equal(found, np.minimum(expected, 65535))


@pytest.mark.parametrize("skipping", [False, True])
@pytest.mark.parametrize("uneven", [0.0, 20.0])
@pytest.mark.parametrize("open_ends", [(False, False), (True, False), (True, True)])
def test_the_path_costs_what_it_is_said_to(skipping, open_ends, uneven) -> None:
    rng = np.random.default_rng(4)
    for kind in BANDS.values() if not any(open_ends) else [bands.full_band]:
        q, x = smooth(rng, 14, 2), smooth(rng, 18, 2)
        lo, hi = kind(14, 18)
        local = naive.local_costs(q, x)
        d = naive.matrix(local, skipping=skipping, uneven=uneven, open_begin=open_ends[0], lo=lo, hi=hi)
        cost, path = path_of(q, x, (lo, hi), skipping=skipping, uneven=uneven, open_ends=open_ends)
        assert cost == pytest.approx(d[-1].min() if open_ends[1] else d[-1, -1])
        steps = np.diff(path, axis=0)
        crooked = int((steps != 1).any(axis=1).sum())
        assert naive.path_cost(q, x, path) + uneven * crooked == pytest.approx(cost)
        allowed = {(1, 0), (1, 1), (1, 2)} if skipping else {(1, 0), (1, 1), (0, 1)}
        assert {tuple(step) for step in steps.tolist()} <= allowed
        assert path[0, 0] == 0
        assert path[-1, 0] == 13


def test_no_path_is_said() -> None:
    q, x = np.zeros((3, 1)), np.zeros((9, 1))
    cost, path = path_of(q, x, skipping=True)  # two steps cannot reach the ninth point
    assert cost >= FAR
    assert len(path) == 0


lengths = st.integers(2, 12)
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=30, deadline=None)
@given(n=lengths, m=lengths, seed=seeds)
def test_classic_warping_is_symmetric_and_free_onto_itself(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, x = smooth(rng, n, 2), smooth(rng, m, 2)
    assert path_of(q, x)[0] == pytest.approx(path_of(x, q)[0])
    assert path_of(q[::-1].copy(), x[::-1].copy())[0] == pytest.approx(path_of(q, x)[0])
    for skipping in (False, True):
        cost, path = path_of(q, q, skipping=skipping)
        assert cost == 0.0
        np.testing.assert_array_equal(path[:, 0], path[:, 1])


@settings(max_examples=30, deadline=None)
@given(n=lengths, m=lengths, seed=seeds)
def test_no_band_finds_a_cheaper_path(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, x = smooth(rng, n, 1), smooth(rng, m, 1)
    full = path_of(q, x)[0]
    for kind in BANDS.values():
        band = kind(n, m)
        if band is not None:
            assert path_of(q, x, band)[0] >= full - 1e-9


@pytest.mark.parametrize("n", range(1, 25))
def test_bands_hold_paths(n: int) -> None:
    for m in range(1, 30):
        expected = naive.itakura(n, m)
        found = bands.itakura_band(n, m)
        assert (expected is None) == (found is None)
        if expected is not None:
            np.testing.assert_array_equal(found, expected)
        for band in (found, bands.full_band(n, m), bands.sakoe_chiba_band(n, m, 1)):
            if band is None:
                continue
            lo, hi = band
            assert lo[0] == 0
            assert hi[-1] == m - 1
            assert np.all(np.diff(lo) >= 0)
            assert np.all(np.diff(hi) >= 0)
            # slope 2 needs steps of two; a band wider than those is the classic steps' own
            assert path_of(np.zeros((n, 1)), np.zeros((m, 1)), band, skipping=band is found)[0] == 0.0


def test_derivatives_are_those_of_the_definition() -> None:
    values = smooth(np.random.default_rng(5), 30, 2)
    found, cut = signals.derivative(values)
    assert cut == 1
    np.testing.assert_allclose(found, naive.derivative(values)[1:-1])
    np.testing.assert_allclose(signals.derivative(3.0 * np.arange(9.0)[:, None])[0], 3.0)


def test_chunks_hold_the_sequence_and_its_neighbours() -> None:
    values = np.arange(100.0)[:, None]
    stored, step = into_lanes(values, 5, 3, fill=-1.0)
    assert stored.shape[0] % 2 == 0
    np.testing.assert_array_equal(out_of_lanes(stored[5 : 5 + step, 0], 100), values[:, 0])
    np.testing.assert_array_equal(stored[:5, 0, 1], values[step - 5 : step, 0] if step >= 5 else stored[:5, 0, 1])
    assert stored[4, 0, 0] == -1.0


def test_quantizing_keeps_differences() -> None:
    values = smooth(np.random.default_rng(6), 50, 3)
    words = quantize(values, values.min(axis=0) - 1.0).astype(float)
    np.testing.assert_allclose(np.diff(words, axis=0) / 10.0, np.diff(values, axis=0), atol=0.1 + 1e-9)
    assert words.min() == 10.0


def recorded_windows(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Field magnitude of a recorded walk against those of all others, windows of ``n`` samples."""
    walks = open_ilc20(Path("maps/samples")).level("site1-F2").walks("train")
    total = [np.linalg.norm(walk.samples.mag[::5], axis=1)[:, None] for walk in walks]
    query = total[0][len(total[0]) // 3 :][:n]
    views = [np.lib.stride_tricks.sliding_window_view(one, n, axis=0)[::9] for one in total[1:] if len(one) >= n]
    return query, np.concatenate(views).transpose(0, 2, 1)


def random_windows(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Windows of a random field of three channels and a disturbed copy of one of them."""
    profile = smooth(rng, 12000 + n, 3)
    x = np.lib.stride_tricks.sliding_window_view(profile, n, axis=0)[::8].transpose(0, 2, 1)
    return x[len(x) // 3] + rng.standard_normal((n, 3)), x


@compiled
@pytest.mark.parametrize("source", [recorded_windows, random_windows])
def test_words_keep_the_best_fifty(source) -> None:
    query, x = source(np.random.default_rng(7), 60)
    low = np.minimum(query.min(axis=0), x.min(axis=(0, 1))) - 1.0
    band = bands.full_band(60, 60)
    words = windows(quantize(query, low), quantize(x, low), band).astype(np.float64)
    exact = absolute_costs(query, x)
    kept = set(np.argsort(words, kind="stable")[:50]) & set(np.argsort(exact, kind="stable")[:50])
    assert len(x) > 500
    assert len(kept) / 50 >= 0.98


def absolute_costs(query: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Float64 costs of absolute differences, all windows together."""
    before = np.full((x.shape[1] + 1, len(x)), np.inf)
    before[0] = 0.0
    for point in query:
        now = np.full_like(before, np.inf)
        for j in range(x.shape[1]):
            now[j + 1] = np.abs(x[:, j] - point).sum(axis=1) + np.minimum(np.minimum(before[j], before[j + 1]), now[j])
        before = now
    return before[-1]
