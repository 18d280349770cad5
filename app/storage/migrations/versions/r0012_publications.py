"""Drafts of maps, and the log of what was published.

Revision ID: r0012
Revises: r0011
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0012"
down_revision = "r0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the log, which begins now, and what a build came to, as far as its job tells."""
    op.create_table(
        "publications",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("level_id", sa.String(length=40), nullable=False),
        sa.Column("map_id", sa.String(length=40), nullable=False),
        sa.Column("from_map_id", sa.String(length=40), nullable=True),
        sa.Column("key_id", sa.String(length=40), nullable=True),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["level_id"], ["levels.id"], name=op.f("fk_publications_level_id")),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name=op.f("fk_publications_map_id")),
        sa.ForeignKeyConstraint(["from_map_id"], ["maps.id"], name=op.f("fk_publications_from_map_id")),
        sa.ForeignKeyConstraint(["key_id"], ["api_keys.id"], name=op.f("fk_publications_key_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_publications")),
    )
    op.create_index(op.f("ix_publications_level_id_id"), "publications", ["level_id", "id"], unique=False)
    with op.batch_alter_table("map_builds") as batch_op:
        batch_op.add_column(sa.Column("publish", sa.Boolean(), server_default=sa.true(), nullable=False))
        batch_op.add_column(sa.Column("key_id", sa.String(length=40), nullable=True))
        batch_op.add_column(sa.Column("map_id", sa.String(length=40), nullable=True))
        batch_op.create_index(batch_op.f("ix_map_builds_map_id"), ["map_id"], unique=False)
        batch_op.create_foreign_key(batch_op.f("fk_map_builds_map_id"), "maps", ["map_id"], ["id"])
        batch_op.create_foreign_key(batch_op.f("fk_map_builds_key_id"), "api_keys", ["key_id"], ["id"])
    _note_maps_of_builds(op.get_bind())


def downgrade() -> None:
    """Forget them; drafts are versions like others then."""
    with op.batch_alter_table("map_builds") as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_map_builds_key_id"), type_="foreignkey")
        batch_op.drop_constraint(batch_op.f("fk_map_builds_map_id"), type_="foreignkey")
        batch_op.drop_index(batch_op.f("ix_map_builds_map_id"))
        for name in ("map_id", "key_id", "publish"):
            batch_op.drop_column(name)
    op.drop_table("publications")


def _note_maps_of_builds(connection: sa.Connection) -> None:
    jobs = sa.table("jobs", sa.column("id", sa.String), sa.column("result", sa.JSON))
    builds = sa.table("map_builds", sa.column("job_id", sa.String), sa.column("map_id", sa.String))
    known = set(connection.execute(sa.select(sa.table("maps", sa.column("id", sa.String)).c.id)).scalars())
    results = connection.execute(sa.select(jobs.c.id, jobs.c.result).join(builds, builds.c.job_id == jobs.c.id)).all()
    for job_id, result in results:
        if result.get("map_id") in known:
            connection.execute(sa.update(builds).where(builds.c.job_id == job_id).values(map_id=result["map_id"]))
