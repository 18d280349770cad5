"""A service of one's own."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from app.cli.errors import StartError
from app.cli.process import free_port, start_service, stopped_unless_kept
from tests.cli.conftest import Service, run

pytestmark = pytest.mark.e2e


def test_a_service_that_does_not_come_up_tells_why(tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"(?i)workers"):
        start_service(tmp_path / "data", {"ISODYN_WORKERS": "none"})


def test_starts_tells_its_key_and_stops_when_something_goes_wrong(tmp_path: Path) -> None:
    service = start_service(tmp_path / "data", {"ISODYN_POOL": "threads", "ISODYN_WORKERS": "1"})

    def use() -> None:
        with stopped_unless_kept(service, keep=True):
            answer = httpx.get(f"{service.url}/v1/stats", headers={"X-API-Key": service.key}, trust_env=False)
            assert answer.json()["venues"] == 0
            raise RuntimeError("on the way")

    with pytest.raises(RuntimeError, match="on the way"):
        use()
    assert service.process.poll() is not None


def test_a_taken_port_is_told_at_once(tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        result = run("serve", "--port", str(port), "--data-dir", tmp_path / "data")
    assert result.exit_code == 1
    assert f"port {port}" in result.output
    assert not (tmp_path / "data").exists()


def test_a_folder_serves_one_service_only(service: Service) -> None:
    result = run("serve", "--port", str(free_port()), "--data-dir", service.data_dir)
    assert result.exit_code == 1
    assert "another service" in result.output


def test_settings_that_do_not_fit_are_named() -> None:
    result = run("serve", "--workers", "0")
    assert result.exit_code == 1
    assert "ISODYN_WORKERS" in result.output


def test_free_ports_are_free() -> None:
    assert 1024 <= free_port() <= 65535
