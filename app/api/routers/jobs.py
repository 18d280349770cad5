"""Jobs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from fastapi import Query, Request, Response

from app.api import errors
from app.api.auth import any_key, has_scope
from app.api.deps import KeyDep, ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas.jobs import JobOut, JobPage
from app.services.errors import ForbiddenError
from app.services.records import ApiKey, Job, JobKind, JobState, Scope

router = api_router("jobs")

SCOPE_OF: Mapping[JobKind, Scope] = {
    JobKind.LOCATE_SEGMENT: Scope.LOCATE,
    JobKind.BUILD_MAP: Scope.SURVEY,
    JobKind.CONTRIBUTE: Scope.SURVEY,
}
"""Who may see and cancel a job: whoever may cause such a one."""


@router.get("/v1/jobs", summary="List jobs", dependencies=[any_key()], responses=guarded(errors.INVALID))
def list_jobs(
    services: ServicesDep,
    key: KeyDep,
    paging: PagingDep,
    request: Request,
    response: Response,
    kind: Annotated[JobKind | None, Query(description="Of this kind only.")] = None,
    state: Annotated[JobState | None, Query(description="In this state only.")] = None,
) -> JobPage:
    """Jobs of the kinds that the key's scopes cover, newest first."""
    page = services.jobs.list(_shown_kinds(key, kind), state, paging.cursor, paging.limit)
    link_next(request, response, page.next_cursor)
    return JobPage(items=[JobOut.of(job) for job in page.items], next_cursor=page.next_cursor)


@router.get("/v1/jobs/{job_id}", summary="Read a job", dependencies=[any_key()], responses=guarded(errors.NOT_FOUND))
def get_job(job_id: str, services: ServicesDep, key: KeyDep) -> JobOut:
    """One job with its progress and result. A segment's job takes the scope `locate`, any other `survey`."""
    return JobOut.of(_allowed(key, services.jobs.get(job_id)))


@router.post(
    "/v1/jobs/{job_id}/cancel",
    summary="Cancel a job",
    dependencies=[any_key()],
    responses=guarded(errors.NOT_FOUND, errors.CONFLICT),
)
def cancel_job(job_id: str, services: ServicesDep, key: KeyDep) -> JobOut:
    """Cancel a job that has not ended; cancelling again changes nothing. A cancelled segment gives no fixes.

    A segment's job takes the scope `locate`, any other `survey`.
    """
    _allowed(key, services.jobs.get(job_id))
    return JobOut.of(services.jobs.cancel(job_id))


def _allowed(key: ApiKey, job: Job) -> Job:
    _check(key, job.kind)
    return job


def _check(key: ApiKey, kind: JobKind) -> None:
    if not has_scope(key, SCOPE_OF[kind]):
        raise ForbiddenError(SCOPE_OF[kind].value)


def _shown_kinds(key: ApiKey, asked: JobKind | None) -> tuple[JobKind, ...]:
    """Return the kinds to list."""
    if asked is not None:
        _check(key, asked)
        return (asked,)
    kinds = tuple(kind for kind, scope in SCOPE_OF.items() if has_scope(key, scope))
    if not kinds:
        raise ForbiddenError(Scope.LOCATE.value)
    return kinds
