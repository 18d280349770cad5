"""The dashboard: static pages that are a client of the public API like any other.

Nothing here knows services, storage or numerics; whatever a page shows came through ``/v1``.
"""

from app.dashboard.router import router

__all__ = ["router"]
