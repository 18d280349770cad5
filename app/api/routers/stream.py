"""Sessions over WebSockets. OpenAPI knows no WebSockets: docs/live.md describes the messages."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, WebSocket

from app.api.deps import Context
from app.api.duplex import Duplex
from app.api.routing import api_router
from app.api.streams import MAX_NUMBER

router = api_router("live")


@router.websocket("/v1/sessions/{session_id}/stream")
async def stream(socket: WebSocket, session_id: str, after: Annotated[int, Query(ge=-1, le=MAX_NUMBER)] = -1) -> None:
    """Segments up, positions numbered above ``after`` down, until the session is over."""
    context: Context = socket.app.state.context
    await Duplex(context, socket, session_id, after).run()
