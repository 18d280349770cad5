"""Plots are drawn, with all parts and without any."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.engine.types import Prior, Status
from app.evaluation.distributions import plot_errors
from app.evaluation.drivers import FieldRaster
from app.evaluation.metrics import score_steps
from app.evaluation.plots import Backdrop, ellipse95, plot_report, plot_walk
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.report import Report
from app.evaluation.results import ScoredTrack, WalkResult
from app.evaluation.truth import WalkTruth
from tests.evaluation.fakes import fix, flat_map, straight_walk

PLAN = Path(__file__).parents[2] / "maps" / "samples" / "ilc20" / "site1-F2" / "floor_image.png"


def result(walk_id: str = "a/b", **changes) -> WalkResult:
    t = np.arange(20.0)
    truth = WalkTruth(t, t * 1.3, np.full(20, 2.0))
    prior = Prior("site-F1", 1.0, 3.0)
    statuses = [Status.INSUFFICIENT if i < 3 else Status.OK for i in range(20)]
    fixes = tuple(fix(i, 1.3 * i + 0.5, 2.5, status=statuses[i]) for i in range(20))

    def track(own):
        return ScoredTrack(own, score_steps(truth, own, start_t=0.0, level_id="site-F1", prior=prior))

    values = {
        "walk_id": walk_id, "level": "site-F1", "level_id": "site-F1", "covered_share": 0.9, "length_m": 26.0,
        "start_t": 0.0, "end_t": 20.0, "prior": prior, "waypoints": straight_walk().waypoints, "truth": truth,
        "causal": track(fixes), "baseline": track(fixes[::2]), "smoothed": track(fixes[::3]), "n_segments": 1,
        "segment_s": (0.01,),
    }  # fmt: skip
    return WalkResult(**(values | changes))


def report(*walks: WalkResult) -> Report:
    return Report("ilc20", Scenario.TRACKING, Aids(), Through.ENGINE, "particle", ("site-F1",), walks)


def colours(path: Path) -> int:
    with Image.open(path) as image:
        found = image.convert("RGB").getcolors(1 << 24)
    return len(found or ())


def test_a_walk_with_everything(tmp_path: Path) -> None:
    backdrop = Backdrop((0.0, 0.0, 60.0, 40.0), PLAN, FieldRaster.of(flat_map("site-F1")))
    full = plot_walk(result(), backdrop, tmp_path / "deep" / "full.png", method="particle")
    bare = plot_walk(
        result(baseline=None, smoothed=None, prior=Prior("site-F1")), Backdrop((0, 0, 60, 40)), tmp_path / "bare.png"
    )
    assert colours(full) > colours(bare) > 50


def test_a_walk_without_any_fix_is_drawn(tmp_path: Path) -> None:
    truth = result().truth
    nothing = ScoredTrack((), score_steps(truth, (), start_t=0.0, level_id="site-F1"))
    plot_walk(result(causal=nothing), Backdrop((0, 0, 60, 40)), tmp_path / "none.png")
    plot_errors(report(result(causal=nothing, baseline=None, smoothed=None)), tmp_path / "errors.png")


def test_fixes_on_another_level_are_not_drawn_on_this_plan(tmp_path: Path) -> None:
    whole = result()
    elsewhere = tuple(replace(one, level_id="site-F2", x=400.0) for one in whole.causal.fixes[10:])
    mixed = replace(whole.causal, fixes=(*whole.causal.fixes[:10], *elsewhere))
    half = replace(whole.causal, fixes=whole.causal.fixes[:10])
    drawn = [
        plot_walk(replace(whole, causal=track), Backdrop((0, 0, 60, 40)), tmp_path / f"{name}.png").read_bytes()
        for name, track in (("mixed", mixed), ("half", half))
    ]
    assert drawn[0] == drawn[1]


def test_one_file_a_walk_and_one_of_errors(tmp_path: Path) -> None:
    seen: list[float] = []
    walks = (result(), result("c"))
    paths = plot_report(report(*walks), {"site-F1": Backdrop((0, 0, 60, 40))}, tmp_path, lambda f, _: seen.append(f))
    assert [p.relative_to(tmp_path).as_posix() for p in paths] == ["site-F1/a_b.png", "site-F1/c.png", "errors.png"]
    assert all(p.is_file() for p in paths)
    assert seen == sorted(seen)
    assert plot_report(report(), {}, tmp_path / "empty", lambda f, _: None) == []


def test_the_drawn_ellipse_is_the_95_percent_one() -> None:
    """Variances 9 along +30 degrees and 1 across."""
    angle = math.radians(30)
    c, s = math.cos(angle), math.sin(angle)
    tilted = replace(fix(0.0, 3.0, 4.0), cov_xx=9 * c * c + s * s, cov_xy=8 * c * s, cov_yy=9 * s * s + c * c)
    patch = ellipse95(tilted)
    assert patch.get_center() == (3.0, 4.0)
    assert (patch.width, patch.height) == (pytest.approx(6 * math.sqrt(5.991)), pytest.approx(2 * math.sqrt(5.991)))
    assert patch.angle % 180 == pytest.approx(30)


@pytest.mark.parametrize("xx", [0.0, -1.0, math.nan, math.inf])
def test_no_ellipse_without_a_covariance(xx: float) -> None:
    assert ellipse95(replace(fix(0.0), cov_xx=xx)) is None
