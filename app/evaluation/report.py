"""The report of a run: every walk, every error, and the table that a user of the method would ask for.

JSON (the keys of the contract first)::

    {"set", "scenario", "aids", "through",
     "levels": {name: {"all": S, "covered": S}}, "overall": {"all": S, "covered": S}, "walks": [...],
     "method", "status", "notes", "aids_used", "baseline": {...}, "smoothed": {...} | null,
     "confidence": {"all": C, "covered": C},
     "long_walks": {"min_duration_s": 40, "levels": {name: {"all": E, "covered": E}}, "overall": {...}},
     "maps": {...}, "dropped": [...]}

``S`` is :class:`app.evaluation.metrics.Summary`, ``C`` :class:`app.evaluation.metrics.Confidence`, ``E``
:class:`app.evaluation.metrics.Ends`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from app.evaluation.metrics import Confidence, Ends, Summary, confidence, ends_of, summarize
from app.evaluation.protocol import Aids, Scenario, Through
from app.evaluation.results import BASELINE, Dropped, WalkResult
from app.evaluation.tables import layout, length_cell, percent_cell

LONG_WALK_S = 40.0
"""Walks of this length are long enough to find an unknown start on; how they end is reported by itself."""


class RunStatus(StrEnum):
    """Whether the run carries its figures."""

    OK = "ok"
    INSUFFICIENT = "insufficient"
    """No fix of the run claims a position: the method does not do this scenario."""


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

    def long_ends(self, level: str | None = None, *, covered: bool = False) -> Ends:
        """Where the walks of ``LONG_WALK_S`` and more end."""
        walks = [walk for walk in self._select(level, covered) if walk.duration_s >= LONG_WALK_S]
        return ends_of([walk.causal.scores for walk in walks])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        smoothed = any(walk.smoothed for walk in self.walks)
        return {
            "set": self.set_name,
            "scenario": self.scenario.value,
            "aids": str(self.aids),
            "through": self.through.value,
            **self._tree(self.summary),
            "walks": [walk.as_dict() for walk in self.walks],
            "method": self.method,
            "status": self.status.value,
            "notes": list(self.notes),
            "aids_used": self.aids_used,
            "baseline": {"method": BASELINE, **self._tree(self.baseline_summary)},
            "smoothed": self._tree(self.smoothed_summary) if smoothed else None,
            "confidence": {name: self._confidence(name == "covered").as_dict() for name in ("all", "covered")},
            "long_walks": {"min_duration_s": LONG_WALK_S, **self._tree(self.long_ends)},
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
        if self.scenario is Scenario.VENUE:
            lines += [_LEGEND_LEVEL, *(self._level_line(covered) for covered in (False, True))]
        lines += [self._long_line(covered) for covered in (False, True)]
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

    def _long_line(self, covered: bool) -> str:
        ends = self.long_ends(covered=covered)
        return (
            f"{_group(covered)} walks of {LONG_WALK_S:.0f} s and more: {ends.n_walks}, end<5m "
            f"{percent_cell(ends.end_within_5m)}, end p50 {length_cell(ends.end_p50)}, p90 {length_cell(ends.end_p90)}"
        )

    def _level_line(self, covered: bool) -> str:
        found = self._confidence(covered)
        steps, ends, sure = (
            percent_cell(share) for share in (found.level_hit_rate, found.end_level_hit_rate, found.sure_level_hit_rate)
        )
        return f"{_group(covered)} walks on the right level: {steps} of steps, {ends} of ends, {sure} of sure steps"

    def _maps(self) -> Mapping[str, MapNote]:
        return self.maps or {}

    def _select(self, level: str | None, covered: bool) -> list[WalkResult]:
        return [w for w in self.walks if (level is None or w.level == level) and (w.covered or not covered)]

    def _tree(self, summary: Callable[..., Summary | Ends]) -> dict[str, Any]:
        def both(level: str | None) -> dict[str, Any]:
            return {
                "all": summary(level, covered=False).as_dict(),
                "covered": summary(level, covered=True).as_dict(),
            }

        return {"levels": {name: both(name) for name in self.levels}, "overall": both(None)}

    def _confidence(self, covered: bool) -> Confidence:
        walks = self._select(None, covered)
        return confidence([w.causal.scores for w in walks], [w.start_t for w in walks])

    def _row(self, level: str | None, covered: bool) -> tuple[str, ...]:
        own, base = self.summary(level, covered=covered), self.baseline_summary(level, covered=covered)
        lengths = (own.mean, own.p50, own.p75, own.p90, own.p95, own.end_p50, own.end_p90)
        return (
            level or "overall",
            _group(covered),
            str(own.n_walks),
            *(length_cell(value) for value in lengths),
            *(percent_cell(value) for value in (own.end_within_5m, own.ellipse95, own.sure_share, own.sure_within_5m)),
            length_cell(own.ms_per_segment),
            length_cell(base.p50),
            length_cell(base.p90),
        )


_LEGEND_LEVEL = "a step on a wrong level is farther off than any other; mean: of the steps on the right one"
_HEADER = (
    "level", "walks", "n", "mean", "p50", "p75", "p90", "p95", "end p50", "end p90",
    "end<5m", "in 95 %", "sure", "sure<5m", "ms/seg", "dr p50", "dr p90",
)  # fmt: skip


def _group(covered: bool) -> str:
    return "covered" if covered else "all"


def _number(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
