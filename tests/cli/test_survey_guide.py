"""``isodyn survey start`` and ``watch``: a level from a picture, a phone that walks it, a map that grows."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
import pytest
from PIL import Image

from tests.cli.conftest import Service, run
from tests.e2e.synthetic import walk
from tests.support.phones import Phone, sensor_logger_messages

CORNERS = {"A": (2.0, 2.0), "B": (22.0, 2.0), "C": (22.0, 10.0), "D": (2.0, 10.0)}


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.png"
    Image.new("RGB", (480, 240), "white").save(path)
    return path


def test_a_survey_is_begun_walked_and_watched(service: Service, plan: Path, tmp_path: Path) -> None:
    markers = tmp_path / "doors.csv"
    markers.write_text("name,x,y\n" + "".join(f"{name},{x},{y}\n" for name, (x, y) in CORNERS.items()))
    said = service.isodyn(
        "survey", "start", "--plan", plan, "--scale", "0.05", "--venue", "Guided", "--level", "0",
        "--markers", markers, "--no-qr",
    ).output  # fmt: skip
    level_id = re.findall(r"level (lvl_\w+): 24 x 12 m, 4 markers", said)[0]
    address = re.findall(r"^http\S+$", said, flags=re.MULTILINE)[0]
    assert f"isodyn survey watch {level_id}" in said
    assert "no map yet" in service.isodyn("survey", "watch", level_id, "--once").output
    names = "ABCDA"
    recorded = walk([CORNERS[name] for name in names], t0=1.76e9, seed=5)
    phone = Phone(session_id="guided")
    with service.client() as client:
        for body in sensor_logger_messages(recorded.samples, recorded.waypoints, phone=phone, labels=names):
            answer = httpx.post(address, content=body, headers={"Content-Type": "application/json"}, trust_env=False)
            assert answer.status_code == 200, answer.text
        shown = service.isodyn("survey", "watch", level_id, "--once").output
        (recording,) = [one for one in client.recordings(purpose="survey") if one.level_id == level_id]
        assert f"recording {recording.id} open" in shown
        client.close_recording(recording.id)
        client.wait_for_job(next(iter(client.jobs(kind="build_map"))).id)
    shown = service.isodyn("survey", "watch", level_id, "--once").output
    assert f"recording {recording.id} closed" in shown
    assert "5 annotations, 1 walks" in shown
    area = float(re.findall(r"version 1: 1 walks, (\d+) m2 mapped", shown)[0])
    length = 2 * (20.0 + 8.0)
    assert 0.6 * 3.0 * length < area < 1.5 * 3.0 * length
    assert "walk next" in shown


@pytest.mark.parametrize("options", [(), ("--scale", "0.05", "--width", "24")])
def test_one_measure_of_the_picture_is_needed(plan: Path, options: tuple[str, ...]) -> None:
    result = run("survey", "start", "--plan", plan, "--venue", "V", "--level", "0", *options)
    assert result.exit_code == 2
    assert "--scale" in result.output


def test_a_picture_is_a_png(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "plan.png"
    path.write_bytes(b"GIF89a" + bytes(100))
    result = run("survey", "start", "--plan", path, "--width", "20", "--venue", "V", "--level", "0")
    assert result.exit_code == 1
    assert "is not a PNG picture" in result.output
