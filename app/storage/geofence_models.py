"""Tables of geofences and webhooks."""

from __future__ import annotations

from sqlalchemy import JSON, Boolean, Column, Double, ForeignKey, Index, Integer, String, Table, Text

from app.storage.models import ID, UtcDateTime, metadata

geofences = Table(
    "geofences",
    metadata,
    Column("id", ID, primary_key=True),
    Column("level_id", ID, ForeignKey("levels.id"), nullable=False),
    Column("name", Text, nullable=False),
    Column("polygon", JSON, nullable=False),
    # its bounding box: what is far from a segment's fixes is not even read
    Column("x_min", Double, nullable=False),
    Column("y_min", Double, nullable=False),
    Column("x_max", Double, nullable=False),
    Column("y_max", Double, nullable=False),
    Column("events", JSON, nullable=False),
    Column("dwell_s", Double, nullable=True),
    Column("confidence", Double, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("updated_at", UtcDateTime, nullable=False),
    Index(None, "level_id", "id"),
)

geofence_stays = Table(
    "geofence_stays",
    metadata,
    Column("session_id", ID, ForeignKey("sessions.id"), primary_key=True),
    Column("geofence_id", ID, ForeignKey("geofences.id"), primary_key=True, index=True),
    Column("entered_t", Double, nullable=False),
    Column("dwelled", Boolean, nullable=False),
    sqlite_with_rowid=False,
)

geofence_events = Table(
    "geofence_events",
    metadata,
    Column("id", ID, primary_key=True),
    Column("kind", String(16), nullable=False),
    # no reference: events outlive their geofence
    Column("geofence_id", ID, nullable=False),
    Column("geofence_name", Text, nullable=False),
    Column("session_id", ID, ForeignKey("sessions.id"), nullable=False),
    Column("device_id", ID, nullable=True),
    Column("venue_id", ID, nullable=False),
    Column("level_id", ID, ForeignKey("levels.id"), nullable=False),
    Column("seq", Integer, nullable=True),
    Column("t", Double, nullable=False),
    Column("x", Double, nullable=True),
    Column("y", Double, nullable=True),
    Column("probability", Double, nullable=True),
    Column("dwell_s", Double, nullable=True),
    Column("reason", String(64), nullable=True),
    Column("created_at", UtcDateTime, nullable=False),
    Index(None, "geofence_id", "id"),
    Index(None, "session_id", "id"),
    Index(None, "level_id", "id"),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column("id", ID, primary_key=True),
    Column("url", Text, nullable=False),
    Column("events", JSON, nullable=False),
    # no references: a place that is gone just has no events any more
    Column("venue_id", ID, nullable=True),
    Column("level_id", ID, nullable=True),
    Column("active", Boolean, nullable=False),
    Column("secret", String(64), nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("updated_at", UtcDateTime, nullable=False),
)

webhook_deliveries = Table(
    "webhook_deliveries",
    metadata,
    Column("id", ID, primary_key=True),
    Column("webhook_id", ID, ForeignKey("webhooks.id"), nullable=False),
    Column("event_id", ID, nullable=False),
    Column("event", String(32), nullable=False),
    Column("body", Text, nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("next_attempt_at", UtcDateTime, nullable=True),
    Column("last_attempt_at", UtcDateTime, nullable=True),
    Column("last_status", Integer, nullable=True),
    Column("last_error", Text, nullable=True),
    Column("created_at", UtcDateTime, nullable=False),
    Index(None, "webhook_id", "id"),
    Index(None, "webhook_id", "state", "id"),
    Index(None, "created_at"),
)
