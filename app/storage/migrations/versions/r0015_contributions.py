"""Contributions of sessions to maps, and changes of the field.

Revision ID: r0015
Revises: r0014
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0015"
down_revision = "r0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables; sessions of before contribute nothing."""
    op.add_column("sessions", sa.Column("contributor", sa.String(length=40), nullable=True))
    op.create_table(
        "contributions",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("device_id", sa.String(length=40), nullable=True),
        sa.Column("contributor", sa.String(length=40), nullable=False),
        sa.Column("map_id", sa.String(length=40), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("n_steps", sa.Integer(), nullable=False),
        sa.Column("n_kept", sa.Integer(), nullable=False),
        sa.Column("n_rows", sa.Integer(), nullable=False),
        sa.Column("reasons", sa.JSON(), nullable=False),
        sa.Column("box", sa.JSON(), nullable=True),
        sa.Column("n_agreed", sa.Integer(), nullable=False),
        sa.Column("n_disagreed", sa.Integer(), nullable=False),
        sa.Column("verdict", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("decided_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_contributions_session_id")),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_contributions_level_id")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_contributions_map_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_contributions")),
        sa.UniqueConstraint("session_id", "level_id", name=op.f("uq_contributions_session_id_level_id")),
    )
    op.create_index(op.f("ix_contributions_level_id_state_id"), "contributions", ["level_id", "state", "id"])
    op.create_index(op.f("ix_contributions_contributor_id"), "contributions", ["contributor", "id"])
    op.create_table(
        "contribution_rows",
        sa.Column("contribution_id", sa.String(length=40), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["contribution_id"], ["contributions.id"], name=op.f("fk_contribution_rows_contribution_id")
        ),
        sa.PrimaryKeyConstraint("contribution_id", name=op.f("pk_contribution_rows")),
    )
    op.create_table(
        "field_changes",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("map_id", sa.String(length=40), nullable=False),
        sa.Column("box", sa.JSON(), nullable=False),
        sa.Column("area_m2", sa.Double(), nullable=False),
        sa.Column("delta", sa.JSON(), nullable=False),
        sa.Column("after", sa.DateTime(timezone=True), nullable=True),
        sa.Column("before", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_field_changes_level_id")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_field_changes_map_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_field_changes")),
    )
    op.create_index(op.f("ix_field_changes_level_id_id"), "field_changes", ["level_id", "id"])


def downgrade() -> None:
    """Drop them."""
    for table in ("field_changes", "contribution_rows", "contributions"):
        op.drop_table(table)
    op.drop_column("sessions", "contributor")
