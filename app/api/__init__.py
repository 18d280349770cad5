"""The HTTP API: :func:`create_api` assembles it from services and ports; nothing here knows SQL or numerics."""

from app.api.application import create_api
from app.api.ports import ApiSettings, Broker, Metrics, Readiness

__all__ = ["ApiSettings", "Broker", "Metrics", "Readiness", "create_api"]
