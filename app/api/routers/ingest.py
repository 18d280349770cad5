"""Doors for phones: messages of apps that push, with the token in the address."""

from __future__ import annotations

from functools import partial
from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from app.api import errors
from app.api.auth import by_token
from app.api.body import JSON, read_body
from app.api.deps import Context, ContextDep
from app.api.errors import ApiError, RateLimitedError
from app.api.ingest import SHOWN, lacking, shown, url_of
from app.api.responses import problems
from app.api.routing import api_router
from app.api.schemas.ingest import now_ns
from app.exchange.phones.errors import FormatError
from app.exchange.phones.phyphox import read_body as read_phyphox
from app.exchange.phones.phyphox_experiment import answer, experiment
from app.exchange.phones.sensor_logger import Message, read_message
from app.services.ingest.errors import IngestRefusedError
from app.services.ingest.records import Incoming, IngestApp, Received
from app.services.records import Position

router = api_router("ingest")

PHYPHOX_TYPE = "application/xml"
INGEST_BYTES = 16 * 2**20
"""Largest message, inflated: ten minutes of five sensors."""
PATIENCE_MESSAGES = 3
"""The first messages may hold only some sensors: others are slow to start."""
TELLING_READINGS = 40
"""A message of fewer does not show which sensors a phone sends."""
_POSITION_WAIT_S = 1.5
_CODES = {"ok": 1, "ambiguous": 2, "insufficient": 3, "off_map": 4, "disturbed": 5}
_TEXT = {"text/plain": {"schema": {"type": "string"}}}


def _push(description: str, answered: dict[str, Any], example: dict[str, Any]) -> dict[str, Any]:
    return {
        "responses": {
            200: {"description": "Stored.", "content": answered},
            SHOWN: {"description": "Not taken; the text is for the person with the phone.", "content": _TEXT},
            **problems(errors.RATE_LIMITED, errors.OVERLOADED),
        },
        "openapi_extra": {
            "requestBody": {
                "required": True,
                "description": description,
                "content": {JSON: {"schema": {"type": "object"}, "example": example}},
            }
        },
    }


@router.post(
    "/v1/ingest/sensor-logger/{token}",
    summary="Take a message of Sensor Logger",
    dependencies=[by_token()],
    response_class=Response,
    **_push(
        "A message of Sensor Logger's HTTP push (docs/phones.md).",
        {JSON: {"schema": {"type": "object"}, "example": {"stored": True, "repeated": False}}},
        {
            "messageId": 0,
            "sessionId": "5f2c1a",
            "deviceId": "a1",
            "payload": [
                {"name": "magnetometer", "time": 1764000012300000000, "values": {"x": 4.1, "y": -20.5, "z": -39.0}}
            ],
        },
    ),
)
async def push_sensor_logger(token: str, request: Request, context: ContextDep) -> Response:
    """Messages may come late, twice or in any order; readings of one recording become one session or survey walk.

    A message without readings (the app's test) is answered 200 if the token is good.
    """
    _count(context, token)
    try:
        body = await _body(context, token, request)
        return await run_in_threadpool(_take_sensor_logger, context, token, body)
    except (ApiError, FormatError, IngestRefusedError) as error:
        return shown(str(error))


def _take_sensor_logger(context: Context, token: str, body: bytes) -> Response:
    message = read_message(body)
    if message.message_id is None and not len(message.readings):
        context.services.recordings.token(token)
        return _stored(Received(None))
    received = context.services.recordings.receive(token, _incoming(message))
    problem = _problem(received, message)
    return _stored(received) if problem is None else shown(problem)


def _incoming(message: Message) -> Incoming:
    name = f"{message.device_id}/{message.session_id}"
    return Incoming(name, message.message_id, message.readings)


def _problem(received: Received, message: Message) -> str | None:
    """What the person with the phone should know although the message is stored."""
    recording = received.recording
    if recording is None:
        return None
    if recording.problem:
        return recording.problem
    telling = recording.n_messages >= PATIENCE_MESSAGES and len(message.readings) >= TELLING_READINGS
    return lacking(message.readings) if telling else None


