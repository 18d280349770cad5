"""``isodyn demo`` as a newcomer runs it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.slow]


def demo(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run in a folder of its own, with its temporary files there."""
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "TMPDIR": str(folder), "PYTHONPATH": f"{root}:{root / 'clients/python/src'}"}
    command = [sys.executable, "-m", "app.cli", "demo", *options]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=560, check=False
    )


def test_shows_the_whole_way_and_leaves_nothing_running(tmp_path: Path) -> None:
    done = demo(tmp_path, "--walks", "4")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "dead reckoning" in done.stdout
    assert "milliseconds per 5-s segment" in done.stdout
    plots = list((tmp_path / "demo-out").rglob("*.png"))
    assert len(plots) >= 3
    assert [path.name for path in tmp_path.iterdir()] == ["demo-out"]
    assert "isk_" not in done.stdout + done.stderr


def test_can_leave_the_service_running(tmp_path: Path) -> None:
    done = demo(tmp_path, "--walks", "3", "--keep")
    assert done.returncode == 0, done.stdout + done.stderr
    pid = int(re.search(r"kill (\d+)", done.stdout).group(1))  # type: ignore[union-attr]
    try:
        url = re.search(r"ISODYN_URL=(\S+)", done.stdout).group(1)  # type: ignore[union-attr]
        key = re.search(r"ISODYN_KEY=(\S+)", done.stdout).group(1)  # type: ignore[union-attr]
        answer = httpx.get(f"{url}/v1/stats", headers={"X-API-Key": key}, trust_env=False)
        assert answer.json()["maps"] == 1
    finally:
        os.kill(pid, signal.SIGTERM)
