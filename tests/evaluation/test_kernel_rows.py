"""Timing beside peers: both do the same work, and what is told is what was timed."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np
import pytest

from app.engine.types import Status
from app.evaluation.errors import OptionsError
from app.evaluation.kernels import TASKS, Comparison, Units, compare, run_kernels, runner
from app.evaluation.kernels.contour import SHIFTS, magcom_mad, magcom_pose
from app.evaluation.kernels.filtering import particle_step
from app.evaluation.kernels.mapping import map_build


class Clock:
    """Processor time that passes only while somebody works."""

    def __init__(self) -> None:
        self.now = 0.0
        self.log: list[str] = []

    def worker(self, name: str, seconds: float) -> Any:
        def work() -> None:
            self.log.append(name)
            self.now += seconds

        return work


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(runner.time, "process_time", lambda: clock.now)
    return clock


def test_units_scale_and_turns_alternate(clock: Clock) -> None:
    units = Units("search", "slow one", ours=2.0, theirs=0.01)
    row = compare("a", Comparison(clock.worker("ours", 0.006), clock.worker("peer", 0.5), units), rounds=3, most_s=60.0)
    assert row.ours_us == pytest.approx(3_000.0)
    assert row.peer_us == pytest.approx(50e6)
    assert row.ratio == pytest.approx(50e6 / 3_000.0)
    assert clock.log[-6:] == ["ours", "peer"] * 3
    assert row.as_dict() == {
        "task": "a",
        "peer": "slow one",
        "ours_us": row.ours_us,
        "peer_us": row.peer_us,
        "ratio": row.ratio,
        "what": "search",
        "note": "",
    }


def test_short_work_is_timed_several_times_together(clock: Clock) -> None:
    row = compare("a", Comparison(clock.worker("ours", 1e-4), None, Units("step", note="none")), rounds=1, most_s=60.0)
    assert row.ours_us == pytest.approx(100.0)
    assert len(clock.log) >= 40
    assert (row.peer, row.peer_us, row.ratio, row.note) == (None, None, None, "none")


def test_time_is_up_after_three_rounds_at_the_earliest(clock: Clock) -> None:
    compare("a", Comparison(clock.worker("ours", 1.0), None, Units("step")), rounds=99, most_s=0.0)
    assert len(clock.log) == 2 + 3


def test_the_peer_computes_the_same_costs() -> None:
    comparison = magcom_mad(np.random.default_rng(1))
    assert comparison.peer is not None
    np.testing.assert_allclose(np.asarray(comparison.ours())[SHIFTS // 2], comparison.peer(), rtol=1e-4)  # type: ignore[call-overload]


def test_the_pose_is_found() -> None:
    result = magcom_pose(np.random.default_rng(2)).ours()
    assert result.status is Status.OK  # type: ignore[attr-defined]
    assert result.matches[0].rotation == pytest.approx(-0.05, abs=0.005)  # type: ignore[attr-defined]
    assert result.matches[0].scale == pytest.approx(1.02, abs=0.005)  # type: ignore[attr-defined]


@pytest.mark.parametrize(("task", "package"), [(particle_step, "filterpy"), (map_build, "pykrige")])
def test_a_peer_that_is_not_installed_is_left_out(monkeypatch: pytest.MonkeyPatch, task: Any, package: str) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith(package):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    _, peer, units = task(np.random.default_rng(3))
    assert peer is None
    assert units.note == f"{package} is not installed"


def test_tasks_are_told_apart() -> None:
    assert len(dict(TASKS)) == len(TASKS)
    seen: list[str] = []
    rows = run_kernels(["particle_step"], rounds=1, progress=lambda share, name: seen.append(name))
    assert [row.task for row in rows] == seen == ["particle_step"]
    assert rows[0].ratio is not None
    with pytest.raises(OptionsError, match="no task nothing; there are"):
        run_kernels(["nothing"])
