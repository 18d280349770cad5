"""Aids of segments, BLE of survey walks, and what sessions teach about devices.

Revision ID: r0006
Revises: r0005
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "r0006"
down_revision = "r0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add columns and a table; what was stored before has no aids and taught nothing."""
    for name in ("ble", "gnss", "pressure", "speed", "steps"):
        op.add_column("segment_samples", sa.Column(name, sa.LargeBinary(), nullable=True))
    op.add_column("walk_samples", sa.Column("ble", sa.LargeBinary(), nullable=True))
    op.add_column(
        "sessions", sa.Column("calibration_epoch", sa.String(length=64), nullable=False, server_default="")
    )
    op.add_column("sessions", sa.Column("remembered_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("tracker_states", sa.Column("calibration", sa.JSON(), nullable=True))
    op.create_table(
        "device_calibrations",
        sa.Column("device_id", sa.String(length=40), nullable=False),
        sa.Column("epoch", sa.String(length=64), nullable=False),
        sa.Column("offset_x", sa.Double(), nullable=False),
        sa.Column("offset_y", sa.Double(), nullable=False),
        sa.Column("offset_z", sa.Double(), nullable=False),
        sa.Column("offset_sd_x", sa.Double(), nullable=False),
        sa.Column("offset_sd_y", sa.Double(), nullable=False),
        sa.Column("offset_sd_z", sa.Double(), nullable=False),
        sa.Column("stride_scale", sa.Double(), nullable=False),
        sa.Column("stride_scale_sd", sa.Double(), nullable=False),
        sa.Column("n_sessions", sa.Integer(), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["device_id"], ["devices.id"], name=op.f("fk_device_calibrations_device_id")),
        sa.PrimaryKeyConstraint("device_id", "epoch", name=op.f("pk_device_calibrations")),
    )
