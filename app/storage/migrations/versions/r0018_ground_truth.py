"""Known positions of sessions, and what was told there.

Revision ID: r0018
Revises: r0017
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0018"
down_revision = "r0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "ground_truth",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("t", sa.Double(), nullable=False),
        sa.Column("x", sa.Double(), nullable=False),
        sa.Column("y", sa.Double(), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=True),
        sa.Column("sd_m", sa.Double(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("settled", sa.Boolean(), nullable=False),
        sa.Column("fix_x", sa.Double(), nullable=True),
        sa.Column("fix_y", sa.Double(), nullable=True),
        sa.Column("fix_level_id", sa.String(length=40), nullable=True),
        sa.Column("apart_s", sa.Double(), nullable=True),
        sa.Column("error_m", sa.Double(), nullable=True),
        sa.Column("normalized", sa.Double(), nullable=True),
        sa.Column("inside", sa.Boolean(), nullable=True),
        sa.Column("sure", sa.Boolean(), nullable=True),
        sa.Column("status", sa.String(length=16), nullable=True),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_ground_truth_session_id")),
        sa.PrimaryKeyConstraint("session_id", "number", name=op.f("pk_ground_truth")),
        sa.UniqueConstraint("session_id", "t", name=op.f("uq_ground_truth_session_id_t")),
        sqlite_with_rowid=False,
    )
    op.create_index(op.f("ix_ground_truth_t"), "ground_truth", ["t"])


def downgrade() -> None:
    """Drop it."""
    op.drop_table("ground_truth")
