"""Jobs."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import any_key
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.jobs import JobOut, JobPage
from app.services.records import JobKind, JobState

router = api_router("jobs")


@router.get("/v1/jobs", summary="List jobs", dependencies=[any_key()], responses=guarded(errors.INVALID))
def list_jobs(
    services: ServicesDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    kind: Annotated[JobKind | None, Query(description="Of this kind only.")] = None,
    state: Annotated[JobState | None, Query(description="In this state only.")] = None,
) -> JobPage:
    """Jobs, newest first."""
    page = services.jobs.list(kind, state, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return JobPage(items=[JobOut.of(job) for job in page.items], next_cursor=page.next_cursor)


@router.get("/v1/jobs/{job_id}", summary="Read a job", dependencies=[any_key()], responses=guarded(errors.NOT_FOUND))
def get_job(job_id: str, services: ServicesDep) -> JobOut:
    """One job with its progress and result."""
    return JobOut.of(services.jobs.get(job_id))


@router.post(
    "/v1/jobs/{job_id}/cancel",
    summary="Cancel a job",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def cancel_job(job_id: str, services: ServicesDep) -> JobOut:
    """Cancel a job that has not ended; cancelling again changes nothing. A cancelled segment gives no fixes."""
    return JobOut.of(services.jobs.cancel(job_id))
