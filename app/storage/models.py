"""Tables.

SQLAlchemy Core, no mapped classes: rows go straight into frozen records, so nothing can load lazily and the
hot path pays for no identity map. Blobs live in tables of their own; listing things never reads them. Everything
here is portable SQL; what concerns SQLite only is in :mod:`app.storage.database` (and ``WITHOUT ROWID``, which
other databases ignore).
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
    true,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


class UtcDateTime(TypeDecorator[datetime]):
    """Timezone-aware UTC on both sides, also where the database keeps no time zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, _dialect: Dialect) -> datetime | None:
        """Refuse naive times; store UTC."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("naive datetime; use datetime.now(UTC)")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, _dialect: Dialect) -> datetime | None:
        """Give the time zone back."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


ID = String(40)
HASH = String(64)
NUMBER = BigInteger().with_variant(Integer, "sqlite")


def _id() -> Column[str]:
    return Column("id", ID, primary_key=True)


def _time(name: str, *, nullable: bool = False) -> Column[Any]:
    return Column(name, UtcDateTime, nullable=nullable)


def _double(name: str, *, nullable: bool = False) -> Column[Any]:
    return Column(name, Double, nullable=nullable)


def _box() -> list[Column[Any]]:
    """Where a row is on earth (:mod:`app.storage.places`); all null if nobody knows."""
    corners = [_double(f"{side}_deg", nullable=True) for side in ("south", "west", "north", "east")]
    return [*corners, Column("place_band", Integer, nullable=True), _double("place_lon", nullable=True)]


def _reference(name: str, target: str, *, nullable: bool = False, index: bool = False) -> Column[Any]:
    return Column(name, ID, ForeignKey(target), nullable=nullable, index=index)


venues = Table(
    "venues",
    metadata,
    _id(),
    Column("name", Text, nullable=False),
    Column("kind", String(16), nullable=False),
    _double("latitude_deg", nullable=True),
    _double("longitude_deg", nullable=True),
    _double("bearing_deg", nullable=True),
    _double("height_m", nullable=True),
    _time("created_at"),
    _time("updated_at"),
    *_box(),
    Index(None, "place_band", "place_lon"),
)

levels = Table(
    "levels",
    metadata,
    _id(),
    _reference("venue_id", "venues.id", index=True),
    Column("name", Text, nullable=False),
    Column("ordinal", Integer, nullable=False),
    _double("x_min"),
    _double("y_min"),
    _double("x_max"),
    _double("y_max"),
    Column("has_plan_image", Boolean, nullable=False),
    Column("has_vector_plan", Boolean, nullable=False),
    _time("created_at"),
    _time("updated_at"),
    *_box(),
    Index(None, "place_band", "place_lon"),
    Index(None, "ordinal", "id"),
)

name_words = Table(
    "name_words",
    metadata,
    # compared by code point everywhere, so that the words that begin alike are one range
    Column("word", String(64).with_variant(String(64, collation="C"), "postgresql"), primary_key=True),
    # a venue or a level, which has its venue's words too
    Column("owner_id", ID, primary_key=True, index=True),
    sqlite_with_rowid=False,
)

