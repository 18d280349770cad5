"""What all tests share: one cache of compiled kernels, filled by one process at a time."""

from __future__ import annotations

import os
from pathlib import Path

KERNEL_CACHE = Path(__file__).resolve().parents[1] / ".pytest_cache" / "kernels"
"""Services that tests start inherit it: they would each compile for half a minute into a data folder of their own."""

# numba reads the variable when it is first imported, so it is set before any test module is.
KERNEL_CACHE.mkdir(parents=True, exist_ok=True)
os.environ.setdefault("NUMBA_CACHE_DIR", str(KERNEL_CACHE))

from tests.support.kernels import compile_one_at_a_time  # noqa: E402

compile_one_at_a_time(Path(os.environ["NUMBA_CACHE_DIR"]) / "locks")
