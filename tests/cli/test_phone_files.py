"""Recordings of phones through the command line, against the real service."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from isodyn_client import Anchor

from app.engine.types import ImuSamples
from app.evaluation.datasets.ilc20 import Ilc20Level
from app.evaluation.datasets.walks import path_length
from tests.cli.conftest import SAMPLE, Service, Surveyed, run
from tests.exchange.recordings import PLANE, WALK, log_of
from tests.support.phones import Phone, phyphox_zip, sensor_logger_zip

RECORDED = Ilc20Level("site1-F2", SAMPLE).walks("train")[0]


@pytest.fixture(scope="module")
def level_id(service: Service) -> str:
    """A level of an anchored venue."""
    with service.client() as client:
        anchor = Anchor(latitude_deg=PLANE.latitude_deg, longitude_deg=PLANE.longitude_deg)
        venue = client.create_venue("Hall of phones", anchor=anchor)
        return client.create_level(venue.id, "F1", extent=(0.0, 0.0, 20.0, 15.0)).id


def test_annotations_become_waypoints(service: Service, level_id: str, tmp_path: Path) -> None:
    file = tmp_path / "recording.zip"
    file.write_bytes(sensor_logger_zip(WALK.samples, WALK.waypoints, phone=Phone(ios=True)))
    options = ("--format", "sensor-logger", "--name", "of a phone")
    dry = service.isodyn("survey", "import", level_id, file, *options, "--dry-run").stdout
    assert "signs as ios" in dry
    assert "left out: what a position does not need: Battery.csv" in dry
    done = service.isodyn("survey", "import", level_id, file, *options)
    with service.client() as client:
        (walk,) = client.walks(done.stdout.strip())
    assert walk.name == "recording"
    assert walk.n_samples == len(WALK.samples)
    assert walk.length_m == pytest.approx(path_length(WALK.waypoints), abs=0.01)
    again = service.isodyn("survey", "import", level_id, file, *options)
    assert "0 walks uploaded, 1 were there already" in again.stderr


def test_annotations_may_name_markers(service: Service, level_id: str, tmp_path: Path) -> None:
    file, markers = tmp_path / "recording.zip", tmp_path / "doors.csv"
    points = WALK.waypoints
    names = [f"Door {k}" for k in range(len(points))]
    content = sensor_logger_zip(WALK.samples, points, labels=[name.upper() for name in names[:-1]] + ["lunch"])
    file.write_bytes(content)
    rows = [f"{name},{x},{y}" for name, x, y in zip(names, points.x, points.y, strict=True)]
    markers.write_text("\n".join(["name,x,y", *rows]) + "\n")
    options = ("--format", "sensor-logger", "--name", "by doors", "--dry-run")
    said = service.isodyn("survey", "import", level_id, file, *options, "--markers", markers).stdout
    assert f"{len(points) - 1} positions" in said
    assert "neither x,y nor a marker: 'lunch'" in said
    without = service.isodyn("survey", "import", level_id, file, *options).stdout
    assert "0 positions" in without


def test_a_phone_tells_android_or_ios(service: Service, level_id: str, tmp_path: Path) -> None:
    file = tmp_path / "recording.zip"
    file.write_bytes(phyphox_zip(WALK.samples))
    wrong = run(
        "survey", "import", level_id, file, "--format", "phyphox", "--frame", "frd",
        ISODYN_URL=service.url, ISODYN_KEY=service.key,
    )  # fmt: skip
    assert wrong.exit_code == 2


def recorded(kind: str) -> bytes:
    """A recorded walk as a phone would have written it."""
    if kind == "phyphox":
        return phyphox_zip(RECORDED.samples, ios=True)
    return sensor_logger_zip(RECORDED.samples, RECORDED.waypoints, phone=Phone(asynchronous=True))


@pytest.mark.parametrize("kind", ["sensor-logger", "phyphox"])
def test_a_recording_is_located(service: Service, surveyed: Surveyed, tmp_path: Path, kind: str) -> None:
    file, output = tmp_path / "recording.zip", tmp_path / "fixes.json"
    file.write_bytes(recorded(kind))
    points = RECORDED.waypoints
    done = service.isodyn(
        "session", "import", file, "--level", surveyed.level_id, "--x", str(points.x[0]), "--y", str(points.y[0]),
        "--json", output,
    )  # fmt: skip
    assert "signs as" in done.stderr
    fixes = json.loads(output.read_text())
    assert len(fixes["x"]) > 20
    assert done.stdout.count(surveyed.level_id) == len(fixes["x"])
    t = np.array(fixes["t_ms"]) / 1000.0
    truth = np.stack([np.interp(t, points.t, points.x), np.interp(t, points.t, points.y)])
    error = np.hypot(*(np.array([fixes["x"], fixes["y"]]) - truth))
    assert np.median(error) < 4.0
    session_id = next(line for line in done.stderr.splitlines() if line.startswith("ses_"))
    with service.client() as client:
        assert client.session_info(session_id).status == "closed"


def test_a_log_without_positions_is_located(service: Service, level_id: str, tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    file.write_bytes(b"\n".join(line for line in log_of().splitlines() if not line.startswith(b"POSI")))
    dry = service.isodyn("session", "import", file, "--level", level_id, "--dry-run", "--radio").stdout
    assert "segments; nothing is sent" in dry
    assert "read: log.txt: 17 s" in dry


def test_gaps_begin_new_segments(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    samples = RECORDED.samples
    t = samples.t + np.where(np.arange(len(samples)) >= 300, 7.0, 0.0)
    file = tmp_path / "gap.zip"
    file.write_bytes(sensor_logger_zip(ImuSamples(t, samples.mag, samples.acc, samples.gyro)))
    done = service.isodyn("session", "import", file, "--level", surveyed.level_id)
    assert "1 gaps of more than 1 s" in done.stderr


def test_what_is_missing_is_said(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    file = tmp_path / "recording.json"
    file.write_text('[{"sensor": "Gravity", "time": "1698501144401773000", "x": "0", "y": "0", "z": "9.8"}]')
    done = run("session", "import", file, "--level", surveyed.level_id, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert done.exit_code == 1
    assert "no readings of magnetometer, gyroscope, accelerometer" in done.stderr
    for options in ((), ("--level", "a", "--venue", "b"), ("--level", "a", "--x", "1")):
        assert run("session", "import", file, *options).exit_code == 2
