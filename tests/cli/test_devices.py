"""Phones by the command line: added, followed, mended, revoked."""

from __future__ import annotations

import json
import re
from pathlib import Path

import httpx
import pytest

from app.cli.pairing import address_for_phone, is_loopback, lan_addresses, qr_code, reach_hint
from tests.cli.conftest import Service, Surveyed, run
from tests.exchange.recordings import WALK
from tests.support.phones import sensor_logger_messages


def push(url: str, body: bytes) -> httpx.Response:
    return httpx.post(url, content=body, headers={"Content-Type": "application/json"}, trust_env=False, timeout=30)


def added(service: Service, *options: str) -> tuple[str, str, str]:
    """Address, token and all that was printed."""
    out = service.isodyn("device", "add", "Ada's phone", *options).output
    return re.findall(r"^http\S+", out, re.MULTILINE)[0], re.findall(r"\bigt_\w+", out)[0], out


def test_a_phone_is_added_and_located_and_revoked(service: Service, surveyed: Surveyed) -> None:
    url, token, out = added(service, "--level", surveyed.level_id, "--start", "100,100")
    assert url.startswith(f"{service.url}/v1/ingest/sensor-logger/isi_")
    assert "Push URL" in out
    assert "▀" in out or "█" in out
    assert "a phone cannot reach the service there" in " ".join(out.split())
    for body in sensor_logger_messages(WALK.samples)[:4]:
        assert push(url, body).status_code == 200
    listed = service.isodyn("recording", "list", "--token", token).stdout
    recording, session = re.findall(r"\brec_\w+", listed)[0], re.findall(r"\bses_\w+", listed)[0]
    shown = service.isodyn("recording", "close", recording).stdout
    assert re.search(r"^state +closed$", shown, re.MULTILINE)
    assert service.isodyn("recording", "show", recording).stdout == shown
    followed = service.isodyn("follow", session).stdout.splitlines()
    with service.client() as client:
        assert len(followed) == len(client.positions(session))
    assert token in service.isodyn("device", "tokens").stdout
    assert url.rsplit("/", 1)[1] not in service.isodyn("device", "tokens").stdout
    assert "Ada's phone" in service.isodyn("device", "list").stdout
    service.isodyn("device", "revoke", token)
    assert "revoked" in service.isodyn("device", "tokens").stdout
    assert push(url, b"{}").status_code == 499


def test_phyphox_gets_its_experiment(service: Service, surveyed: Surveyed) -> None:
    url, _, out = added(service, "--level", surveyed.level_id, "--app", "phyphox", "--no-qr")
    assert url.endswith("/experiment.phyphox")
    assert "█" not in out
    assert httpx.get(url, trust_env=False).text.startswith("<")


def test_a_survey_that_waits_is_mended(service: Service, tmp_path: Path) -> None:
    with service.client() as client:
        level = client.create_level(client.create_venue("Hall").id, "0", extent=(0, 0, 20, 20))
    markers = tmp_path / "doors.csv"
    markers.write_text("name,x,y\nDoor A,2,3\nDoor B,14,11\n")
    assert service.isodyn("markers", "set", markers, level.id).stdout == "2 markers\n"
    assert service.isodyn("markers", "show", level.id).stdout == markers.read_text()
    url, token, out = added(service, "--level", level.id, "--purpose", "survey", "--build", "none", "--route", "Door A")
    assert "Annotation" in out
    for body in sensor_logger_messages(WALK.samples):
        assert push(url, body).status_code == 200
    recording = re.findall(r"\brec_\w+", service.isodyn("recording", "list", "--token", token).stdout)[0]
    assert re.search(r"^state +waiting$", service.isodyn("recording", "close", recording).stdout, re.MULTILINE)
    assert recording in service.isodyn("recording", "list", "--state", "waiting").stdout
    points = WALK.waypoints
    file = tmp_path / "passed.csv"
    rows = [f"{1000 * t:.3f},{x},{y}" for t, x, y in zip(points.t, points.x, points.y, strict=True)]
    file.write_text("\n".join(["t_ms,x,y", *rows]) + "\n")
    mended = service.isodyn("recording", "waypoints", recording, file).stdout
    assert re.search(r"^state +closed$", mended, re.MULTILINE)
    assert "wlk_" in mended


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("follow",), 2, "name one session"),
        (("follow", "ses_1", "--level", "lvl_1"), 2, "name one session"),
        (("device", "add", "x", "--start", "here"), 2, "X,Y"),
    ],
)
def test_options_that_do_not_fit_are_explained(arguments: tuple[str, ...], status: int, words: str) -> None:
    result = run(*arguments)
    assert result.exit_code == status
    assert words in " ".join(result.output.replace("│", " ").split())


def test_markers_of_a_bad_file_are_explained(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    file = tmp_path / "bad.csv"
    file.write_text("name,x\nA,1\n")
    result = run("markers", "set", file, surveyed.level_id, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert result.exit_code == 1
    assert "lacks y" in result.output


def test_addresses_for_phones() -> None:
    told = "http://inner:8080/v1/ingest/sensor-logger/isi_1"
    assert address_for_phone(told, "https://maps.example/isodyn/") == (
        "https://maps.example/isodyn/v1/ingest/sensor-logger/isi_1"
    )
    assert all(is_loopback(f"http://{host}:1") for host in ("127.0.0.1", "[::1]", "localhost"))
    assert not any(is_loopback(f"http://{host}:1") for host in ("10.0.0.7", "localhost.example"))
    hint = reach_hint("http://127.0.0.1:8080")
    assert all(f"http://{address}:8080" in hint for address in lan_addresses())
    assert "--host 0.0.0.0" in hint
    assert reach_hint("http://10.0.0.7:8080") == ""
    assert len(qr_code(told).splitlines()) > 15


def test_a_short_bench_of_phones(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    out = tmp_path / "live.json"
    service.isodyn(
        "bench", "live", "--phones", "2", "--seconds", "6", "--level", surveyed.level_id, "--url", service.url,
        "--json", out,
    )  # fmt: skip
    report = json.loads(out.read_text())
    assert report["errors"] == {}
    assert report["messages"] >= 10
    assert report["measured"] >= 6
    assert 0 < report["answer_ms"]["p50"] <= report["latency_ms"]["p50"]
    assert report["cpu"] is None
