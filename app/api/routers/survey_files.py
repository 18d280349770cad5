"""Files of survey recordings on their way into a survey."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Annotated

import anyio
from fastapi import Depends, Query, Request

from app.api import errors
from app.api.auth import needs
from app.api.body import read_body, require_media_type
from app.api.deps import ContextDep
from app.api.responses import OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.exchange import Line
from app.api.schemas.samples import Frame
from app.api.schemas.survey_files import SurveyImportOut
from app.api.survey_import import import_recording, pairs_of
from app.exchange.survey_formats import FileChoices, SurveyFormat
from app.services.records import Scope

router = api_router("surveys")

FILE_TYPES = ("application/octet-stream", "application/zip", "text/csv", "text/plain")
_BYTES = {"type": "string", "contentMediaType": "application/octet-stream"}


@dataclass(frozen=True, slots=True)
class _Import:
    """What the query says of a file."""

    kind: SurveyFormat
    choices: FileChoices
    frame: Frame
    radio: bool
    dry_run: bool


async def _import_of(
    format: Annotated[  # noqa: A002
        SurveyFormat,
        Query(
            description="`archive`: as `GET /v1/surveys/{survey_id}/export` sends it. `csv`: a row a sample. "
            "`getsensordata`: a log of that application. `sensor-logger`, `phyphox`: exports; annotations at markers "
            "of the level (or with level metres as their text) are the waypoints."
        ),
    ],
    name: Annotated[Line, Query(description="Of the walks, if the file does not name them.")] = "walk",
    floor: Annotated[Line | None, Query(description="Only what lies there.")] = None,
    start: Annotated[datetime | None, Query(description="When a clock without a date began.")] = None,
    column: Annotated[list[Line], Query(description="Of CSV: a column's name, as in `mag_x=MagX`.")] = [],  # noqa: B006
    unit: Annotated[list[Line], Query(description="Of CSV: a sensor's unit, as in `mag=nT`.")] = [],  # noqa: B006
    frame: Annotated[Frame, Query(description="Axes of the sensors.")] = Frame.ANDROID,
    radio: Annotated[bool, Query(description="Of archives: take Wi-Fi and BLE readings along.")] = False,
    dry_run: Annotated[bool, Query(description="Only report; store nothing.")] = False,
) -> _Import:
    choices = FileChoices(
        name=name,
        floor=floor,
        start_s=None if start is None else (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp(),
        columns=pairs_of("column", column),
        units=pairs_of("unit", unit),
    )
    return _Import(format, choices, frame, radio, dry_run)


@router.post(
    "/v1/surveys/{survey_id}/import",
    summary="Import survey recordings",
    dependencies=[needs(Scope.SURVEY)],
    responses=guarded(*OBJECT, errors.NOT_FOUND),
    openapi_extra={
        "requestBody": {
            "required": True,
            "description": "The file. `Content-Encoding: gzip` is taken.",
            "content": {kind: {"schema": _BYTES} for kind in FILE_TYPES},
        }
    },
)
async def import_survey(
    survey_id: str, request: Request, context: ContextDep, wanted: Annotated[_Import, Depends(_import_of)]
) -> SurveyImportOut:
    """Read the walks of a file in another format into a survey, with an account of what was made of it.

    A walk that is there already stays one; a walk that cannot be used is reported and stops no other. A file that
    cannot be read stores nothing. With `dry_run=true` nothing is stored at all.
    """
    require_media_type(request, *FILE_TYPES)
    content = await read_body(request, context.settings.max_body_bytes)
    work = partial(
        import_recording,
        context,
        survey_id,
        content,
        wanted.kind,
        wanted.choices,
        frame=wanted.frame,
        radio=wanted.radio,
        dry_run=wanted.dry_run,
    )
    return await anyio.to_thread.run_sync(work, limiter=context.uploads)
