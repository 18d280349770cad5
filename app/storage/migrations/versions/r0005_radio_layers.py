"""Radio layers of maps.

Revision ID: r0005
Revises: r0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0005"
down_revision = "r0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add their table and what of them a map shows; maps of before have none."""
    op.create_table(
        "radio_layers",
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("hash", name=op.f("pk_radio_layers")),
    )
    with op.batch_alter_table("maps") as batch_op:
        batch_op.add_column(sa.Column("n_transmitters", sa.Integer(), nullable=True))
        batch_op.add_column(sa.Column("radio_cell_m", sa.Double(), nullable=True))
        batch_op.add_column(sa.Column("radio_hash", sa.String(length=64), nullable=True))
        batch_op.create_foreign_key(batch_op.f("fk_maps_radio_hash"), "radio_layers", ["radio_hash"], ["hash"])
