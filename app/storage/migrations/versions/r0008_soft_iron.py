"""Soft iron of devices.

Revision ID: r0008
Revises: r0007
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0008"
down_revision = "r0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add a column: elements and their standard deviations. Of devices remembered before, nothing is known of it."""
    op.add_column("device_calibrations", sa.Column("soft_iron", sa.JSON(), nullable=True))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("device_calibrations", "soft_iron")
