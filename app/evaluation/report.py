"""The report of a run: every walk, every error, and the table that a user of the method would ask for.

JSON (the keys of the contract first)::

    {"set", "scenario", "aids", "through",
     "levels": {name: {"all": S, "covered": S}}, "overall": {"all": S, "covered": S}, "walks": [...],
     "method", "status", "notes", "aids_used", "baseline": {...}, "smoothed": {...} | null,
     "confidence": {"all": C, "covered": C}, "maps": {...}, "dropped": [...]}

``S`` is :class:`app.evaluation.metrics.Summary`, ``C`` :class:`app.evaluation.metrics.Confidence`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from app.engine.types import Fix, Prior, Waypoints
from app.evaluation.metrics import StepScores, Summary, confidence, summarize
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.truth import COVERED_SHARE, WalkTruth

BASELINE = "dead_reckoning"


class RunStatus(StrEnum):
    """Whether the run carries its figures."""

    OK = "ok"
    INSUFFICIENT = "insufficient"
    """No fix of the run claims a position: the method does not do this scenario."""


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
            "duration_s": round(self.end_t - self.start_t, 2),
            "n_steps": len(self.truth),
            "n_scored": len(scores),
            "n_fixes": len(self.causal.fixes),
            "n_segments": self.n_segments,
            **own,
            "end": summary["end_p50"],
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


@dataclass(frozen=True, slots=True)
class MapNote:
    """What a level's map was built from; ``build_s`` is None if it came from the cache."""

    n_walks: int
    build_s: float | None


