"""Maps and surveys as files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, BinaryIO

import anyio
from fastapi import Depends, Query, Request, Response
from fastapi.responses import StreamingResponse

from app.api import errors
from app.api.auth import any_key, needs
from app.api.body import read_body, require_media_type
from app.api.deps import ContextDep, KeyDep, ServicesDep
from app.api.etag import REVALIDATE, headers, not_modified, tag
from app.api.responses import NOT_MODIFIED, OBJECT, guarded
from app.api.routing import api_router
from app.api.schemas.exchange import FieldChannel, FieldUnit, Line
from app.api.schemas.maps import MapOut
from app.exchange.maps import DEFAULT_SD, FORMATS, ImportChoices, MapFormat
from app.services.exchange import FileTexts, MapExport
from app.services.records import Scope

router = api_router("exchange")

ZIP = "application/zip"
FILE_TYPES = (
    "application/octet-stream",
    "image/tiff",
    "text/csv",
    *sorted({one.media_type for one in FORMATS.values()}),
)
"""Media types of map files."""
_IN_MEMORY = 4 * 2**20
_CHUNK = 256 * 1024
_BYTES = {"type": "string", "contentMediaType": "application/octet-stream"}
_FORMAT_WORDS = "; ".join(f"`{kind.value}`: {form.words}" for kind, form in FORMATS.items())


@router.get(
    "/v1/maps/{map_id}/export",
    summary="Export a map",
    dependencies=[any_key()],
    response_class=Response,
    responses={
        200: {
            "description": "The file.",
            "content": {kind: {"schema": _BYTES} for kind in sorted({one.media_type for one in FORMATS.values()})},
            "headers": {
                "ETag": {"schema": {"type": "string"}},
                "Content-Disposition": {"schema": {"type": "string"}, "description": "Holds the file's name."},
            },
        },
        **NOT_MODIFIED,
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
async def export_map(
    map_id: str,
    request: Request,
    context: ContextDep,
    format: Annotated[MapFormat, Query(description=f"{_FORMAT_WORDS}.")] = MapFormat.NETCDF,  # noqa: A002
    licence: Annotated[Line, Query(description="Licence that the file shall name.")] = "",
) -> Response:
    """A map version as a file: mean and standard deviation of each channel in microtesla, support, obstacles.

    Files hold no radio addresses and nothing about devices.
    """
    # A large map takes seconds and memory to write: few at once.
    return await anyio.to_thread.run_sync(
        _export_map, request, context, map_id, format, licence, limiter=context.uploads
    )


def _export_map(request: Request, context: ContextDep, map_id: str, kind: MapFormat, licence: str) -> Response:
    export = context.services.exchange.map_export(map_id, kind, licence)
    entity_tag = tag(export.tag)
    unchanged = not_modified(request, entity_tag, REVALIDATE)
    if unchanged is not None:
        return unchanged
    file = _written(export)
    size = file.tell()
    return StreamingResponse(
        _pieces(file),
        media_type=export.media_type,
        headers={
            **headers(entity_tag, REVALIDATE),
            "Content-Length": str(size),
            "Content-Disposition": f'attachment; filename="{export.file_name}"',
        },
    )


def _written(export: MapExport) -> BinaryIO:
    """The file on disk (or in memory, while it is small), so that no answer holds a large map in memory."""
    file: BinaryIO = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY)  # type: ignore[assignment]  # noqa: SIM115
    try:
        export.write(file)
    except BaseException:
        file.close()
        raise
    return file


def _pieces(file: BinaryIO) -> Iterator[bytes]:
    with file:
        file.seek(0)
        while piece := file.read(_CHUNK):
            yield piece


@dataclass(frozen=True, slots=True)
class _Import:
    """What the query says of a file."""

    kind: MapFormat
    choices: ImportChoices
    texts: FileTexts
    publish: bool


async def _import_of(
    format: Annotated[MapFormat, Query(description=f"{_FORMAT_WORDS}. One bare grid or GeoTIFF is taken too.")],  # noqa: A002
    channel: Annotated[
        FieldChannel | None, Query(description="What the only layer of a file is, if its name does not tell.")
    ] = None,
    unit: Annotated[FieldUnit | None, Query(description="Of the field; wins over the file's.")] = None,
    sd: Annotated[
        float | None,
        Query(
            ge=0,
            le=1000,
            allow_inf_nan=False,
            description=f"Standard deviation, uT, where the file has none; {DEFAULT_SD:g} if it is not given either.",
        ),
    ] = None,
    title: Annotated[Line, Query(description="Kept with the version.")] = "",
    licence: Annotated[Line, Query(description="Kept with the version, and named by its exports.")] = "",
    attribution: Annotated[Line, Query(description="Whom to name; kept with the version.")] = "",
    publish: Annotated[bool, Query(description="Make it the level's current map, as a build does.")] = True,
) -> _Import:
    choices = ImportChoices(channel=channel and channel.value, unit=unit and unit.value, sd=sd)
    return _Import(format, choices, FileTexts(title, licence, attribution), publish)


@router.post(
    "/v1/levels/{level_id}/maps/import",
    status_code=201,
    summary="Import a map",
    dependencies=[needs(Scope.SURVEY)],
    response_model=MapOut,
    responses=guarded(*OBJECT, errors.NOT_FOUND),
    openapi_extra={
        "requestBody": {
            "required": True,
            "description": "The file. `Content-Encoding: gzip` is taken.",
            "content": {kind: {"schema": _BYTES} for kind in FILE_TYPES},
        }
    },
)
async def import_map(
    level_id: str, request: Request, context: ContextDep, key: KeyDep, wanted: Annotated[_Import, Depends(_import_of)]
) -> Response:
    """Store the map of a file as the level's next version: an even grid in metres of the level frame.

    `origin` of the answer says where it came from, and what had to be assumed.
    """
    require_media_type(request, *FILE_TYPES)
    content = await read_body(request, context.settings.max_body_bytes)
    return await anyio.to_thread.run_sync(
        _import_map, context, level_id, content, wanted, key.id, limiter=context.uploads
    )


def _import_map(context: ContextDep, level_id: str, content: bytes, wanted: _Import, key_id: str) -> Response:
    info = context.services.exchange.import_map(
        level_id,
        content,
        wanted.kind,
        choices=wanted.choices,
        texts=wanted.texts,
        published=wanted.publish,
        key_id=key_id,
    )
    return Response(
        MapOut.of(info).model_dump_json(),
        status_code=201,
        media_type="application/json",
        headers={"Location": f"/v1/maps/{info.id}"},
    )


@router.get(
    "/v1/surveys/{survey_id}/export",
    summary="Export a survey",
    dependencies=[needs(Scope.SURVEY)],
    response_class=Response,
    responses={
        200: {
            "description": "A zip file: `survey.json`, and each walk as msgpack.",
            "content": {ZIP: {"schema": _BYTES}},
        },
        **guarded(errors.NOT_FOUND, errors.INVALID),
    },
)
def export_survey(
    survey_id: str,
    services: ServicesDep,
    radio: Annotated[
        bool, Query(description="With Wi-Fi and BLE readings: addresses that identify transmitters.")
    ] = False,
) -> Response:
    """All walks of a survey, each as `POST /v1/surveys/{survey_id}/walks` takes it; without device ids."""
    survey, pieces = services.exchange.survey_export(survey_id, radio=radio)
    name = f"{survey.id}.zip"
    return StreamingResponse(pieces, media_type=ZIP, headers={"Content-Disposition": f'attachment; filename="{name}"'})
