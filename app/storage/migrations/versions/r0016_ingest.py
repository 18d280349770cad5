"""Ingest tokens, recordings of phones with their messages, markers of levels.

Revision ID: r0016
Revises: r0015
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0016"
down_revision = "r0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "ingest_tokens",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("app", sa.String(length=32), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.Column("device_id", sa.String(length=40), nullable=False),
        sa.Column("venue_id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=True),
        sa.Column("survey_id", sa.String(length=40), nullable=True),
        sa.Column("frame", sa.String(length=16), nullable=False),
        sa.Column("prior", sa.JSON(), nullable=True),
        sa.Column("contribute", sa.Boolean(), nullable=False),
        sa.Column("build", sa.String(length=16), nullable=False),
        sa.Column("route", sa.JSON(), nullable=False),
        sa.Column("key_id", sa.String(length=40), nullable=False),
        sa.Column("secret_hash", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["device_id"], ["devices.id"], name=op.f("fk_ingest_tokens_device_id")),
        sa.ForeignKeyConstraint(["venue_id"], ["venues.id"], name=op.f("fk_ingest_tokens_venue_id")),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_ingest_tokens_level_id")),
        sa.ForeignKeyConstraint(["survey_id"], ["surveys.id"], name=op.f("fk_ingest_tokens_survey_id")),
        sa.ForeignKeyConstraint(["key_id"], ["api_keys.id"], name=op.f("fk_ingest_tokens_key_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_ingest_tokens")),
        sa.UniqueConstraint("secret_hash", name=op.f("uq_ingest_tokens_secret_hash")),
    )
    op.create_index(op.f("ix_ingest_tokens_device_id_id"), "ingest_tokens", ["device_id", "id"])
    op.create_table(
        "recordings",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("token_id", sa.String(length=40), nullable=False),
        sa.Column("device_id", sa.String(length=40), nullable=False),
        sa.Column("app_session", sa.String(length=256), nullable=False),
        sa.Column("part", sa.Integer(), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.Column("venue_id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=True),
        sa.Column("session_id", sa.String(length=40), nullable=True),
        sa.Column("survey_id", sa.String(length=40), nullable=True),
        sa.Column("walk_ids", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("next_number", sa.BigInteger(), nullable=False),
        sa.Column("until_ns", sa.BigInteger(), nullable=True),
        sa.Column("started_ns", sa.BigInteger(), nullable=True),
        sa.Column("annotations", sa.JSON(), nullable=False),
        sa.Column("n_messages", sa.Integer(), nullable=False),
        sa.Column("n_samples", sa.Integer(), nullable=False),
        sa.Column("n_late", sa.Integer(), nullable=False),
        sa.Column("problem", sa.Text(), nullable=False),
        sa.Column("opened_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("last_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("closed_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["token_id"], ["ingest_tokens.id"], name=op.f("fk_recordings_token_id")),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_recordings_session_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recordings")),
        sa.UniqueConstraint("token_id", "app_session", "part", name=op.f("uq_recordings_token_id_app_session_part")),
    )
    op.create_index(op.f("ix_recordings_token_id_id"), "recordings", ["token_id", "id"])
    op.create_index(op.f("ix_recordings_device_id_id"), "recordings", ["device_id", "id"])
    op.create_index(op.f("ix_recordings_state_last_at"), "recordings", ["state", "last_at"])
    op.create_table(
        "recording_rests",
        sa.Column("recording_id", sa.String(length=40), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name=op.f("fk_recording_rests_recording_id")),
        sa.PrimaryKeyConstraint("recording_id", name=op.f("pk_recording_rests")),
    )
    op.create_table(
        "recording_messages",
        sa.Column("recording_id", sa.String(length=40), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False, autoincrement=False),
        sa.Column("readings", sa.LargeBinary(), nullable=True),
        sa.Column("received_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["recording_id"], ["recordings.id"], name=op.f("fk_recording_messages_recording_id")),
        sa.PrimaryKeyConstraint("recording_id", "number", name=op.f("pk_recording_messages")),
    )
    op.create_table(
        "level_markers",
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("x", sa.Double(), nullable=False),
        sa.Column("y", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_level_markers_level_id")),
        sa.PrimaryKeyConstraint("level_id", "name", name=op.f("pk_level_markers")),
    )


def downgrade() -> None:
    """Drop them."""
    for table in ("level_markers", "recording_messages", "recording_rests", "recordings", "ingest_tokens"):
        op.drop_table(table)
