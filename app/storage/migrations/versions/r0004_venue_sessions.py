"""Sessions on any level of a venue: no level, and several maps.

Revision ID: r0004
Revises: r0002
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0004"
down_revision = "r0002"
branch_labels = None
depends_on = None

_SESSIONS = sa.table(
    "sessions",
    sa.column("id", sa.String),
    sa.column("level_id", sa.String),
    sa.column("map_id", sa.String),
    sa.column("maps", sa.JSON),
)


def upgrade() -> None:
    """Let the level be unknown; the one map of a session becomes a list of pairs of level and map."""
    op.add_column("sessions", sa.Column("maps", sa.JSON(), nullable=True))
    _move_maps()
    with op.batch_alter_table("sessions") as batch_op:
        batch_op.alter_column("maps", existing_type=sa.JSON(), nullable=False)
        batch_op.alter_column("level_id", existing_type=sa.String(length=40), nullable=True)
        batch_op.drop_constraint(batch_op.f("fk_sessions_map_id"), type_="foreignkey")
        batch_op.drop_column("map_id")
        batch_op.create_index(batch_op.f("ix_sessions_venue_id_id"), ["venue_id", "id"], unique=False)


def _move_maps() -> None:
    connection = op.get_bind()
    rows = connection.execute(sa.select(_SESSIONS.c.id, _SESSIONS.c.level_id, _SESSIONS.c.map_id)).all()
    if rows:
        connection.execute(
            sa.update(_SESSIONS).where(_SESSIONS.c.id == sa.bindparam("session")).values(maps=sa.bindparam("pairs")),
            [{"session": row.id, "pairs": [[row.level_id, row.map_id]]} for row in rows],
        )
