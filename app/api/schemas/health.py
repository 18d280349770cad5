"""Health of the service."""

from __future__ import annotations

from app.api.schemas.base import Out, example


class HealthOut(Out):
    """The process answers."""

    model_config = example({"status": "ok"})

    status: str


class ReadyOut(Out):
    """Every part works."""

    model_config = example({"status": "ready", "parts": {"database": True, "pool": True}})

    status: str
    parts: dict[str, bool]