@dataclass(frozen=True, slots=True)
class Report:
    """Result of a run."""

    set_name: str
    scenario: Scenario
    aids: Aids
    through: Through
    method: str
    levels: tuple[str, ...]
    walks: tuple[WalkResult, ...]
    dropped: tuple[Dropped, ...] = ()
    maps: Mapping[str, MapNote] | None = None
    aids_used: bool | None = None
    notes: tuple[str, ...] = ()

    @property
    def status(self) -> RunStatus:
        """``insufficient`` if no scored step of any walk has a fix that claims a position."""
        located = any(walk.causal.scores.located.any() for walk in self.walks)
        return RunStatus.OK if located else RunStatus.INSUFFICIENT

    def summary(self, level: str | None = None, *, covered: bool = False) -> Summary:
        """Figures of the method on one level, or on all."""
        walks = self._select(level, covered)
        return summarize([walk.causal.scores for walk in walks], [s for walk in walks for s in walk.segment_s])

    def baseline_summary(self, level: str | None = None, *, covered: bool = False) -> Summary:
        """Figures of dead reckoning on the same walks."""
        return summarize([w.baseline.scores for w in self._select(level, covered) if w.baseline])

    def smoothed_summary(self, level: str | None = None, *, covered: bool = False) -> Summary:
        """Figures of the after-the-fact tracks on the same walks."""
        return summarize([w.smoothed.scores for w in self._select(level, covered) if w.smoothed])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        smoothed = any(walk.smoothed for walk in self.walks)
        return {
            "set": self.set_name,
            "scenario": self.scenario.value,
            "aids": self.aids.value,
            "through": self.through.value,
            **self._tree(self.summary),
            "walks": [walk.as_dict() for walk in self.walks],
            "method": self.method,
            "status": self.status.value,
            "notes": list(self.notes),
            "aids_used": self.aids_used,
            "baseline": {"method": BASELINE, **self._tree(self.baseline_summary)},
            "smoothed": self._tree(self.smoothed_summary) if smoothed else None,
            "confidence": {name: self._confidence(name == "covered") for name in ("all", "covered")},
            "maps": {name: {"n_walks": m.n_walks, "build_s": _number(m.build_s)} for name, m in self._maps().items()},
            "dropped": [{"level": d.level, "walk_id": d.walk_id, "reason": d.reason} for d in self.dropped],
        }

    def to_json(self) -> str:
        """The report as JSON text (no NaN: what is not known is null)."""
        return json.dumps(self.to_dict(), allow_nan=False, separators=(",", ":"))

    def table(self) -> str:
        """One row per level and for all of them, all walks and covered ones, dead reckoning beside them."""
        rows: list[tuple[str, ...]] = [_HEADER]
        for name in self.levels if len(self.levels) > 1 else ():
            rows += [self._row(name, covered) for covered in (False, True)]
        rows += [self._row(None, covered) for covered in (False, True)]
        head = f"{self.set_name}, {self.scenario}, aids {self.aids}, {self.method} through {self.through}"
        if self.status is RunStatus.INSUFFICIENT:
            head += ": insufficient (no fix claims a position)"
        lines = [head, *layout(rows, left=2), "errors in metres; dr: dead reckoning from the same prior"]
        lines += [f"dropped: {d.level} {d.walk_id} ({d.reason})" for d in self.dropped]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def walk_table(self) -> str:
        """One row per walk."""
        rows: list[tuple[str, ...]] = [
            ("walk", "length", "fixes", "p50", "p90", "dr p50", "dr p90", "in 95 %", "covered", "ms/segment")
        ]
        for walk in self.walks:
            own = summarize([walk.causal.scores], walk.segment_s)
            base = summarize([walk.baseline.scores]) if walk.baseline else summarize([])
            rows.append(
                (
                    f"{walk.level} {walk.walk_id}",
                    f"{walk.length_m:.0f} m",
                    str(len(walk.causal.fixes)),
                    *(length_cell(value) for value in (own.p50, own.p90, base.p50, base.p90)),
                    percent_cell(own.ellipse95),
                    percent_cell(walk.covered_share),
                    length_cell(own.ms_per_segment),
                )
            )
        return "\n".join(layout(rows, left=1))

    def _maps(self) -> Mapping[str, MapNote]:
        return self.maps or {}

    def _select(self, level: str | None, covered: bool) -> list[WalkResult]:
        return [w for w in self.walks if (level is None or w.level == level) and (w.covered or not covered)]

    def _tree(self, summary: Callable[..., Summary]) -> dict[str, Any]:
        def both(level: str | None) -> dict[str, Any]:
            return {
                "all": summary(level, covered=False).as_dict(),
                "covered": summary(level, covered=True).as_dict(),
            }

        return {"levels": {name: both(name) for name in self.levels}, "overall": both(None)}

    def _confidence(self, covered: bool) -> dict[str, int | float | None]:
        walks = self._select(None, covered)
        return confidence([w.causal.scores for w in walks], [w.start_t for w in walks]).as_dict()

    def _row(self, level: str | None, covered: bool) -> tuple[str, ...]:
        own, base = self.summary(level, covered=covered), self.baseline_summary(level, covered=covered)
        lengths = (own.mean, own.p50, own.p75, own.p90, own.p95, own.end_p50, own.end_p90)
        return (
            level or "overall",
            "covered" if covered else "all",
            str(own.n_walks),
            *(length_cell(value) for value in lengths),
            *(percent_cell(value) for value in (own.end_within_5m, own.ellipse95, own.sure_share, own.sure_within_5m)),
            length_cell(own.ms_per_segment),
            length_cell(base.p50),
            length_cell(base.p90),
        )


_HEADER = (
    "level", "walks", "n", "mean", "p50", "p75", "p90", "p95", "end p50", "end p90",
    "end<5m", "in 95 %", "sure", "sure<5m", "ms/seg", "dr p50", "dr p90",
)  # fmt: skip


def layout(rows: Sequence[tuple[str, ...]], *, left: int) -> list[str]:
    """Rows of text as aligned lines, the first ``left`` columns to the left, a rule below the header."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(
            cell.ljust(w) if i < left else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    return [lines[0].rstrip(), "-" * len(lines[0]), *(line.rstrip() for line in lines[1:])]


def _track_errors(track: ScoredTrack | None) -> dict[str, float | int | None] | None:
    if track is None:
        return None
    summary = summarize([track.scores]).as_dict()
    names = {"mean": "mean", "p50": "p50", "p90": "p90", "end": "end_p50", "ellipse95": "ellipse95"}
    return {name: summary[key] for name, key in names.items()}


def _rounded(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[float | None]:
    return [round(float(v), 3) if np.isfinite(v) else None for v in values]


def _number(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def length_cell(value: float | None) -> str:
    """A length or time in a table."""
    return "-" if value is None else f"{value:.2f}"


def percent_cell(value: float | None) -> str:
    """A share in a table."""
    return "-" if value is None else f"{100 * value:.0f} %"
