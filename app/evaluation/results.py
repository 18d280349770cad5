"""What comes of replaying one walk."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.types import Fix, Float64Array, Prior, Waypoints
from app.evaluation.metrics import StepScores, confidence, summarize
from app.evaluation.truth import COVERED_SHARE, WalkTruth

BASELINE = "dead_reckoning"


@dataclass(frozen=True, slots=True)
class ScoredTrack:
    """Fixes of one method on one walk, and their scores."""

    fixes: tuple[Fix, ...]
    scores: StepScores


@dataclass(frozen=True, slots=True)
class WalkResult:
    """One replayed walk."""

    walk_id: str
    level: str
    level_id: str
    """What the fixes call the level."""
    covered_share: float
    length_m: float
    start_t: float
    end_t: float
    prior: Prior
    waypoints: Waypoints
    truth: WalkTruth
    causal: ScoredTrack
    n_segments: int
    segment_s: tuple[float, ...]
    failures: tuple[str, ...] = ()
    baseline: ScoredTrack | None = None
    smoothed: ScoredTrack | None = None

    @property
    def covered(self) -> bool:
        """Whether the walk runs where the survey went."""
        return self.covered_share >= COVERED_SHARE

    @property
    def duration_s(self) -> float:
        """From the first to the last sample sent."""
        return self.end_t - self.start_t

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        summary = summarize([self.causal.scores], self.segment_s).as_dict()
        own = {name: summary[name] for name in ("mean", "p50", "p75", "p90", "p95", "ellipse95", "sure_share")}
        scores = self.causal.scores
        return {
            "walk_id": self.walk_id,
            "level": self.level,
            "covered": self.covered,
            "covered_share": round(self.covered_share, 4),
            "length_m": round(self.length_m, 2),
            "duration_s": round(self.duration_s, 2),
            "n_steps": len(self.truth),
            "n_scored": len(scores),
            "n_fixes": len(self.causal.fixes),
            "n_segments": self.n_segments,
            **own,
            "end": summary["end_p50"],
            "end_level_right": bool(scores.level_right[-1]),
            "sure_within_5m": summary["sure_within_5m"],
            "ms_per_segment": summary["ms_per_segment"],
            "ms_of_segments": [round(s * 1000.0, 3) for s in self.segment_s],
            "unanswered_share": round(float(np.mean(~scores.answered)), 4),
            "level_hit_rate": confidence([scores], [self.start_t]).as_dict()["level_hit_rate"],
            "statuses": dict(sorted(Counter(fix.status.value for fix in self.causal.fixes).items())),
            "failures": list(self.failures),
            "dead_reckoning": _track_errors(self.baseline),
            "smoothed": _track_errors(self.smoothed),
            "t_s": _rounded(scores.t - self.start_t),
            "errors_m": _rounded(scores.error),
        }


@dataclass(frozen=True, slots=True)
class Dropped:
    """A walk or a level (``walk_id`` empty) that was not scored, and why."""

    level: str
    walk_id: str
    reason: str


def _track_errors(track: ScoredTrack | None) -> dict[str, float | int | None] | None:
    if track is None:
        return None
    summary = summarize([track.scores]).as_dict()
    names = {"mean": "mean", "p50": "p50", "p90": "p90", "end": "end_p50", "ellipse95": "ellipse95"}
    return {name: summary[key] for name, key in names.items()}


def _rounded(values: Float64Array) -> list[float | None]:
    return [round(float(v), 3) if np.isfinite(v) else None for v in values]
