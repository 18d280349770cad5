"""Counts for operators."""

from __future__ import annotations

from dataclasses import fields
from typing import Self

from app.api.schemas.base import Out, example
from app.services import records
from app.services.records import JobState


class StatsOut(Out):
    """Counts of everything stored."""

    model_config = example(
        {
            "venues": 1,
            "levels": 2,
            "surveys": 3,
            "walks": 84,
            "maps": 2,
            "sessions_open": 5,
            "sessions": 120,
            "segments": 2400,
            "fixes": 19800,
            "jobs_by_state": {"queued": 1, "running": 2, "done": 2399},
        }
    )

    venues: int
    levels: int
    surveys: int
    walks: int
    maps: int
    sessions_open: int
    sessions: int
    segments: int
    fixes: int
    jobs_by_state: dict[JobState, int]

    @classmethod
    def of(cls, stats: records.Stats) -> Self:
        """Show the counts."""
        plain = {item.name: getattr(stats, item.name) for item in fields(stats)}
        return cls(**{**plain, "jobs_by_state": dict(stats.jobs_by_state)})
