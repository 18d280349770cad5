"""A service of one's own: a subprocess on a free port with its own data directory."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from isodyn_client import Client, IsodynError, RetryPolicy

from app.cli.errors import StartError

HOST = "127.0.0.1"
START_TIMEOUT_S = 180.0
"""The very first start compiles the kernels."""
STOP_TIMEOUT_S = 20.0
_SECRET = re.compile(r"\bisk_[\w-]+")
_POLL_S = 0.1
_LAST_LINES = 20


@dataclass
class OwnService:
    """A service started by this process."""

    url: str
    key: str
    data_dir: Path
    process: subprocess.Popen[bytes]

    @property
    def log(self) -> Path:
        """What the service wrote."""
        return log_path(self.data_dir)

    def stop(self) -> None:
        """End the service; kill it if it does not go by itself."""
        self.process.terminate()
        try:
            self.process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def start_service(data_dir: Path, environment: Mapping[str, str] | None = None) -> OwnService:
    """Start a service and wait until it is ready.

    Parameters
    ----------
    data_dir : Path
        A new folder: the admin key is told at the first start only.
    environment : mapping, optional
        Settings (``ISODYN_...``) beyond address and folder.

    Raises
    ------
    StartError
        It ended, told no key, or was not ready in time.
    """
    port = free_port()
    own = {"ISODYN_DATA_DIR": str(data_dir), "ISODYN_HOST": HOST, "ISODYN_PORT": str(port)}
    data_dir.mkdir(parents=True, exist_ok=True)
    with log_path(data_dir).open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "app.cli", "serve"],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(environment or {}), **own, "PYTHONUNBUFFERED": "1"},
            # its own process group: Ctrl-C is for the caller, who stops the service in order
            start_new_session=True,
        )
    service = OwnService(f"http://{HOST}:{port}", "", data_dir, process)
    try:
        _wait_until_ready(service)
    except BaseException:
        service.stop()
        raise
    return service


@contextmanager
def stopped_unless_kept(service: OwnService, *, keep: bool = False) -> Iterator[OwnService]:
    """Stop the service however the block ends, by SIGTERM too; with ``keep`` only if it ends badly."""
    before = signal.signal(signal.SIGTERM, _leave)
    kept = False
    try:
        yield service
        kept = keep
    finally:
        signal.signal(signal.SIGTERM, before)
        if not kept:
            service.stop()


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def log_path(data_dir: Path) -> Path:
    """Where a service in this folder writes its log."""
    return data_dir / "service.log"


def _wait_until_ready(service: OwnService) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    with Client(service.url, timeout=5.0, retry=RetryPolicy(retries=0)) as client:
        while time.monotonic() < deadline:
            if service.process.poll() is not None:
                raise StartError(f"the service ended with status {service.process.returncode}:\n{_tail(service.log)}")
            secret = _SECRET.search(service.log.read_text(errors="replace"))
            if secret and _is_ready(client):
                service.key = secret.group()
                return
            time.sleep(_POLL_S)
    raise StartError(f"the service was not ready after {START_TIMEOUT_S:g} s:\n{_tail(service.log)}")


def _is_ready(client: Client) -> bool:
    try:
        client.ready()
    except IsodynError:
        return False
    return True


def _tail(path: Path) -> str:
    return "\n".join(path.read_text(errors="replace").splitlines()[-_LAST_LINES:])


def _leave(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)
