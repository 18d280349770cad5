"""A third surveyed, the rest as sessions: shared out once, without waypoints, scored on walks no map holds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from app.engine.types import Prior
from app.evaluation import crowd
from app.evaluation.crowd import CrowdOptions, run_crowd, share_out
from app.evaluation.datasets.ilc20 import open_ilc20
from app.evaluation.errors import OptionsError

SAMPLES = Path("maps/samples")
OPTIONS = CrowdOptions(SAMPLES, ("site1-F2",), rounds=1, limit=2)


def test_walks_are_shared_out_once() -> None:
    level = open_ilc20(SAMPLES).level("site1-F2")
    parts = share_out(level, OPTIONS)
    third, sessions, scored = ({walk.walk_id for walk in part} for part in (parts.third, parts.sessions, parts.scored))
    assert len(third | sessions | scored) == len(third) + len(sessions) + len(scored)
    assert third | sessions == {walk.walk_id for walk in level.walks("train")}
    assert len(third) == len(level.walks("train")) // 3
    assert scored <= {walk.walk_id for walk in level.walks("test")}
    assert share_out(level, OPTIONS) == parts
    assert share_out(level, replace(OPTIONS, seed=1)) != parts


def test_left_out_walks_are_train_walks() -> None:
    level = open_ilc20(SAMPLES).level("site1-F2")
    parts = share_out(level, replace(OPTIONS, left_out=0.25, limit=None))
    assert {walk.split for walk in parts.scored} == {"train"}
    assert len(parts.scored) == round(0.25 * len(level.walks("train")))


def test_the_report_has_what_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a few walks of the sample floor, all the way through."""
    seen: list[Prior] = []
    located = crowd.smooth_in_engine

    def watched(tracker: object, trip: crowd.Trip, maps: object) -> object:
        seen.append(trip.prior)
        return located(tracker, trip, maps)  # type: ignore[arg-type]

    def few(level: object, options: CrowdOptions) -> crowd.Parts:
        parts = share_out(level, options)  # type: ignore[arg-type]
        return crowd.Parts(parts.third[:10], parts.sessions[:3], parts.scored)

    monkeypatch.setattr(crowd, "smooth_in_engine", watched)
    monkeypatch.setattr(crowd, "share_out", few)
    told: list[float] = []
    report = run_crowd(OPTIONS, lambda fraction, _what: told.append(fraction))
    assert len(seen) == 3
    assert {(prior.x is None, prior.radius_m, prior.heading) for prior in seen} == {(False, 3.0, None)}
    content = json.loads(report.to_json())
    assert content.keys() == {"site1-F2"}
    level = content["site1-F2"]
    for which in ("third", "crowd", "full"):
        assert level[which]["n_walks"] >= 1
        assert 0.0 < level[which]["p50"] <= level[which]["p90"]
    assert level["residual_variance"] > 0.0
    assert level["mapped_m2"]["third"] <= level["mapped_m2"]["crowd"]
    assert level["sessions"] == 3
    assert "crowd" in report.table()
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_options_are_checked() -> None:
    with pytest.raises(OptionsError, match="rounds"):
        CrowdOptions(SAMPLES, rounds=0)
    with pytest.raises(OptionsError, match="left_out"):
        CrowdOptions(SAMPLES, left_out=1.5)


def test_residuals_about_the_truth_are_as_claimed() -> None:
    """The figure itself: a map whose claim is doubled has a quarter of the variance."""
    level = open_ilc20(SAMPLES).level("site1-F2")
    walks = level.walks("train")[:4]
    grid = crowd.build_map("site1-F2", [walk.survey_walk() for walk in walks]).grid_map
    double = replace(grid, sd=2.0 * grid.sd, noise_sd=tuple(2.0 * v for v in grid.noise_sd))
    once, twice = crowd.residual_variance(grid, walks), crowd.residual_variance(double, walks)
    assert once is not None
    assert twice == pytest.approx(once / 4.0, rel=0.15)
    assert crowd.residual_variance(grid, ()) is None
