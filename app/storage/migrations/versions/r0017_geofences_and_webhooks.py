"""Geofences with their stays and events; webhooks with their deliveries.

Revision ID: r0017
Revises: r0016
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0017"
down_revision = "r0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables; what was before crossed nothing."""
    _add_geofences()
    _add_webhooks()


def downgrade() -> None:
    """Drop them, with all that was to be told."""
    for table in ("webhook_deliveries", "webhooks", "geofence_events", "geofence_stays", "geofences"):
        op.drop_table(table)


def _add_geofences() -> None:
    op.create_table(
        "geofences",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("polygon", sa.JSON(), nullable=False),
        sa.Column("x_min", sa.Double(), nullable=False),
        sa.Column("y_min", sa.Double(), nullable=False),
        sa.Column("x_max", sa.Double(), nullable=False),
        sa.Column("y_max", sa.Double(), nullable=False),
        sa.Column("events", sa.JSON(), nullable=False),
        sa.Column("dwell_s", sa.Double(), nullable=True),
        sa.Column("confidence", sa.Double(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_geofences_level_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_geofences")),
    )
    op.create_index(op.f("ix_geofences_level_id_id"), "geofences", ["level_id", "id"])
    op.create_table(
        "geofence_stays",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("geofence_id", sa.String(length=40), nullable=False),
        sa.Column("entered_t", sa.Double(), nullable=False),
        sa.Column("dwelled", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_geofence_stays_session_id")),
        sa.ForeignKeyConstraint(["geofence_id"], ["geofences.id"], name=op.f("fk_geofence_stays_geofence_id")),
        sa.PrimaryKeyConstraint("session_id", "geofence_id", name=op.f("pk_geofence_stays")),
        sqlite_with_rowid=False,
    )
    op.create_index(op.f("ix_geofence_stays_geofence_id"), "geofence_stays", ["geofence_id"])
    op.create_table(
        "geofence_events",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("geofence_id", sa.String(length=40), nullable=False),
        sa.Column("geofence_name", sa.Text(), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("device_id", sa.String(length=40), nullable=True),
        sa.Column("venue_id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("seq", sa.Integer(), nullable=True),
        sa.Column("t", sa.Double(), nullable=False),
        sa.Column("x", sa.Double(), nullable=True),
        sa.Column("y", sa.Double(), nullable=True),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.Column("dwell_s", sa.Double(), nullable=True),
        sa.Column("reason", sa.String(length=64), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_geofence_events_session_id")),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_geofence_events_level_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_geofence_events")),
    )
    for column in ("geofence_id", "session_id", "level_id"):
        op.create_index(op.f(f"ix_geofence_events_{column}_id"), "geofence_events", [column, "id"])


def _add_webhooks() -> None:
    op.create_table(
        "webhooks",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("url", sa.Text(), nullable=False),
        sa.Column("events", sa.JSON(), nullable=False),
        sa.Column("venue_id", sa.String(length=40), nullable=True),
        sa.Column("level_id", sa.String(length=40), nullable=True),
        sa.Column("active", sa.Boolean(), nullable=False),
        sa.Column("secret", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhooks")),
    )
    op.create_table(
        "webhook_deliveries",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("webhook_id", sa.String(length=40), nullable=False),
        sa.Column("event_id", sa.String(length=40), nullable=False),
        sa.Column("event", sa.String(length=32), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("next_attempt_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_attempt_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_status", sa.Integer(), nullable=True),
        sa.Column("last_error", sa.Text(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["webhook_id"], ["webhooks.id"], name=op.f("fk_webhook_deliveries_webhook_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_deliveries")),
    )
    op.create_index(op.f("ix_webhook_deliveries_webhook_id_id"), "webhook_deliveries", ["webhook_id", "id"])
    op.create_index(
        op.f("ix_webhook_deliveries_webhook_id_state_id"), "webhook_deliveries", ["webhook_id", "state", "id"]
    )
    op.create_index(op.f("ix_webhook_deliveries_created_at"), "webhook_deliveries", ["created_at"])
