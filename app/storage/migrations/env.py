"""Alembic's entry point: migrates over the connection that :func:`app.storage.migrations.upgrade` hands over."""

from typing import Any, Literal

from alembic import context
from alembic.autogenerate.api import AutogenContext

from app.storage import geofence_models  # noqa: F401 - its tables
from app.storage.models import UtcDateTime, metadata


def render_item(kind: str, item: Any, _: AutogenContext) -> str | Literal[False]:
    """Write plain types into revisions: they must run unchanged when the models have moved on."""
    if kind == "type" and isinstance(item, UtcDateTime):
        return "sa.DateTime(timezone=True)"
    return False


context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite alters tables by rebuilding them
    render_item=render_item,
    compare_type=True,
)
with context.begin_transaction():
    context.run_migrations()
