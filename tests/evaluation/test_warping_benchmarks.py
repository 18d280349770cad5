"""What the warping benchmarks time is the same work on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.matching.dtw.placing import Warping
from app.evaluation.kernels import dtw

TASKS = (dtw.dtw_f32, dtw.dtw_u16, dtw.dtw_itakura_3d, dtw.subsequence_dtw)


@pytest.mark.parametrize("task", TASKS)
def test_ours_is_found_without_the_peer(task, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("dtaidistance", "dtaidistance.subsequence", "dtaidistance.subsequence.dtw"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    ours, peer, units = task(np.random.default_rng(1))
    assert ours() is not None
    assert peer is None
    assert units >= 1


def test_both_sides_find_the_same() -> None:
    pytest.importorskip("dtaidistance")
    ours, peer, units = dtw.dtw_f32(np.random.default_rng(2))
    assert peer is not None
    found, expected = np.asarray(ours()).ravel(), np.asarray(peer())
    assert found.shape == expected.shape == (units,)
    np.testing.assert_allclose(np.sqrt(found), expected, rtol=1e-4)


def test_both_sides_find_the_same_path() -> None:
    pytest.importorskip("dtaidistance")
    ours, peer, _ = dtw.subsequence_dtw(np.random.default_rng(3))
    assert peer is not None
    warping, path = ours(), peer()
    assert isinstance(warping, Warping)
    assert isinstance(path, list)
    assert warping.pairs[-1].tolist() == [int(k) for k in path[-1]]
    assert warping.pairs[0].tolist() == [int(k) for k in path[0]]
