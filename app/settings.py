"""Settings of the service, from the environment (prefix ``ISODYN_``) or a ``.env`` file.

Every setting is described in ``docs/settings.md``; a test keeps the two in step.
"""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class PoolKind(StrEnum):
    """Where tasks run."""

    INLINE = "inline"
    THREADS = "threads"
    PROCESSES = "processes"


class LogLevel(StrEnum):
    """Least severe message that is written."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def _default_workers() -> int:
    return max(1, len(os.sched_getaffinity(0)))


class Settings(BaseSettings):
    """All settings, checked at start."""

    model_config = SettingsConfigDict(env_prefix="ISODYN_", env_file=".env", extra="ignore", frozen=True)

    data_dir: Path = Field(default=Path("data"), description="Folder of the database, map cache and compiled kernels.")
    host: str = Field(default="127.0.0.1", description="Address to listen on; 0.0.0.0 for all interfaces.")
    port: int = Field(default=8080, ge=0, le=65535, description="TCP port; 0 takes a free one.")
    power_safe: bool = Field(
        default=False, description="Acknowledged writes survive a power cut too, not only a killed process; slower."
    )

    pool: PoolKind = Field(default=PoolKind.PROCESSES, description="Where tasks run: inline, threads or processes.")
    workers: int = Field(default_factory=_default_workers, ge=1, le=256, description="Workers that locate segments.")
    maps_per_worker: int = Field(default=16, ge=1, description="Maps a worker keeps open.")
    map_cache_bytes: int = Field(
        default=2**30, ge=2**20, description="Disk space for unpacked maps in the data folder."
    )
    segment_time_limit_s: float = Field(
        default=60.0, gt=0, description="A worker process that takes longer over a segment is replaced."
    )
    build_time_limit_s: float = Field(
        default=3600.0, gt=0, description="A worker process that takes longer over a map is replaced."
    )
    worker_start_timeout_s: float = Field(
        default=120.0, gt=0, description="How long the first start may take (kernels are compiled once)."
    )
    shutdown_grace_s: float = Field(
        default=10.0, ge=0, description="How long a stop waits for running tasks; others run after the next start."
    )

    max_body_bytes: int = Field(default=8 * 2**20, ge=1024, description="Largest request body as sent.")
    max_queued_jobs: int = Field(default=1000, ge=1, description="Unfinished jobs accepted before 503.")
    max_wait_s: float = Field(default=30.0, ge=0, description="Longest `Prefer: wait=N` that is honoured.")
    recording_silence_s: float = Field(
        default=60.0, gt=0, description="A phone's recording ends when nothing has come for so long."
    )
    max_streams: int = Field(default=1000, ge=1, description="WebSockets and event streams open at once before 503.")
    rate_limit_per_minute: int = Field(default=6000, ge=0, description="Requests a key may make a minute; 0: no limit.")
    rate_limit_burst: int = Field(default=200, ge=1, description="Requests a key may make at once.")
    cors_origins: tuple[str, ...] = Field(default=(), description="Origins (JSON list) whose pages may call the API.")

    webhook_private_networks: bool = Field(
        default=False, description="Webhooks may be plain http, and lead into the service's own network."
    )
    webhook_timeout_s: float = Field(default=10.0, gt=0, description="How long a webhook may take to answer.")
    webhook_give_up_s: float = Field(
        default=86_400.0, ge=0, description="A message that cannot be delivered for so long is given up."
    )

    log_level: LogLevel = Field(default=LogLevel.INFO, description="Least severe message that is written.")
    log_json: bool = Field(default=False, description="One JSON object a line instead of text.")

    @property
    def database_path(self) -> Path:
        """The SQLite file."""
        return self.data_dir / "isodyn.db"

    @property
    def map_cache_dir(self) -> Path:
        """Unpacked maps, filled from the database."""
        return self.data_dir / "maps"

    @property
    def checkpoint_dir(self) -> Path:
        """What builds of maps go on from after an interruption."""
        return self.data_dir / "checkpoints"

    @property
    def kernel_cache_dir(self) -> Path:
        """Compiled kernels."""
        return self.data_dir / "kernels"
