"""Survey lines of maps.

Revision ID: r0009
Revises: r0008
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0009"
down_revision = "r0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add their table; maps of before have none."""
    op.create_table(
        "route_layers",
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("hash", name=op.f("pk_route_layers")),
    )
    with op.batch_alter_table("maps") as batch_op:
        batch_op.add_column(sa.Column("n_routes", sa.Integer(), nullable=True))
        batch_op.add_column(sa.Column("routes_hash", sa.String(length=64), nullable=True))
        batch_op.create_foreign_key(batch_op.f("fk_maps_routes_hash"), "route_layers", ["routes_hash"], ["hash"])


def downgrade() -> None:
    """Drop them."""
    with op.batch_alter_table("maps") as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_maps_routes_hash"), type_="foreignkey")
        batch_op.drop_column("routes_hash")
        batch_op.drop_column("n_routes")
    op.drop_table("route_layers")
