"""Values of 32 lanes do what numpy does to 32 numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config, njit

from app.engine.kernels import lanes

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="LLVM's vector types need the compiler")


def binary(operation):
    """An operation over arrays of any multiple of 32 elements."""

    @njit(cache=False, nogil=True, fastmath=True)
    def kernel(a, b, out):
        for k in range(0, a.shape[0], lanes.LANES):
            lanes.store(out, k, operation(lanes.load(a, k), lanes.load(b, k)))

    return kernel


@njit(cache=False, nogil=True, fastmath=True)
def add_costs(total, a, b, out):
    lanes.store(out, 0, lanes.add_cost(lanes.load(total, 0), lanes.load(a, 0), lanes.load(b, 0)))


@njit(cache=False, nogil=True, fastmath=True)
def constants(out, number):
    lanes.store(out, 0, lanes.splat(out, number))
    lanes.store(out, lanes.LANES, lanes.unreachable(out))


def wide(values):
    """Numbers in a type in which nothing overflows."""
    return values.astype(np.float64 if values.dtype == np.float32 else np.int64)


SLOW = {
    "minimum": lambda a, b: np.minimum(a, b),
    "add": lambda a, b: np.minimum(a + b, 65535) if a.dtype == np.int64 else a + b,
    "subtract": lambda a, b: np.maximum(a - b, 0) if a.dtype == np.int64 else a - b,
    "distance": lambda a, b: np.abs(a - b),
}


def numbers(dtype, rng):
    """Two sequences of 96 with the extremes among them."""
    a, b = rng.integers(0, 65536, (2, 96)).astype(dtype)
    a[:4], b[:4] = [0, 0, 65535, 65535], [0, 65535, 0, 65535]
    return a, b


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
@pytest.mark.parametrize("name", SLOW)
def test_operations_are_numpy_s(name, dtype) -> None:
    a, b = numbers(dtype, np.random.default_rng(1))
    out = np.empty_like(a)
    binary(getattr(lanes, name))(a, b, out)
    np.testing.assert_allclose(out, SLOW[name](wide(a), wide(b)), rtol=1e-6)


def test_costs_are_squares_of_floats_and_distances_of_words() -> None:
    rng = np.random.default_rng(2)
    total, a, b = rng.standard_normal((3, 32)).astype(np.float32)
    out = np.empty_like(a)
    add_costs(total, a, b, out)
    np.testing.assert_allclose(out, total + (a - b) ** 2, rtol=1e-5, atol=1e-6)
    (a, b), total = numbers(np.uint16, rng), np.full(32, 30000, dtype=np.uint16)
    words = np.empty(32, dtype=np.uint16)
    add_costs(total, a[:32], b[:32], words)
    np.testing.assert_array_equal(words, np.minimum(30000 + np.abs(wide(a[:32]) - wide(b[:32])), 65535))


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_a_number_is_in_all_lanes(dtype) -> None:
    out = np.empty(64, dtype=dtype)
    constants(out, dtype(7))
    np.testing.assert_array_equal(out[:32], 7)
    np.testing.assert_array_equal(out[32:], lanes.FAR[np.dtype(dtype).name])
