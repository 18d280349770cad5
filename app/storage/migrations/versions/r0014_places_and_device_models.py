"""Where venues and levels are, the words of their names, models of devices, and the epoch of survey walks.

Revision ID: r0014
Revises: r0013
"""

from __future__ import annotations

from collections.abc import Iterator

import sqlalchemy as sa
from alembic import op

from app.engine.geodesy import GeoBox
from app.services.records import Anchor
from app.services.search import name_words
from app.storage.places import box_columns
from app.storage.repositories.venues import level_box, venue_box

revision = "r0014"
down_revision = "r0013"
branch_labels = None
depends_on = None

_CORNERS = ("south_deg", "west_deg", "north_deg", "east_deg")
_INDEXES = {
    "levels": "ordinal",
    "maps": "level_id",
    "walks": "survey_id",
    "jobs": "kind",
    "sessions": "status",
    "devices": "model",
}
"""Of each table: lists by this column need no sorting."""
_ID = sa.String(length=40)


def upgrade() -> None:
    """Add columns, tables and indexes, and fill them from what is stored."""
    for table in ("venues", "levels"):
        for name in _CORNERS:
            op.add_column(table, sa.Column(name, sa.Double(), nullable=True))
        op.add_column(table, sa.Column("place_band", sa.Integer(), nullable=True))
        op.add_column(table, sa.Column("place_lon", sa.Double(), nullable=True))
        op.create_index(op.f(f"ix_{table}_place_band_place_lon"), table, ["place_band", "place_lon"])
    for table, column in _INDEXES.items():
        op.create_index(op.f(f"ix_{table}_{column}_id"), table, [column, "id"])
    op.create_table(
        "name_words",
        sa.Column(
            "word",
            sa.String(length=64).with_variant(sa.String(length=64, collation="C"), "postgresql"),
            nullable=False,
        ),
        sa.Column("owner_id", _ID, nullable=False),
        sa.PrimaryKeyConstraint("word", "owner_id", name=op.f("pk_name_words")),
        sqlite_with_rowid=False,
    )
    op.create_index(op.f("ix_name_words_owner_id"), "name_words", ["owner_id"])
    op.add_column(
        "walks", sa.Column("calibration_epoch", sa.String(length=64), nullable=False, server_default="")
    )
    op.add_column("walks", sa.Column("offset_remembered_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("device_calibrations", sa.Column("model", sa.Text(), nullable=True))
    op.create_index(
        op.f("ix_device_calibrations_model_updated_at"), "device_calibrations", ["model", "updated_at"]
    )
    _fill(op.get_bind())


def _fill(connection: sa.Connection) -> None:
    devices = sa.table("devices", sa.column("id"), sa.column("model"))
    memories = sa.table("device_calibrations", sa.column("device_id"), sa.column("model"))
    model = sa.select(devices.c.model).where(devices.c.id == memories.c.device_id).scalar_subquery()
    connection.execute(sa.update(memories).values(model=model))
    venues = sa.table(
        "venues",
        *map(sa.column, ("id", "name", "latitude_deg", "longitude_deg", "bearing_deg", "height_m")),
        *map(sa.column, _CORNERS),
        *map(sa.column, ("place_band", "place_lon")),
    )
    for row in connection.execute(sa.select(venues)).all():
        known = row.latitude_deg is not None
        anchor = Anchor(row.latitude_deg, row.longitude_deg, row.bearing_deg, row.height_m) if known else None
        boxes = [box for box in _levels(connection, row.id, row.name, anchor) if box is not None]
        values = box_columns(venue_box(anchor, boxes))
        connection.execute(sa.update(venues).where(venues.c.id == row.id).values(values))
        _add_words(connection, row.id, row.name)


def _levels(connection: sa.Connection, venue_id: str, venue_name: str, anchor: Anchor | None) -> Iterator[GeoBox | None]:
    levels = sa.table(
        "levels",
        *map(sa.column, ("id", "venue_id", "name", "x_min", "y_min", "x_max", "y_max")),
        *map(sa.column, _CORNERS),
        *map(sa.column, ("place_band", "place_lon")),
    )
    for row in connection.execute(sa.select(levels).where(levels.c.venue_id == venue_id)).all():
        box = level_box(anchor, (row.x_min, row.y_min, row.x_max, row.y_max))
        connection.execute(sa.update(levels).where(levels.c.id == row.id).values(box_columns(box)))
        _add_words(connection, row.id, f"{row.name} {venue_name}")
        yield box


def _add_words(connection: sa.Connection, owner_id: str, name: str) -> None:
    words = sa.table("name_words", sa.column("word"), sa.column("owner_id"))
    for word in name_words(name):
        connection.execute(sa.insert(words).values(word=word, owner_id=owner_id))


def downgrade() -> None:
    """Forget them."""
    op.drop_index("ix_device_calibrations_model_updated_at", "device_calibrations")
    op.drop_column("device_calibrations", "model")
    op.drop_column("walks", "offset_remembered_at")
    op.drop_column("walks", "calibration_epoch")
    op.drop_table("name_words")
    for table, column in _INDEXES.items():
        op.drop_index(f"ix_{table}_{column}_id", table)
    for table in ("venues", "levels"):
        op.drop_index(f"ix_{table}_place_band_place_lon", table)
        for name in ("place_lon", "place_band", *_CORNERS):
            op.drop_column(table, name)
