"""What operators ask: counts, rates, delays, errors, accuracy, storage, alarms."""

from __future__ import annotations

from datetime import UTC
from typing import Annotated

from fastapi import Depends, Query, Request, Response
from pydantic import AwareDatetime

from app.api import errors
from app.api.auth import needs
from app.api.csv_answers import WantsCsvDep, answer, csv_answer
from app.api.deps import ServicesDep
from app.api.pagination import PagingDep, link_next
from app.api.responses import guarded
from app.api.routing import api_router
from app.api.schemas import stats_tables as tables
from app.api.schemas.base import IdRef
from app.api.schemas.stats import StatsOut
from app.services.records import Scope
from app.services.stats_records import Bucket, Filters, GroupBy, Window

router = api_router("stats")
_ADMIN = [needs(Scope.ADMIN)]

_When = "ISO 8601 with a time zone, or Unix milliseconds."
SinceQuery = Annotated[
    AwareDatetime | None, Query(description=f"From then on. {_When} By default a span of `bucket`'s.")
]
UntilQuery = Annotated[AwareDatetime | None, Query(description=f"Up to then, by default now. {_When}")]
BucketQuery = Annotated[Bucket | None, Query(description="Count so long stretches for themselves; at most 1,500.")]
ByQuery = Annotated[list[GroupBy] | None, Query(description="Tell apart by this; may be repeated.", max_length=3)]


async def _filters(
    venue_id: Annotated[IdRef | None, Query(description="Of this venue only.")] = None,
    level_id: Annotated[IdRef | None, Query(description="Of this level only.")] = None,
    device_id: Annotated[IdRef | None, Query(description="Of this device only.")] = None,
    method: Annotated[IdRef | None, Query(description="Located by this method only.")] = None,
) -> Filters:
    return Filters(venue_id, level_id, device_id, method)


def _window(
    services: ServicesDep, since: SinceQuery = None, until: UntilQuery = None, bucket: BucketQuery = None
) -> Window:
    first, last = (None if time is None else time.astimezone(UTC) for time in (since, until))
    return services.stats.window(first, last, bucket)


FiltersDep = Annotated[Filters, Depends(_filters)]
WindowDep = Annotated[Window, Depends(_window)]


@router.get("/v1/stats", summary="Read counts", dependencies=_ADMIN, responses=guarded())
def get_stats(services: ServicesDep) -> StatsOut:
    """Counts of everything stored."""
    return StatsOut.of(services.stats.stats())


@router.get(
    "/v1/stats/throughput",
    summary="Segments, samples and fixes over time",
    dependencies=_ADMIN,
    response_model=tables.ThroughputOut,
    responses={**csv_answer(tables.ThroughputRowOut), **guarded(errors.INVALID)},
)
def get_throughput(services: ServicesDep, window: WindowDep, filters: FiltersDep, as_csv: WantsCsvDep) -> Response:
    """By the time of acceptance, empty buckets too. Reads at most the 200,000 newest segments of the window."""
    shown = tables.ThroughputOut.of(services.stats.throughput(window, filters))
    return answer(shown, shown.items, tables.ThroughputRowOut, "throughput", as_csv=as_csv)


@router.get(
    "/v1/stats/latency",
    summary="How long jobs wait and take",
    dependencies=_ADMIN,
    response_model=tables.LatencyOut,
    responses={**csv_answer(tables.LatencyRowOut), **guarded(errors.INVALID)},
)
def get_latency(services: ServicesDep, window: WindowDep, filters: FiltersDep, as_csv: WantsCsvDep) -> Response:
    """Percentiles by kind of job, over those that ended. Reads at most the 50,000 newest jobs of a kind."""
    shown = tables.LatencyOut.of(services.stats.latency(window, filters))
    return answer(shown, shown.items, tables.LatencyRowOut, "latency", as_csv=as_csv)


@router.get(
    "/v1/stats/backlog",
    summary="What waits and what runs",
    dependencies=_ADMIN,
    response_model=tables.BacklogOut,
    responses={**csv_answer(tables.BacklogRowOut), **guarded(errors.INVALID)},
)
def get_backlog(services: ServicesDep, as_csv: WantsCsvDep) -> Response:
    """Jobs by kind, as of now."""
    shown = tables.BacklogOut(items=[tables.BacklogRowOut.of(row) for row in services.stats.backlog()])
    return answer(shown, shown.items, tables.BacklogRowOut, "backlog", as_csv=as_csv)


