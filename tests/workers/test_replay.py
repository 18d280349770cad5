"""A segment that is done again gives the same fixes, to the last bit, in whatever process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_kernels_from_the_cache_compute_what_fresh_ones_did(tmp_path: Path) -> None:
    """The first start of a service compiles its kernels, later ones load them.

    numba may link a kernel's callees differently in the two cases; with fast math that shows in the last digits, and
    a particle filter carries such a difference on to the centimetres.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "tests.workers.fingerprint"]
    fresh, cached, again = (
        subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, check=True).stdout for _ in range(3)
    )
    assert list(tmp_path.rglob("*.nbi")), "nothing was cached"
    assert fresh == cached == again
