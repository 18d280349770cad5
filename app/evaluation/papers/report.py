"""The report over the papers: JSON, and tables with the papers' own figures beside ours.

JSON::

    {"s4": {region: {method: {"north", "east", "failure_rate", "ms", "tracks", ...}}},
     "s1": {set: {window: {method: {"mean", "within_1m", ..., "ms"}, "window_m", "route_m"}}},
     "s3": {"voting_dtw": {place: {...}}, "declination_aided": {place: {...}}},
     "about": {"s4": {region: {...}}}, "published": {...}, "notes": [...]}
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from app.evaluation.papers import published
from app.evaluation.papers.figures import (
    about_region,
    declination_figures,
    region_figures,
    voting_figures,
    window_figures,
)
from app.evaluation.papers.s1 import WindowResult
from app.evaluation.papers.s3 import DECLINATION, VOTING, DeclinationResult, VotingResult
from app.evaluation.papers.s4 import RegionResult
from app.evaluation.papers.tables import declination_table, s1_table, s4_table, voting_table


@dataclass(frozen=True, slots=True)
class PapersReport:
    """Results of a run; None is a paper that was not asked for."""

    s4: tuple[RegionResult, ...] | None = None
    s1: tuple[WindowResult, ...] | None = None
    voting: tuple[VotingResult, ...] | None = None
    aided: tuple[DeclinationResult, ...] | None = None
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        values: dict[str, Any] = {"set": "papers"}
        if self.s4 is not None:
            values["s4"] = {
                one.name: {method: region_figures(outcomes) for method, outcomes in one.outcomes.items()}
                for one in self.s4
            }
        if self.s1 is not None:
            values["s1"] = {}
            for result in self.s1:
                values["s1"].setdefault(result.name, {})[str(result.window)] = window_figures(result)
        if self.voting is not None or self.aided is not None:
            values["s3"] = {
                VOTING: {one.name: voting_figures(one) for one in self.voting or ()},
                DECLINATION: {one.name: declination_figures(one) for one in self.aided or ()},
            }
        values["about"] = {"s4": {one.name: about_region(one) for one in self.s4 or ()}}
        values["published"] = published.ALL
        values["notes"] = list(self.notes)
        return values

    def to_json(self) -> str:
        """The report as JSON text."""
        return json.dumps(self.to_dict(), allow_nan=False, separators=(",", ":"))

    def table(self) -> str:
        """The tables of the papers that were asked for."""
        values = self.to_dict()
        parts = []
        if "s4" in values:
            parts.append(s4_table(values["s4"], values["about"]["s4"]))
        if "s1" in values:
            parts.append(s1_table(values["s1"]))
        if "s3" in values:
            parts += [voting_table(values["s3"][VOTING]), declination_table(values["s3"][DECLINATION])]
        tables = ["\n".join(part) for part in parts]
        return "\n\n".join(tables + (["\n".join(f"note: {note}" for note in self.notes)] if self.notes else []))