@router.get(
    "/v1/stats/errors",
    summary="What failed, by sort of error",
    dependencies=_ADMIN,
    response_model=tables.ErrorsOut,
    responses={**csv_answer(tables.ErrorRowOut), **guarded(errors.INVALID)},
)
def get_errors(services: ServicesDep, window: WindowDep, filters: FiltersDep, as_csv: WantsCsvDep) -> Response:
    """Failed jobs, each sort of text with its newest example; a failed segment is its job's failure.

    Jobs that were cancelled on request did not fail. `bucket` does nothing here. Looks at most at the 200,000 newest
    jobs of a kind.
    """
    shown = tables.ErrorsOut.of(services.stats.errors(window, filters))
    return answer(shown, shown.items, tables.ErrorRowOut, "errors", as_csv=as_csv)


@router.get(
    "/v1/stats/fixes",
    summary="What fixes claim",
    dependencies=_ADMIN,
    response_model=tables.FixCountsOut,
    responses={**csv_answer(tables.FixRowOut), **guarded(errors.INVALID)},
)
def get_fix_counts(
    services: ServicesDep, window: WindowDep, filters: FiltersDep, as_csv: WantsCsvDep, by: ByQuery = None
) -> Response:
    """Fixes by status, and the share of sure ones. Counts those of at most the 20,000 newest segments.

    `level_id` is here the level of the fix, also of sessions that are anywhere in a venue.
    """
    shown = tables.FixCountsOut.of(services.stats.fixes(window, filters, by or ()))
    return answer(shown, shown.items, tables.FixRowOut, "fixes", as_csv=as_csv)


@router.get(
    "/v1/stats/accuracy",
    summary="The error budget",
    dependencies=_ADMIN,
    response_model=tables.AccuracyOut,
    responses={**csv_answer(tables.AccuracyRowOut), **guarded(errors.INVALID)},
)
def get_accuracy(
    services: ServicesDep, window: WindowDep, filters: FiltersDep, as_csv: WantsCsvDep, by: ByQuery = None
) -> Response:
    """Errors at known positions (`POST /v1/sessions/{session_id}/ground-truth`) by the time at which they were passed.

    The interval takes points for independent; those of one walk are not quite. Reads at most the 50,000 newest points.
    """
    shown = tables.AccuracyOut.of(services.stats.accuracy(window, filters, by or ()))
    return answer(shown, shown.items, tables.AccuracyRowOut, "accuracy", as_csv=as_csv)


@router.get(
    "/v1/stats/storage",
    summary="What takes the space",
    dependencies=_ADMIN,
    response_model=tables.StorageOut,
    responses={**csv_answer(tables.StorageRowOut), **guarded(errors.INVALID)},
)
def get_storage(services: ServicesDep, as_csv: WantsCsvDep) -> Response:
    """Bytes by what they hold (estimated from the number of rows and the size of some), files and disk (measured)."""
    shown = tables.StorageOut(items=[tables.StorageRowOut.of(row) for row in services.stats.storage()])
    return answer(shown, shown.items, tables.StorageRowOut, "storage", as_csv=as_csv)


@router.get(
    "/v1/stats/levels",
    summary="Traffic, surveys and maps of levels",
    dependencies=_ADMIN,
    response_model=tables.LevelStatsPage,
    responses={**csv_answer(tables.LevelRowOut), **guarded(errors.INVALID)},
)
def get_level_stats(
    request: Request,
    services: ServicesDep,
    paging: PagingDep,
    as_csv: WantsCsvDep,
    since: SinceQuery = None,
    until: UntilQuery = None,
    venue_id: Annotated[IdRef | None, Query(description="Of this venue only.")] = None,
    level_id: Annotated[IdRef | None, Query(description="This level only.")] = None,
) -> Response:
    """Levels, newest first, a page at a time; sessions are those that were opened on the level in the window.

    Sessions that are anywhere in a venue belong to no level.
    """
    page = services.stats.levels(
        _window(services, since, until),
        venue_id=venue_id,
        level_id=level_id,
        cursor=paging.cursor,
        limit=paging.limit,
    )
    shown = tables.LevelStatsPage(
        items=[tables.LevelRowOut.of(row) for row in page.items], next_cursor=page.next_cursor
    )
    response = answer(shown, shown.items, tables.LevelRowOut, "levels", as_csv=as_csv)
    link_next(request, response, page.next_cursor)
    return response


@router.get(
    "/v1/stats/alarms",
    summary="What is worth attention",
    dependencies=_ADMIN,
    response_model=tables.AlarmsOut,
    responses={**csv_answer(tables.AlarmOut), **guarded(errors.INVALID)},
)
def get_alarms(services: ServicesDep, as_csv: WantsCsvDep) -> Response:
    """Alarms as of now, the most severe first, at most 20 of a rule; each ends with its cause."""
    shown = tables.AlarmsOut.of(services.alarms.now())
    return answer(shown, shown.items, tables.AlarmOut, "alarms", as_csv=as_csv)
