"""Where imported maps came from.

Revision ID: r0013
Revises: r0012
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0013"
down_revision = "r0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add a column; maps of before were built here."""
    op.add_column("maps", sa.Column("origin", sa.JSON(), nullable=True))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("maps", "origin")
