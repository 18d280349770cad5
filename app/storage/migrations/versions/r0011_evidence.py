"""Evidence and model of maps; how a version came about.

Revision ID: r0011
Revises: r0010
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0011"
down_revision = "r0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables; maps of before have no evidence and must be built anew before they can be updated."""
    op.create_table(
        "evidence_tiles",
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("hash", name=op.f("pk_evidence_tiles")),
    )
    op.create_table(
        "map_evidence",
        sa.Column("map_id", sa.String(length=40), nullable=False),
        sa.Column("row", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("column", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("tile_hash", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_map_evidence_map_id")),
        sa.ForeignKeyConstraint(["tile_hash"], ["evidence_tiles.hash"], name=op.f("fk_map_evidence_tile_hash")),
        sa.PrimaryKeyConstraint("map_id", "row", "column", name=op.f("pk_map_evidence")),
        sqlite_with_rowid=False,
    )
    op.add_column("maps", sa.Column("kind", sa.String(length=16), nullable=False, server_default="build"))
    op.add_column("maps", sa.Column("model", sa.JSON(), nullable=True))
    op.add_column("maps", sa.Column("added", sa.JSON(), nullable=True))
    op.add_column("maps", sa.Column("removed", sa.JSON(), nullable=True))
    op.add_column("map_builds", sa.Column("mode", sa.String(length=16), nullable=False, server_default="build"))


def downgrade() -> None:
    """Drop them."""
    op.drop_column("map_builds", "mode")
    for name in ("removed", "added", "model", "kind"):
        op.drop_column("maps", name)
    op.drop_table("map_evidence")
    op.drop_table("evidence_tiles")
