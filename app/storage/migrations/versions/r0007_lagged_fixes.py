"""Fixed-lag fixes.

Revision ID: r0007
Revises: r0006
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0007"
down_revision = "r0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add their table and where in it a segment's begin; segments of before have none."""
    op.create_table(
        "lagged_fixes",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("seq", sa.Integer(), nullable=False),
        sa.Column("t", sa.Double(), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("x", sa.Double(), nullable=False),
        sa.Column("y", sa.Double(), nullable=False),
        sa.Column("cov_xx", sa.Double(), nullable=False),
        sa.Column("cov_xy", sa.Double(), nullable=False),
        sa.Column("cov_yy", sa.Double(), nullable=False),
        sa.Column("heading", sa.Double(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("quality", sa.Double(), nullable=False),
        sa.Column("sure", sa.Boolean(), nullable=False),
        sa.Column("walk_on_m", sa.Double(), nullable=True),
        sa.Column("hypotheses", sa.JSON(), nullable=True),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=op.f("fk_lagged_fixes_session_id")),
        sa.PrimaryKeyConstraint("session_id", "number", name=op.f("pk_lagged_fixes")),
        sqlite_with_rowid=False,
    )
    for name in ("first_lagged", "n_lagged"):
        op.add_column("segments", sa.Column(name, sa.Integer(), nullable=True))


def downgrade() -> None:
    """Drop both: positions of the moment are as they were."""
    for name in ("n_lagged", "first_lagged"):
        op.drop_column("segments", name)
    op.drop_table("lagged_fixes")
