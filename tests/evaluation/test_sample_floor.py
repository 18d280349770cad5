"""The real engine on the committed sample: a whole run, as `isodyn evaluate ilc20 --data maps/samples` makes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.evaluation.protocol import EvaluationOptions
from app.evaluation.report import Report, RunStatus
from app.evaluation.run import run_ilc20

SAMPLES = Path(__file__).parents[2] / "maps" / "samples"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report() -> Report:
    return run_ilc20(EvaluationOptions(SAMPLES, limit=8))


def test_the_method_works_and_beats_dead_reckoning(report: Report) -> None:
    assert report.status is RunStatus.OK
    assert (report.method, report.levels, len(report.walks)) == ("particle", ("site1-F2",), 6)
    for covered in (False, True):
        own, base = report.summary(covered=covered), report.baseline_summary(covered=covered)
        assert own.p50 is not None
        assert base.p50 is not None
        assert own.p50 < 0.8 * base.p50
        assert own.p50 < 3.3
    assert not [walk.failures for walk in report.walks if walk.failures]


def test_fixes_are_causal_in_number_and_order(report: Report) -> None:
    for walk in report.walks:
        t = np.array([fix.t for fix in walk.causal.fixes])
        assert len(t) >= len(walk.truth)  # one per step, and one at the end of each segment
        assert walk.causal.scores.answered.all()
        assert {fix.level_id for fix in walk.causal.fixes} == {"site1-F2"}


def test_smoothed_tracks_move_at_every_step(report: Report) -> None:
    """A smoother that read particles after they were overwritten gave the same place for all steps of a segment."""
    for walk in report.walks:
        assert walk.smoothed is not None
        places = {(fix.x, fix.y) for fix in walk.smoothed.fixes}
        assert len(places) > 0.9 * len(walk.smoothed.fixes)
        assert abs(len(walk.smoothed.fixes) - len(walk.truth)) <= 0.1 * len(walk.truth) + 2
    smoothed, causal = report.smoothed_summary().mean, report.summary().mean
    assert smoothed is not None
    assert causal is not None
    assert smoothed < 1.15 * causal
