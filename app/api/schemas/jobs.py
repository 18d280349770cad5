"""Jobs."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Self

from pydantic import Field

from app.api.schemas.base import Out, PageOut, Time, example
from app.api.schemas.levels import LEVEL_ID
from app.services import records
from app.services.records import JobKind, JobState

JOB_ID = "job_019ab2c4d1e07f3a9b2c4d5e6f"
JOB_EXAMPLE = {
    "id": JOB_ID,
    "kind": "build_map",
    "state": "running",
    "subject": {"level_id": LEVEL_ID},
    "attempts": 1,
    "progress": 0.4,
    "progress_text": "kriging",
    "result": {},
    "error": None,
    "created_at": "2026-11-22T09:30:00.000Z",
    "started_at": "2026-11-22T09:30:00.010Z",
    "finished_at": None,
}


class JobOut(Out):
    """A durable unit of work; `done`, `failed` and `cancelled` are final."""

    model_config = example(JOB_EXAMPLE)

    id: str
    kind: JobKind
    state: JobState
    subject: Annotated[dict[str, str | int], Field(description="Ids of what it works on.")]
    attempts: int
    progress: Annotated[float, Field(description="0 to 1.")]
    progress_text: str
    result: Annotated[dict[str, str | int | float], Field(description="What came of it: `map_id` of a build.")]
    error: str | None
    created_at: Time
    started_at: Time | None
    finished_at: Time | None

    @classmethod
    def of(cls, job: records.Job) -> Self:
        """Show a job."""
        plain = {item.name: getattr(job, item.name) for item in fields(job) if item.name != "order_key"}
        return cls(**{**plain, "subject": dict(job.subject), "result": dict(job.result)})


class JobPage(PageOut):
    """Jobs, newest first."""

    model_config = example({"items": [JOB_EXAMPLE], "next_cursor": None})

    items: list[JobOut]
