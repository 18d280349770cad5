"""Hypotheses of ambiguous fixes.

Revision ID: r0002
Revises: r0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0002"
down_revision = "r0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; fixes stored before had none."""
    op.add_column("fixes", sa.Column("hypotheses", sa.JSON(), nullable=True))
