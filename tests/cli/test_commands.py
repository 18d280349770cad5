"""Commands against a real service: what they print, what they change, how they fail."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.cli.conftest import SAMPLE, SURVEY_WALKS, Service, Surveyed, run


def test_a_folder_becomes_a_level_with_its_plans(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        level = client.level(surveyed.level_id)
        venue = client.venue(level.venue_id)
        assert client.plan_image(level.id).startswith(b"\x89PNG")
        assert json.loads(client.vector_plan(level.id))["type"] == "FeatureCollection"
    floor = json.loads((SAMPLE / "floor.json").read_text())
    assert (venue.name, level.name, level.ordinal) == ("site1", "F2", 1)
    assert (level.extent.x_max, level.extent.y_max) == (floor["width_m"], floor["height_m"])
    assert level.current_map_id == surveyed.map_id


def test_options_make_a_level_too(service: Service, tmp_path: Path) -> None:
    plan = tmp_path / "plan.png"
    Image.new("RGB", (8, 4)).save(plan)
    extent = ("--extent", "0", "-1", "20", "9.5")
    made = service.isodyn(
        "survey", "level", "--venue", "Hall", "--name", "EG", "--ordinal", "-1", *extent, "--plan", plan
    )
    with service.client() as client:
        level = client.level(made.stdout.strip())
        again = service.isodyn("survey", "level", "--venue", level.venue_id, "--name", "OG", *extent).stdout.strip()
        assert client.level(again).venue_id == level.venue_id
    assert (level.ordinal, level.extent.y_min, level.has_plan_image) == (-1, -1.0, True)


def test_a_level_needs_something(service: Service) -> None:
    result = run("survey", "level", "--venue", "Hall")
    assert result.exit_code == 2
    assert "--extent" in result.output


def test_uploads_only_the_walks_named(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        walks = list(client.walks(surveyed.survey_id))
    assert walks
    assert all(walk.name.startswith(SURVEY_WALKS) for walk in walks)


def test_lists_show_ids_whole(service: Service, surveyed: Surveyed) -> None:
    assert surveyed.survey_id in service.isodyn("survey", "list").stdout
    levels = service.isodyn("survey", "levels").stdout
    assert surveyed.level_id in levels
    assert surveyed.map_id in levels
    assert surveyed.level_id in service.isodyn("survey", "levels", "--name", "site1 f2").stdout
    assert "no levels yet" in service.isodyn("survey", "levels", "--near", "-80.0,12.5", "--radius", "10").stdout
    assert run("survey", "levels", "--near", "here").exit_code == 2
    assert surveyed.map_id in service.isodyn("map", "list", "--level", surveyed.level_id).stdout
    assert surveyed.map_id in service.isodyn("map", "show", surveyed.map_id).stdout


def test_quality_is_shown_and_drawn(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    shown = service.isodyn("map", "quality", surveyed.map_id, "--out", tmp_path / "error.png").stdout
    assert "of the floor plan" in shown
    with Image.open(tmp_path / "error.png") as image:
        assert image.width > 10
    heading = ("--layer", "along", "--heading", "90")
    service.isodyn("map", "quality", surveyed.map_id, "--out", tmp_path / "along.npy", *heading)
    assert np.nanmin(np.load(tmp_path / "along.npy")) > 0


def test_lines_to_walk_and_what_to_expect_there(service: Service, surveyed: Surveyed) -> None:
    lines = service.isodyn("map", "suggest", surveyed.map_id, "--count", "2").stdout.splitlines()
    assert len(lines) == 4
    assert "not mapped yet" in lines[2]
    route = ("--route", "-5,60 100,60 130.5,75")
    told = service.isodyn("map", "forecast", surveyed.map_id, *route, "--known", "1").stdout
    assert "139 m" in told
    assert "not mapped: only dead reckoning" in told


@pytest.mark.parametrize("route", ["12", "1,2", "1,2 3,x", "1,2,3 4,5"])
def test_a_route_is_corners(route: str) -> None:
    result = run("map", "forecast", "map_1", "--route", route, ISODYN_URL="http://127.0.0.1:9")
    assert result.exit_code == 2
    assert "--route" in result.output


def test_maps_are_exported(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    for name in ("field.png", "field.npy"):
        service.isodyn("map", "export", surveyed.map_id, tmp_path / name, "--channel", "z")
    values = np.load(tmp_path / "field.npy")
    with service.client() as client:
        info = client.map_info(surveyed.map_id)
    assert values.shape == (info.rows, info.columns)
    assert np.isfinite(values).mean() == pytest.approx(info.mapped_share, abs=0.05)
    with Image.open(tmp_path / "field.png") as image:
        assert image.size[0] / image.size[1] == pytest.approx(info.columns / info.rows, rel=0.05)


def test_an_unknown_file_type_is_refused_before_anything_is_asked(tmp_path: Path) -> None:
    result = run("map", "export", "map_1", tmp_path / "field.tiff", ISODYN_URL="http://127.0.0.1:9")
    assert result.exit_code == 1
    assert ".npy" in result.output


def write_samples(folder: Path, seconds: float = 12.0) -> tuple[Path, Path, float, float]:
    """The beginning of a survey walk as .csv and .json, and where it began."""
    from app.cli.convert import samples_of
    from app.evaluation.datasets.ilc20 import Ilc20Level

    walk = next(w for w in Ilc20Level("site1-F2", SAMPLE).walks("train") if w.walk_id.startswith(SURVEY_WALKS))
    samples = next(iter(samples_of(walk.samples).split(seconds)))
    table = np.column_stack([samples.t_ms, samples.mag, samples.acc, samples.gyro])
    csv = folder / "walk.csv"
    header = "t_ms,mx,my,mz,ax,ay,az,gx,gy,gz"
    np.savetxt(csv, table, delimiter=",", header=header, comments="", fmt="%.6f")
    columns = {
        name: dict(zip("xyz", getattr(samples, name).T.tolist(), strict=True)) for name in ("mag", "acc", "gyro")
    }
    body = folder / "walk.json"
    body.write_text(json.dumps({"frame": "android", "samples": {"t_ms": samples.t_ms.tolist(), **columns}}))
    return csv, body, float(walk.waypoints.x[0]), float(walk.waypoints.y[0])


def test_locates_samples_of_a_file(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    csv, body, x, y = write_samples(tmp_path)
    start = ("--x", str(x), "--y", str(y))
    answers = []
    for file in (csv, body):
        out = tmp_path / f"{file.suffix[1:]}-fixes.json"
        result = service.isodyn("locate", file, "--level", surveyed.level_id, *start, "--json", out)
        assert "95 % ellipse" in result.stdout
        answers.append(json.loads(out.read_text()))
    assert len(answers[0]["x"]) == len(answers[0]["status"]) > 5
    assert answers[0]["t_ms"] == answers[1]["t_ms"]
    assert abs(answers[0]["x"][0] - x) < 10


def test_aids_in_a_file_are_sent(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    _, body, x, y = write_samples(tmp_path)
    content = json.loads(body.read_text())
    call = ("locate", body, "--level", surveyed.level_id, "--x", str(x), "--y", str(y))
    content["pressure"] = {"t_ms": content["samples"]["t_ms"][:2], "hpa": [1003.5, 1003.25]}
    content["ble"] = {"t_ms": content["samples"]["t_ms"][:1], "address": ["c0:ff:ee:00:00:01"], "rssi": [-70]}
    body.write_text(json.dumps(content))
    assert "95 % ellipse" in service.isodyn(*call).stdout
    content["pressure"]["hpa"] = [100350.0, 100325.0]
    body.write_text(json.dumps(content))
    refused = run(*call, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert refused.exit_code == 1
    assert "looks like Pa" in refused.output.replace("\n", " ")
    content["pressure"] = {"hpa": [1003.5]}
    body.write_text(json.dumps(content))
    assert "not in the expected form" in run(*call).output.replace("\n", " ")


@pytest.mark.parametrize("content", ["t_ms,mx\n1,2\n", "", "t_ms,mx,my,mz,ax,ay,az,gx,gy,gz\n1,2,3,4,5,6,7,8,9,ten\n"])
def test_a_broken_file_is_named(tmp_path: Path, content: str) -> None:
    file = tmp_path / "walk.csv"
    file.write_text(content)
    result = run("locate", file, "--level", "lvl_1")
    assert result.exit_code == 1
    assert "walk.csv: is not in the expected form" in result.output.replace("\n", "")


def test_replays_walks_and_prints_their_errors(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    plots = tmp_path / "plots"
    result = service.isodyn("replay", SAMPLE, "--level", surveyed.level_id, "--walk", "5dda524f", "--plots", plots)
    assert "dr p50" in result.stdout
    assert "all 1 walks" in result.stdout
    assert len(list(plots.rglob("*.png"))) == 2
    with service.client() as client:
        newest = [next(sessions) for sessions in [client.sessions(level_id=surveyed.level_id)] for _ in range(2)]
    assert {session.method for session in newest} == {"particle", "dead_reckoning"}
    assert {session.status for session in newest} == {"closed"}


def test_evaluates_through_a_running_service(service: Service, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    service.isodyn(
        "evaluate", "ilc20", "--data", "maps/samples", "--through", "http", "--limit", "3", "--json", report,
        "--url", service.url, "--key", service.key,
    )  # fmt: skip
    content = json.loads(report.read_text())
    assert (content["set"], content["scenario"], content["through"]) == ("ilc20", "tracking", "http")
    assert content["overall"]["all"]["n_walks"] + len(content["dropped"]) == 3
    assert content["walks"][0]["failures"] == []


def test_evaluates_a_building_and_draws_the_reports(service: Service, tmp_path: Path) -> None:
    report, picture = tmp_path / "report.json", tmp_path / "errors.png"
    service.isodyn(
        "evaluate", "ilc20", "--data", "maps/samples", "--scenario", "venue", "--aids", "wifi", "--through", "http",
        "--limit", "2", "--json", report, "--url", service.url, "--key", service.key,
    )  # fmt: skip
    content = json.loads(report.read_text())
    assert (content["scenario"], content["aids"], content["levels"].keys()) == ("venue", "wifi", {"site1-F2"})
    assert content["confidence"]["all"]["level_hit_rate"] == 1.0  # the building of the sample has one level
    with service.client() as client:
        newest = next(iter(client.sessions()))
        assert (newest.level_id, len(newest.maps)) == (None, 1)
    assert run("evaluate", "plot", str(report), "--out", str(picture)).exit_code == 0
    assert picture.stat().st_size > 5000


def test_a_file_that_is_no_report_is_named(tmp_path: Path) -> None:
    file = tmp_path / "other.json"
    for content, said in (("[1]", "is not a report"), ("{", "is not a report"), ('{"set": "x"}', "lacks aids")):
        file.write_text(content)
        result = run("evaluate", "plot", str(file))
        assert result.exit_code == 1
        assert said in result.output.replace("\n", "")


def test_keys_are_made_listed_and_revoked(service: Service) -> None:
    secret = service.isodyn("keys", "create", "a phone", "--scope", "locate").stdout.strip()
    assert secret.startswith("isk_")
    listed = service.isodyn("keys", "list").stdout
    assert "a phone" in listed
    assert secret not in listed
    refused = run("survey", "level", SAMPLE, ISODYN_URL=service.url, ISODYN_KEY=secret)
    assert refused.exit_code == 1
    assert "survey" in refused.output
    key_id = next(line.split()[0] for line in listed.splitlines() if "a phone" in line)
    service.isodyn("keys", "revoke", key_id)
    assert run("survey", "levels", ISODYN_URL=service.url, ISODYN_KEY=secret).exit_code == 1


def test_a_local_key_opens_a_running_service(service: Service) -> None:
    made = run("keys", "create", "rescue", "--scope", "admin", "--local", "--data-dir", service.data_dir)
    assert run("keys", "list", ISODYN_URL=service.url, ISODYN_KEY=made.stdout.strip()).exit_code == 0


def test_no_service_no_traceback() -> None:
    result = run("survey", "levels", ISODYN_URL="http://127.0.0.1:9")
    assert result.exit_code == 1
    assert "isodyn serve" in result.output
    assert "Traceback" not in result.output


def test_a_wrong_key_is_explained(service: Service) -> None:
    result = run("survey", "levels", ISODYN_URL=service.url, ISODYN_KEY="isk_wrong")
    assert result.exit_code == 1
    assert "ISODYN_KEY" in result.output


def test_a_refusal_names_field_and_remedy(service: Service) -> None:
    extent = ("--extent", "0", "0", "-5", "10")
    result = run(
        "survey", "level", "--venue", "V", "--name", "L", *extent, ISODYN_URL=service.url, ISODYN_KEY=service.key
    )
    assert result.exit_code == 1
    assert "extent" in result.output
    assert "x_min < x_max" in result.output


def test_ground_truth_from_a_file(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    with service.client() as client:
        session = client.create_session(surveyed.level_id)
    file = tmp_path / "marks.csv"
    file.write_text("x,t_ms,y,sd_m\n1.5,1790000000000,2,\n3,1790000001000,4,0.3\n")
    shown = service.isodyn("session", "truth", session.id, file)
    assert shown.output.count("not yet") == 2
    with service.client() as client:
        assert [(point.x, point.sd_m) for point in client.ground_truth(session.id)] == [(1.5, 0.0), (3.0, 0.3)]


@pytest.mark.parametrize(
    ("text", "said"),
    [("a,b\n1,2\n", "no column t_ms, x, y"), ("t_ms,x,y\n", "holds no points"), ("t_ms,x,y\n1,2,up\n", "line 2")],
)
def test_a_file_of_ground_truth_that_is_none(service: Service, tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "marks.csv"
    file.write_text(text)
    shown = run("session", "truth", "ses_0", file, ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert shown.exit_code == 1
    assert said in shown.output
