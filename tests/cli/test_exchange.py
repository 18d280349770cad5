"""Files of others through the command line, against the real service."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isodyn_client import Anchor
from scipy.io import netcdf_file

from app.engine.errors import InputError
from app.evaluation.datasets.walks import path_length
from tests.cli.conftest import SAMPLE, Service, Surveyed, run
from tests.exchange.documents import esri
from tests.exchange.recordings import PLANE, WALK, csv_of, log_of


@pytest.fixture(scope="module")
def level_id(service: Service) -> str:
    """A level of an anchored venue."""
    with service.client() as client:
        anchor = Anchor(latitude_deg=PLANE.latitude_deg, longitude_deg=PLANE.longitude_deg)
        venue = client.create_venue("Hall", anchor=anchor)
        return client.create_level(venue.id, "F1", extent=(0.0, 0.0, 20.0, 15.0)).id


@pytest.mark.parametrize(("kind", "name"), [("netcdf", "map.nc"), ("geotiff", "map.zip")])
def test_a_map_goes_out_and_comes_in(
    service: Service, surveyed: Surveyed, tmp_path: Path, kind: str, name: str
) -> None:
    file = tmp_path / name
    with service.client() as client:
        current = client.level(surveyed.level_id).current_map_id
    said = service.isodyn("map", "export", surveyed.map_id, "--format", kind, "-o", file, "--licence", "CC0").stdout
    assert str(file.stat().st_size) in said
    made = service.isodyn("map", "import", surveyed.level_id, file, "--draft").stdout.strip()
    with service.client() as client:
        assert client.level(surveyed.level_id).current_map_id == current
        info = client.map_info(made)
        assert info.origin is not None
        assert (info.origin.format, info.origin.licence, info.origin.assumed) == (kind, "CC0", ())
        old, new = (client.map_field(one, "z", statistic="sd").values for one in (surveyed.map_id, made))
        assert np.array_equal(old, new, equal_nan=True)


def test_what_is_assumed_of_a_map_is_said(service: Service, level_id: str, tmp_path: Path) -> None:
    file = tmp_path / "total.asc"
    file.write_bytes(esri(np.full((8, 9), 48_000.0)))
    done = service.isodyn("map", "import", level_id, file, "--channel", "total", "--unit", "nT")
    assert done.stdout.strip().startswith("map_")
    assert "standard deviation" in done.stderr
    shown = service.isodyn("map", "show", done.stdout.strip()).stdout
    assert "esri-ascii, sha256 " in shown
    refused = run("map", "import", level_id, file, "--channel", "total", ISODYN_URL=service.url, ISODYN_KEY=service.key)
    assert refused.exit_code == 1
    assert "unit=nT" in refused.output


def test_old_ways_of_exporting_still_work(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    service.isodyn("map", "export", surveyed.map_id, tmp_path / "z.npy", "--channel", "z")
    assert np.load(tmp_path / "z.npy").ndim == 2
    assert run("map", "export", surveyed.map_id, ISODYN_URL=service.url, ISODYN_KEY=service.key).exit_code == 2


def test_netcdf_by_the_client_opens_in_scipy(service: Service, surveyed: Surveyed, tmp_path: Path) -> None:
    file = tmp_path / "map.nc"
    with service.client() as client:
        file.write_bytes(client.export_map(surveyed.map_id))
    with netcdf_file(file, "r", mmap=False) as opened:
        assert {"mean_x", "sd_x", "support"} <= set(opened.variables)


@pytest.mark.parametrize("target", ["survey.zip", "folder"])
def test_a_survey_goes_out_and_comes_in(service: Service, surveyed: Surveyed, tmp_path: Path, target: str) -> None:
    out = tmp_path / target
    service.isodyn("survey", "export", surveyed.survey_id, "-o", out)
    # into the survey it came from: everything is there already
    again = service.isodyn("survey", "import", surveyed.survey_id, out, "--format", "isodyn")
    assert again.stdout.strip() == surveyed.survey_id
    assert "0 walks uploaded, " in again.stderr
    with service.client() as client:
        assert client.survey(surveyed.survey_id).n_walks == len(list(client.walks(surveyed.survey_id)))


def imported(service: Service, level_id: str, file: Path, *options: str) -> tuple[str, str]:
    done = service.isodyn("survey", "import", level_id, file, *options)
    return done.stdout.strip(), done.stderr


@pytest.mark.parametrize("kind", ["csv", "getsensordata"])
def test_recordings_become_a_survey_once(service: Service, level_id: str, tmp_path: Path, kind: str) -> None:
    file = tmp_path / "corridor.txt"
    file.write_bytes(csv_of(plane=PLANE, factors={"mag": 1e3}) if kind == "csv" else log_of())
    options = ("--format", kind, "--name", f"of {kind}")
    dry = service.isodyn("survey", "import", level_id, file, *options, "--dry-run")
    assert "read: corridor: 17 s, 85" in dry.stdout
    assert "nothing is uploaded" in dry.stdout
    with service.client() as client:
        assert f"of {kind}" not in {one.name for one in client.surveys(level_id=level_id)}
    survey_id, said = imported(service, level_id, file, *options)
    assert "1 walks uploaded" in said
    second, said = imported(service, level_id, file, *options)
    assert second == survey_id
    assert "0 walks uploaded, 1 were there already" in said
    with service.client() as client:
        (walk,) = client.walks(survey_id)
        assert walk.name == "corridor"
        assert walk.length_m == pytest.approx(path_length(WALK.waypoints), abs=0.01)
    if kind == "csv":
        map_id = service.isodyn("map", "build", level_id, "--survey", survey_id).stdout.strip()
        assert map_id.startswith("map_")


def test_a_data_set_folder_is_read(service: Service, surveyed: Surveyed) -> None:
    survey_id, said = imported(service, surveyed.level_id, SAMPLE, "--format", "dataset", "--name", "of a folder")
    with service.client() as client:
        n = client.survey(survey_id).n_walks
    assert n > 2
    assert f"{n} walks uploaded" in said


def test_one_bad_file_does_not_stop_the_others(service: Service, level_id: str, tmp_path: Path) -> None:
    good, bad, far = tmp_path / "good.csv", tmp_path / "bad.csv", tmp_path / "far.csv"
    good.write_bytes(csv_of())
    bad.write_text("t,x,y\n1,2,3\n")
    far.write_text(csv_of().decode().replace(",2.0,3.0,", ",900.0,3.0,"))
    done = run(
        "survey", "import", level_id, bad, far, good, "--format", "csv", "--name", "mixed",
        ISODYN_URL=service.url, ISODYN_KEY=service.key,
    )  # fmt: skip
    assert done.exit_code == 1
    assert "lacks mag_x" in done.stderr
    assert "refused: " in done.stderr
    assert "1 walks uploaded" in done.stderr


def test_options_in_words() -> None:
    from app.cli.survey_files import anchor_of, pairs_of, start_of

    assert pairs_of("column", ["Mag_X=My Header"]) == {"mag_x": "My Header"}
    assert start_of("2023-11-14T22:13:20") == start_of("2023-11-14T23:13:20+01:00") == 1.7e9
    assert anchor_of("48.15,11.57").bearing_deg == 0.0
    for call, text in ((anchor_of, "48"), (anchor_of, "a,b"), (anchor_of, "148,11"), (start_of, "noon")):
        with pytest.raises(InputError, match="write it as"):
            call(text)
    with pytest.raises(InputError, match="pair"):
        pairs_of("unit", ["nT"])