level_plans = Table(
    "level_plans",
    metadata,
    Column("level_id", ID, ForeignKey("levels.id"), primary_key=True),
    Column("kind", String(16), primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

devices = Table(
    "devices",
    metadata,
    _id(),
    Column("name", Text, nullable=False),
    Column("model", Text, nullable=True),
    _time("created_at"),
    Index(None, "model", "id"),
)

device_calibrations = Table(
    "device_calibrations",
    metadata,
    Column("device_id", ID, ForeignKey("devices.id"), primary_key=True),
    Column("epoch", String(64), primary_key=True),
    _double("offset_x"),
    _double("offset_y"),
    _double("offset_z"),
    _double("offset_sd_x"),
    _double("offset_sd_y"),
    _double("offset_sd_z"),
    _double("stride_scale"),
    _double("stride_scale_sd"),
    Column("soft_iron", JSON, nullable=True),
    Column("n_sessions", Integer, nullable=False),
    _time("updated_at"),
    # the device's, which never changes: what its siblings taught last is one range of an index
    Column("model", Text, nullable=True),
    Index(None, "model", "updated_at"),
)

surveys = Table(
    "surveys",
    metadata,
    _id(),
    _reference("level_id", "levels.id", index=True),
    Column("name", Text, nullable=False),
    _time("created_at"),
)

walks = Table(
    "walks",
    metadata,
    _id(),
    _reference("survey_id", "surveys.id"),
    Column("name", Text, nullable=False),
    _reference("device_id", "devices.id", nullable=True),
    Column("n_samples", Integer, nullable=False),
    Column("n_waypoints", Integer, nullable=False),
    _double("duration_s"),
    _double("length_m"),
    Column("content_hash", HASH, nullable=False),
    _time("created_at"),
    Column("calibration_epoch", String(64), nullable=False, server_default=""),
    # when the walk's offset went into its device's memory
    _time("offset_remembered_at", nullable=True),
    UniqueConstraint("survey_id", "content_hash"),
    Index(None, "survey_id", "id"),
)

walk_samples = Table(
    "walk_samples",
    metadata,
    Column("walk_id", ID, ForeignKey("walks.id"), primary_key=True),
    Column("samples", LargeBinary, nullable=False),
    Column("waypoints", LargeBinary, nullable=False),
    Column("wifi", LargeBinary, nullable=True),
    Column("ble", LargeBinary, nullable=True),
)

jobs = Table(
    "jobs",
    metadata,
    # order of arrival: ids would do, but for clocks that are set back between two starts
    Column("number", NUMBER, primary_key=True, autoincrement=True),
    Column("id", ID, nullable=False, unique=True),
    Column("kind", String(16), nullable=False),
    Column("state", String(16), nullable=False),
    Column("order_key", ID, nullable=False),
    Column("subject", JSON, nullable=False),
    Column("attempts", Integer, nullable=False),
    _double("progress"),
    Column("progress_text", Text, nullable=False),
    Column("result", JSON, nullable=False),
    Column("error", Text, nullable=True),
    _time("created_at"),
    _time("started_at", nullable=True),
    _time("finished_at", nullable=True),
    # the claim and the bound of the queue read this index only
    Index(None, "state", "kind", "order_key", "number"),
    Index(None, "kind", "id"),
)

map_builds = Table(
    "map_builds",
    metadata,
    Column("job_id", ID, ForeignKey("jobs.id"), primary_key=True),
    _reference("level_id", "levels.id"),
    Column("settings", JSON, nullable=False),
    Column("survey_ids", JSON, nullable=False),
    Column("mode", String(16), nullable=False, server_default="build"),
    Column("publish", Boolean, nullable=False, server_default=true()),
    _reference("key_id", "api_keys.id", nullable=True),
    # what came of it
    _reference("map_id", "maps.id", nullable=True, index=True),
)

maps = Table(
    "maps",
    metadata,
    _id(),
    _reference("level_id", "levels.id"),
    Column("version", Integer, nullable=False),
    _reference("parent_id", "maps.id", nullable=True),
    Column("hash", HASH, nullable=False),
    Column("features", String(16), nullable=False),
    _double("x0"),
    _double("y0"),
    _double("cell_m"),
    Column("rows", Integer, nullable=False),
    Column("columns", Integer, nullable=False),
    _double("mapped_m"),
    Column("noise_sd", JSON, nullable=False),
    _double("mapped_share"),
    _double("mapped_area_m2"),
    Column("n_walks", Integer, nullable=False),
    Column("n_samples", Integer, nullable=False),
    _double("length_scale_m"),
    Column("field_sd", JSON, nullable=False),
    Column("walks", JSON, nullable=False),
    _double("build_s"),
    Column("has_obstacle", Boolean, nullable=False),
    Column("n_transmitters", Integer, nullable=True),
    _double("radio_cell_m", nullable=True),
    Column("radio_hash", HASH, ForeignKey("radio_layers.hash"), nullable=True),
    Column("n_routes", Integer, nullable=True),
    Column("routes_hash", HASH, ForeignKey("route_layers.hash"), nullable=True),
    Column("origin", JSON, nullable=True),
    _time("created_at"),
    Column("kind", String(16), nullable=False, server_default="build"),
    Column("model", JSON, nullable=True),
    # ids of the sources an update added and took out; those of a build are in its walks
    Column("added", JSON, nullable=True),
    Column("removed", JSON, nullable=True),
    UniqueConstraint("level_id", "version"),
    Index(None, "level_id", "id"),
)

radio_layers = Table(
    "radio_layers",
    metadata,
    Column("hash", HASH, primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

route_layers = Table(
    "route_layers",
    metadata,
    Column("hash", HASH, primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

current_maps = Table(
    "current_maps",
    metadata,
    Column("level_id", ID, ForeignKey("levels.id"), primary_key=True),
    _reference("map_id", "maps.id"),
)

publications = Table(
    "publications",
    metadata,
    _id(),
    _reference("level_id", "levels.id"),
    _reference("map_id", "maps.id"),
    _reference("from_map_id", "maps.id", nullable=True),
    _reference("key_id", "api_keys.id", nullable=True),
    Column("note", Text, nullable=False),
    _time("created_at"),
    Index(None, "level_id", "id"),
)

tiles = Table(
    "tiles",
    metadata,
    Column("hash", HASH, primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

map_tiles = Table(
    "map_tiles",
    metadata,
    Column("map_id", ID, ForeignKey("maps.id"), primary_key=True),
    Column("row", Integer, primary_key=True, autoincrement=False),
    Column("column", Integer, primary_key=True, autoincrement=False),
    Column("tile_hash", HASH, ForeignKey("tiles.hash"), nullable=False),
    sqlite_with_rowid=False,
)

evidence_tiles = Table(
    "evidence_tiles",
    metadata,
    Column("hash", HASH, primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

map_evidence = Table(
    "map_evidence",
    metadata,
    Column("map_id", ID, ForeignKey("maps.id"), primary_key=True),
    Column("row", Integer, primary_key=True, autoincrement=False),
    Column("column", Integer, primary_key=True, autoincrement=False),
    Column("tile_hash", HASH, ForeignKey("evidence_tiles.hash"), nullable=False),
    sqlite_with_rowid=False,
)

sessions = Table(
    "sessions",
    metadata,
    _id(),
    _reference("venue_id", "venues.id"),
    _reference("level_id", "levels.id", nullable=True),
    # pairs of level and map: written once, and read with every segment, so not in a table of their own
    Column("maps", JSON, nullable=False),
    _reference("device_id", "devices.id", nullable=True),
    Column("method", String(64), nullable=False),
    Column("parameters", JSON, nullable=False),
    Column("prior", JSON, nullable=False),
    Column("status", String(16), nullable=False),
    Column("next_seq", Integer, nullable=False),
    _time("created_at"),
    _time("closed_at", nullable=True),
    Column("calibration_epoch", String(64), nullable=False, server_default=""),
    Column("method_reason", String(256), nullable=True),
    # when what the session learned went into its device's memory
    _time("remembered_at", nullable=True),
    # the key that answers for what the session contributes to maps; none: it contributes nothing
    Column("contributor", ID, nullable=True),
    Index(None, "venue_id", "id"),
    Index(None, "level_id", "id"),
    Index(None, "device_id", "id"),
    Index(None, "status", "id"),
)

tracker_states = Table(
    "tracker_states",
    metadata,
    Column("session_id", ID, ForeignKey("sessions.id"), primary_key=True),
    Column("method", String(64), nullable=False),
    Column("payload", LargeBinary, nullable=False),
    _double("last_t", nullable=True),
    Column("calibration", JSON, nullable=True),
)

segments = Table(
    "segments",
    metadata,
    Column("session_id", ID, ForeignKey("sessions.id"), primary_key=True),
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("content_hash", HASH, nullable=False),
    Column("n_samples", Integer, nullable=False),
    _double("t_start"),
    _double("t_end"),
    _reference("job_id", "jobs.id"),
    Column("error", Text, nullable=True),
    # fixes of one segment are numbered without gaps, so two numbers replace an index on fixes; so are fixed-lag ones
    Column("first_fix", Integer, nullable=True),
    Column("n_fixes", Integer, nullable=True),
    Column("first_lagged", Integer, nullable=True),
    Column("n_lagged", Integer, nullable=True),
    _time("received_at"),
    _time("processed_at", nullable=True),
    sqlite_with_rowid=False,
)

segment_samples = Table(
    "segment_samples",
    metadata,
    Column("session_id", ID, primary_key=True),
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("samples", LargeBinary, nullable=False),
    Column("wifi", LargeBinary, nullable=True),
    Column("ble", LargeBinary, nullable=True),
    Column("gnss", LargeBinary, nullable=True),
    Column("pressure", LargeBinary, nullable=True),
    Column("speed", LargeBinary, nullable=True),
    Column("steps", LargeBinary, nullable=True),
    ForeignKeyConstraint(["session_id", "seq"], ["segments.session_id", "segments.seq"]),
)


def _fixes(name: str) -> Table:
    """Fixes of one kind; each kind counts for itself."""
    return Table(
        name,
        metadata,
        Column("session_id", ID, ForeignKey("sessions.id"), primary_key=True),
        Column("number", Integer, primary_key=True, autoincrement=False),
        Column("seq", Integer, nullable=False),
        _double("t"),
        Column("level_id", ID, nullable=False),
        _double("x"),
        _double("y"),
        _double("cov_xx"),
        _double("cov_xy"),
        _double("cov_yy"),
        _double("heading"),
        Column("status", String(16), nullable=False),
        _double("quality"),
        Column("sure", Boolean, nullable=False),
        _double("walk_on_m", nullable=True),
        Column("hypotheses", JSON, nullable=True),
        sqlite_with_rowid=False,
    )


fixes = _fixes("fixes")
lagged_fixes = _fixes("lagged_fixes")

contributions = Table(
    "contributions",
    metadata,
    _id(),
    _reference("session_id", "sessions.id"),
    _reference("level_id", "levels.id"),
    Column("device_id", ID, nullable=True),
    Column("contributor", ID, nullable=False),
    _reference("map_id", "maps.id"),
    Column("state", String(16), nullable=False),
    Column("n_steps", Integer, nullable=False),
    Column("n_kept", Integer, nullable=False),
    Column("n_rows", Integer, nullable=False),
    Column("reasons", JSON, nullable=False),
    Column("box", JSON, nullable=True),
    Column("n_agreed", Integer, nullable=False),
    Column("n_disagreed", Integer, nullable=False),
    Column("verdict", Text, nullable=False),
    _time("created_at"),
    _time("decided_at", nullable=True),
    UniqueConstraint("session_id", "level_id"),
    Index(None, "level_id", "state", "id"),
    Index(None, "contributor", "id"),
)

contribution_rows = Table(
    "contribution_rows",
    metadata,
    Column("contribution_id", ID, ForeignKey("contributions.id"), primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

field_changes = Table(
    "field_changes",
    metadata,
    _id(),
    _reference("level_id", "levels.id"),
    _reference("map_id", "maps.id"),
    Column("box", JSON, nullable=False),
    _double("area_m2"),
    Column("delta", JSON, nullable=False),
    _time("after", nullable=True),
    _time("before", nullable=True),
    _time("created_at"),
    Index(None, "level_id", "id"),
)

ground_truth = Table(
    "ground_truth",
    metadata,
    Column("session_id", ID, ForeignKey("sessions.id"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    _double("t"),
    _double("x"),
    _double("y"),
    Column("level_id", ID, nullable=True),
    _double("sd_m"),
    _time("created_at"),
    # no later fix can come nearer
    Column("settled", Boolean, nullable=False),
    # what was told there; all null while nothing was
    _double("fix_x", nullable=True),
    _double("fix_y", nullable=True),
    Column("fix_level_id", ID, nullable=True),
    _double("apart_s", nullable=True),
    _double("error_m", nullable=True),
    _double("normalized", nullable=True),
    Column("inside", Boolean, nullable=True),
    Column("sure", Boolean, nullable=True),
    Column("status", String(16), nullable=True),
    UniqueConstraint("session_id", "t"),
    Index(None, "t"),
    sqlite_with_rowid=False,
)

api_keys = Table(
    "api_keys",
    metadata,
    _id(),
    Column("name", Text, nullable=False),
    Column("scopes", JSON, nullable=False),
    Column("secret_hash", HASH, nullable=False, unique=True),
    _time("created_at"),
    _time("last_used_at", nullable=True),
    _time("revoked_at", nullable=True),
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("key_id", ID, primary_key=True),
    Column("idempotency_key", String(255), primary_key=True),
    Column("request_hash", HASH, nullable=False),
    Column("created_id", ID, nullable=False),
    Column("created_at", UtcDateTime, nullable=False, index=True),
)

ingest_tokens = Table(
    "ingest_tokens",
    metadata,
    _id(),
    Column("name", Text, nullable=False),
    Column("app", String(32), nullable=False),
    Column("purpose", String(16), nullable=False),
    _reference("device_id", "devices.id"),
    _reference("venue_id", "venues.id"),
    _reference("level_id", "levels.id", nullable=True),
    _reference("survey_id", "surveys.id", nullable=True),
    Column("frame", String(16), nullable=False),
    Column("prior", JSON(none_as_null=True), nullable=True),
    Column("contribute", Boolean, nullable=False),
    Column("build", String(16), nullable=False),
    Column("route", JSON, nullable=False),
    _reference("key_id", "api_keys.id"),
    Column("secret_hash", HASH, nullable=False, unique=True),
    _time("created_at"),
    _time("last_used_at", nullable=True),
    _time("revoked_at", nullable=True),
    Index(None, "device_id", "id"),
)

recordings = Table(
    "recordings",
    metadata,
    _id(),
    _reference("token_id", "ingest_tokens.id"),
    Column("device_id", ID, nullable=False),
    Column("app_session", String(256), nullable=False),
    Column("part", Integer, nullable=False),
    Column("purpose", String(16), nullable=False),
    Column("venue_id", ID, nullable=False),
    Column("level_id", ID, nullable=True),
    _reference("session_id", "sessions.id", nullable=True),
    Column("survey_id", ID, nullable=True),
    Column("walk_ids", JSON, nullable=False),
    Column("state", String(16), nullable=False),
    Column("next_number", BigInteger, nullable=False),
    Column("until_ns", BigInteger, nullable=True),
    Column("started_ns", BigInteger, nullable=True),
    Column("annotations", JSON, nullable=False),
    Column("n_messages", Integer, nullable=False),
    Column("n_samples", Integer, nullable=False),
    Column("n_late", Integer, nullable=False),
    Column("problem", Text, nullable=False),
    _time("opened_at"),
    _time("last_at"),
    _time("closed_at", nullable=True),
    UniqueConstraint("token_id", "app_session", "part"),
    Index(None, "token_id", "id"),
    Index(None, "device_id", "id"),
    Index(None, "state", "last_at"),
)

recording_rests = Table(
    "recording_rests",
    metadata,
    Column("recording_id", ID, ForeignKey("recordings.id"), primary_key=True),
    Column("data", LargeBinary, nullable=False),
)

recording_messages = Table(
    "recording_messages",
    metadata,
    Column("recording_id", ID, ForeignKey("recordings.id"), primary_key=True),
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    # none: they are among the samples of a session by now
    Column("readings", LargeBinary, nullable=True),
    _time("received_at"),
)

level_markers = Table(
    "level_markers",
    metadata,
    Column("level_id", ID, ForeignKey("levels.id"), primary_key=True),
    Column("name", String(100), primary_key=True),
    _double("x"),
    _double("y"),
)