def _stored(received: Received) -> Response:
    flag = b"true" if received.repeated else b"false"
    return Response(b'{"stored":true,"repeated":' + flag + b"}", media_type=JSON)


@router.post(
    "/v1/ingest/phyphox/{token}",
    summary="Take a message of our phyphox experiment",
    dependencies=[by_token()],
    response_class=Response,
    **_push(
        "Columns of readings, as the experiment of this service sends them (docs/phones.md).",
        {JSON: {"schema": {"type": "object"}, "example": {"x": [12.3], "y": [4.1], "sd": [1.2], "status": [1]}}},
        {"mx": [4.1], "my": [-20.5], "mz": [-39.0], "mt": [0.02]},
    ),
)
async def push_phyphox(token: str, request: Request, context: ContextDep) -> Response:
    """Take readings, and answer with the position that the phone shows: columns of one value, or of none.

    `status`: 1 located, 2 several places fit, 3 walk on, 4 off the map, 5 disturbed, 0 nothing yet.
    """
    _count(context, token)
    try:
        body = await _body(context, token, request)
        received = await run_in_threadpool(_take_phyphox, context, token, body)
    except (ApiError, FormatError, IngestRefusedError) as error:
        return shown(str(error))
    if received.job_ids:
        await context.broker.wait(received.job_ids[-1], _POSITION_WAIT_S)
    session_id = None if received.recording is None else received.recording.session_id
    last = None if session_id is None else await run_in_threadpool(_last, context, session_id)
    return Response(_position(last), media_type=JSON)


def _take_phyphox(context: Context, token: str, body: bytes) -> Received:
    recordings = context.services.recordings
    known = recordings.latest(recordings.token(token).id)
    started_ns = None if known is None else known.started_ns
    found = read_phyphox(body, received_ns=now_ns(context.clock()), started_ns=started_ns)
    name = f"{found.unique_id}/{found.started_ns}"
    return recordings.receive(
        token, Incoming(name, None, found.readings, frame=found.frame, started_ns=found.started_ns)
    )


def _last(context: Context, session_id: str) -> Position | None:
    (known,) = context.services.live.last_known([session_id])
    return known.position


def _position(position: Position | None) -> bytes:
    if position is None:
        return answer(0)
    fix = position.fix
    code = _CODES[fix.status.value]
    if fix.status.value != "ok":
        return answer(code)
    sd = ((fix.cov_xx + fix.cov_yy) / 2.0) ** 0.5
    return answer(code, x=fix.x, y=fix.y, sd=sd)


@router.get(
    "/v1/ingest/phyphox/{token}/experiment.phyphox",
    summary="Read the phyphox experiment of a token",
    dependencies=[by_token()],
    response_class=Response,
    responses={
        200: {
            "description": "The experiment, ready to be opened by phyphox.",
            "content": {PHYPHOX_TYPE: {"schema": {"type": "string"}}},
        },
        SHOWN: {"description": "No such token.", "content": _TEXT},
        **problems(errors.RATE_LIMITED),
    },
)
async def phyphox_experiment(token: str, request: Request, context: ContextDep) -> Response:
    """An experiment that measures, sends to this very address, and shows the position it is answered."""
    _count(context, token)
    try:
        known = await run_in_threadpool(partial(context.services.recordings.token, token))
    except IngestRefusedError as error:
        return shown(str(error))
    post_url = url_of(str(request.base_url), IngestApp.PHYPHOX, token).removesuffix("/experiment.phyphox")
    file = experiment(post_url, title=known.name)
    return Response(
        file,
        media_type=PHYPHOX_TYPE,
        headers={"Content-Disposition": 'attachment; filename="experiment.phyphox"', "Cache-Control": "no-store"},
    )


async def _body(context: Context, token: str, request: Request) -> bytes:
    # the token first: whoever has none makes the service read, inflate and parse nothing
    await run_in_threadpool(context.services.recordings.check, token)
    return await read_body(request, context.settings.max_body_bytes, inflated=INGEST_BYTES)


def _count(context: Context, token: str) -> None:
    quota = context.limiter.take(f"ingest {token[:60]}")
    if quota is not None and not quota.allowed:
        raise RateLimitedError(quota.retry_after_s)
