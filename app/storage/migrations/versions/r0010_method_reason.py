"""Why a session has its method.

Revision ID: r0010
Revises: r0009
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0010"
down_revision = "r0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add a column; sessions of before named their method."""
    op.add_column("sessions", sa.Column("method_reason", sa.String(length=256), nullable=True))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("sessions", "method_reason")
