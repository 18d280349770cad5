"""From answers to the figures that the papers print; lengths in metres, None where there is nothing to average."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from app.engine.types import Float64Array, Status
from app.evaluation.papers.matching import Outcome, Trial
from app.evaluation.papers.s1 import WindowResult, end_errors
from app.evaluation.papers.s3 import BOUND, NEAR_M, DeclinationResult, VotingResult, heading_errors, indicated_errors
from app.evaluation.papers.s4 import FAILED_M, RegionResult

Figures = dict[str, Any]


def region_figures(outcomes: Sequence[Outcome]) -> Figures:
    """Of one method over the tracks of a region."""
    placed = [outcome for outcome in outcomes if outcome.located]
    errors = np.array([outcome.error for outcome in outcomes])
    held = errors <= FAILED_M
    sure = np.array([outcome.status is Status.OK for outcome in outcomes], dtype=bool)
    return {
        "north": mean([abs(outcome.dy) for outcome in placed]),
        "east": mean([abs(outcome.dx) for outcome in placed]),
        "failure_rate": mean(~held),
        "ms": median([1000.0 * outcome.cpu_s for outcome in outcomes]),
        "tracks": len(outcomes),
        "north_held": mean([abs(o.dy) for o in placed if o.error <= FAILED_M]),
        "east_held": mean([abs(o.dx) for o in placed if o.error <= FAILED_M]),
        "p50": median(errors),
        "not_ok_rate": mean(~sure),
        "ok_failure_rate": mean(~held[sure]),
        "ellipse95": mean([outcome.inside for outcome in placed if outcome.status is Status.OK]),
        "track_mean": mean([float(outcome.track_error.mean()) for outcome in placed]),
        "refused": sorted({outcome.note for outcome in outcomes if outcome.status is None}),
        "errors_m": [finite(error) for error in errors],
    }


def indicated_figures(trials: Sequence[Trial]) -> Figures:
    """Of the inertial navigation system alone, started where it thinks to be."""
    ends = np.array([[t.problem.track.x[-1] - t.x[-1], t.problem.track.y[-1] - t.y[-1]] for t in trials])
    starts = np.array([[t.problem.track.x[0] - t.x[0], t.problem.track.y[0] - t.y[0]] for t in trials])
    drift = ends - starts
    return {
        "north": mean(np.abs(ends[:, 1])),
        "east": mean(np.abs(ends[:, 0])),
        "drift_mean": mean(np.hypot(*drift.T)),
        "tracks": len(trials),
    }


def about_region(result: RegionResult) -> Figures:
    """What a region is."""
    window, grid_map = result.ground.window, result.ground.grid_map
    return {
        "survey": window.survey.name,
        "extent_m": [round(value) for value in window.extent],
        "gradient_nt_km": round(window.gradient_nt_km, 1),
        "map_sd_nt": round(1000.0 * float(np.median(grid_map.sd)), 1),
        "map_noise_nt": round(1000.0 * grid_map.noise_sd[0], 1),
        "left_out_lines": result.n_lines,
        "failed_m": FAILED_M,
        "indicated": indicated_figures(result.trials),
    }


def window_figures(result: WindowResult) -> Figures:
    """Of each method with windows of one length."""
    return {method: _sequence_figures(outcomes) for method, outcomes in result.outcomes.items()} | {
        "window_m": round(result.length_m, 2),
        "route_m": round(result.route_m, 1),
    }


def _sequence_figures(outcomes: tuple[Outcome, ...]) -> Figures:
    errors = end_errors(outcomes)
    sure = np.array([outcome.status is Status.OK for outcome in outcomes], dtype=bool)
    return {
        "mean": mean(errors[np.isfinite(errors)]),
        "p50": median(errors),
        **{f"within_{limit}m": mean(errors <= limit) for limit in (1, 2, 3, 4)},
        "ms": median([1000.0 * outcome.cpu_s for outcome in outcomes]),
        "ok_rate": mean(sure),
        "ok_mean": mean(errors[sure & np.isfinite(errors)]),
        "located": mean(np.isfinite(errors)),
        "fixes": len(outcomes),
        "refused": sorted({outcome.note for outcome in outcomes if outcome.status is None}),
        "errors_m": [finite(error) for error in errors],
    }


def voting_figures(result: VotingResult) -> Figures:
    """Part 1 of S3: of what two components agreed on, and of what is claimed to be the place."""
    voted = np.array([outcome.error for outcome in result.outcomes if outcome.located])
    claimed = np.array([outcome.error for outcome in result.outcomes if outcome.status is Status.OK])
    return {
        "accepted": mean([outcome.located for outcome in result.outcomes]),
        "mean_m": mean(voted),
        "bound_m": quantile(voted, BOUND),
        "max_m": largest(voted),
        "ok_rate": mean([outcome.status is Status.OK for outcome in result.outcomes]),
        "ok_bound_m": quantile(claimed, BOUND),
        "ok_max_m": largest(claimed),
        "ms": median([1000.0 * outcome.cpu_s for outcome in result.outcomes]),
        "windows": len(result.outcomes),
        "routes_m": round(result.routes_m, 1),
        "refused": sorted({outcome.note for outcome in result.outcomes if outcome.status is None}),
        "errors_m": [finite(outcome.error) for outcome in result.outcomes],
    }


def declination_figures(result: DeclinationResult) -> Figures:
    """Part 2 of S3: along whole tracks, without and with the map."""
    pairs = [(t, o) for t, o in zip(result.trials, result.outcomes, strict=True) if o.x is not None and o.y is not None]
    before = _pooled(heading_errors(t, t.problem.track.x, t.problem.track.y) for t in result.trials)
    after = _pooled(heading_errors(t, o.x, o.y) for t, o in pairs if o.x is not None and o.y is not None)
    without = _pooled(indicated_errors(trial) for trial in result.trials)
    errors = _pooled(outcome.track_error for _, outcome in pairs)
    return {
        "heading_before_deg": mean(np.degrees(before)),
        "heading_after_deg": mean(np.degrees(after)),
        "heading_max_before_deg": largest(np.degrees(before)),
        "heading_max_after_deg": largest(np.degrees(after)),
        "mean_without_m": mean(without),
        "mean_m": mean(errors),
        "within_1m_without": mean(without <= NEAR_M),
        "within_2m_without": mean(without <= 2.0 * NEAR_M),
        "within_1m": mean(errors <= NEAR_M),
        "max_without_m": largest(without),
        "max_m": largest(errors),
        "ok_rate": mean([outcome.status is Status.OK for outcome in result.outcomes]),
        "located": mean([outcome.located for outcome in result.outcomes]),
        "ms": median([1000.0 * outcome.cpu_s for outcome in result.outcomes]),
        "walks": len(result.outcomes),
        "refused": sorted({outcome.note for outcome in result.outcomes if outcome.status is None}),
        "end_errors_m": [finite(outcome.error) for outcome in result.outcomes],
    }


def _pooled(parts: Any) -> Float64Array:
    return np.concatenate([np.empty(0), *parts])


def mean(values: ArrayLike) -> float | None:
    """Mean, rounded; None of nothing."""
    known = np.asarray(values, dtype=np.float64)
    return None if not known.size else finite(float(known.mean()))


def median(values: ArrayLike) -> float | None:
    """Median; None of nothing, and where it is infinite."""
    return quantile(values, 0.5)


def quantile(values: ArrayLike, share: float) -> float | None:
    """The value that this share does not exceed; None of nothing, and where it is infinite."""
    known = np.sort(np.asarray(values, dtype=np.float64))
    return None if not known.size else finite(float(known[min(int(np.ceil(share * known.size)), known.size) - 1]))


def largest(values: ArrayLike) -> float | None:
    """The largest value; None of nothing."""
    return quantile(values, 1.0)


def finite(value: float) -> float | None:
    """A number as JSON can hold it."""
    return round(float(value), 4) if np.isfinite(value) else None
