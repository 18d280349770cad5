"""The reader, on the committed sample and on folders with faults."""

from __future__ import annotations

import doctest
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import app.evaluation.datasets.ilc20 as reader
from app.engine.types import ImuSamples, Waypoints
from app.evaluation.datasets.ilc20 import Ilc20Level, open_ilc20
from app.evaluation.errors import DataSetError
from tests.evaluation.fakes import START_MS, straight_walk, write_level

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "maps" / "samples"


@pytest.fixture(scope="module")
def sample() -> Ilc20Level:
    return open_ilc20(SAMPLES).level("site1-F2")


def test_the_sample_holds_the_split_of_its_source(sample: Ilc20Level) -> None:
    assert (len(sample.walks("train")), len(sample.walks("test")), len(sample.walks())) == (84, 18, 102)
    assert sum(walk.path_length_m for walk in sample.walks()) == pytest.approx(3773, abs=1)
    assert (sample.site, sample.floor, sample.ordinal) == ("site1", "F2", 1)


def test_units_frames_and_time_of_the_sample(sample: Ilc20Level) -> None:
    for walk in sample.walks():
        samples = walk.samples
        assert np.all(np.diff(samples.t) > 0)
        assert 1.57e9 < samples.t[0] < 1.58e9  # November 2019, UTC seconds
        assert 9.3 < np.mean(np.linalg.norm(samples.acc, axis=1)) < 10.8
        assert 15.0 < np.median(np.linalg.norm(samples.mag, axis=1)) < 120.0
        assert np.median(samples.acc[:, 2]) > 7.0  # held flat: gravity on +z
        assert np.max(np.abs(samples.gyro)) < 20.0
        assert samples.mag.dtype == np.float64


def test_labels_lie_on_the_plan_and_near_the_samples(sample: Ilc20Level) -> None:
    x_min, y_min, x_max, y_max = sample.extent
    for walk in sample.walks():
        labels = walk.waypoints
        assert len(labels) >= 2
        assert np.all(np.diff(labels.t) > 0)
        assert np.all((labels.x >= x_min) & (labels.x <= x_max) & (labels.y >= y_min) & (labels.y <= y_max))
        assert abs(labels.t[0] - walk.samples.t[0]) < 2.0
        assert walk.device == "OPPO PBCM10"


def test_wifi_of_the_sample_is_fresh_and_in_order_of_report(sample: Ilc20Level) -> None:
    logs = [walk.wifi_log for walk in sample.walks() if walk.wifi_log]
    assert len(logs) > 90
    for log in logs:
        age = log.reported_t - log.scans.t
        assert np.all((age > -1e-6) & (age < 3.0005))
        assert np.all(np.diff(log.reported_t) >= 0)
        assert len(log.scans.address) == len(log.scans.t) == len(log.scans.rssi)
        assert np.all((log.scans.rssi < 0) & (log.scans.rssi > -120))


def test_survey_walk_carries_samples_labels_and_wifi(sample: Ilc20Level) -> None:
    walk = sample.walks("train")[0]
    survey = walk.survey_walk()
    assert (survey.walk_id, survey.samples, survey.waypoints) == (walk.walk_id, walk.samples, walk.waypoints)
    assert survey.wifi is walk.wifi is not None


def test_plans_of_the_sample(sample: Ilc20Level) -> None:
    assert sample.plan_png_path == SAMPLES / "ilc20" / "site1-F2" / "floor_image.png"
    plan = sample.vector_plan
    assert plan is not None
    text = json.dumps(plan)
    assert plan["type"] == "FeatureCollection"
    assert len(plan["features"]) == 139
    assert "120.07" not in text  # no longitudes left
    assert [feature["properties"]["role"] for feature in plan["features"]].count("floor") == 1


def test_the_folder_itself_may_be_given() -> None:
    assert open_ilc20(SAMPLES / "ilc20").levels() == open_ilc20(SAMPLES).levels() == ("site1-F2",)


def test_docstring_example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert doctest.testmod(reader).failed == 0


def test_round_trip_of_a_written_level(tmp_path: Path) -> None:
    walks = [straight_walk("a", split="train"), straight_walk("b", duration_s=12.0)]
    write_level(tmp_path / "ilc20" / "x-B2", walks)
    level = open_ilc20(tmp_path).level("x-B2")
    assert (level.plan_png_path, level.vector_plan, level.extent) == (None, None, (0.0, 0.0, 60.0, 40.0))
    assert level.ordinal == -2
    for read, wrote in zip(level.walks(), walks, strict=True):
        np.testing.assert_allclose(read.samples.t, wrote.samples.t, atol=6e-4)
        np.testing.assert_array_equal(read.samples.acc, wrote.samples.acc.astype(np.float32))
        np.testing.assert_allclose(read.waypoints.x, wrote.waypoints.x)
        assert (read.wifi, read.device, read.split) == (None, "", wrote.split)
        assert read.path_length_m == pytest.approx(wrote.path_length_m)


def test_rows_that_cannot_be_used_are_left_out(tmp_path: Path) -> None:
    walk = straight_walk("a", duration_s=3.0)
    t = walk.samples.t.copy()
    t[10] = t[9]  # a repeated stamp
    mag = walk.samples.mag.copy()
    mag[20, 1] = np.nan
    labels = Waypoints(np.append(walk.waypoints.t, walk.waypoints.t[-1] + 1), np.array([0.0, 1.0, np.nan]), np.zeros(3))
    bad = replace(walk, samples=ImuSamples(t, mag, walk.samples.acc, walk.samples.gyro), waypoints=labels)
    lonely = replace(walk, walk_id="b", waypoints=Waypoints(labels.t[:1], labels.x[:1], labels.y[:1]))
    write_level(tmp_path / "x-F1", [bad, lonely])
    (read,) = open_ilc20(tmp_path).level("x-F1").walks()  # one label is neither truth nor survey
    assert len(read.samples) == len(walk.samples) - 2
    assert np.all(np.isfinite(read.samples.mag))
    assert len(read.waypoints) == 2


def test_wifi_is_dated_and_given_out_when_it_was_reported(tmp_path: Path) -> None:
    scans = {"a": [(2000, "n2", -60, 1500), (2000, "old", -50, 9000), (1000, "n1", -70, 100), (4000, "n3", -40, 0)]}
    write_level(tmp_path / "x-F1", [straight_walk("a"), straight_walk("b")], wifi=scans)
    first, second = open_ilc20(tmp_path).level("x-F1").walks()
    assert second.wifi is None
    log = first.wifi_log
    assert log is not None
    assert log.scans.address == ("n1", "n2", "n3")
    start = START_MS / 1000
    np.testing.assert_allclose(log.scans.t - start, [1.0, 2.0, 4.0], atol=1e-3)
    heard = log.between(start + 1.0, start + 2.0)
    assert heard is not None
    assert heard.address == ("n2",)
    assert log.between(start + 2.0, start + 3.9) is None


def test_an_entry_reported_again_counts_once(tmp_path: Path) -> None:
    again = [(1000, "n1", -70, 100), (2900, "n1", -70, 2001), (2900, "n2", -60, 2000), (4800, "n1", -71, 300)]
    write_level(tmp_path / "x-F1", [straight_walk("a"), straight_walk("b")], wifi={"a": again, "b": again[1:2]})
    first, second = open_ilc20(tmp_path).level("x-F1").walks()
    assert first.wifi is not None
    assert first.wifi.address == ("n1", "n2", "n1")
    np.testing.assert_allclose(first.wifi.t - START_MS / 1000, [1.0, 2.9, 4.8], atol=1e-3)
    assert second.wifi is not None
    assert second.wifi.address == ("n1",)  # another walk's entry is no repetition


def test_beacons_are_heard_when_they_are_reported(tmp_path: Path) -> None:
    heard = {"b": [(2000, "c0:02", -80), (1000, "c0:01", -70), (3000, "c0:01", 0)]}
    write_level(tmp_path / "x-F1", [straight_walk("a"), straight_walk("b")], ble=heard)
    first, second = open_ilc20(tmp_path).level("x-F1").walks()
    assert first.ble is None
    log = second.ble_log
    assert log is not None
    assert log.scans.address == ("c0:01", "c0:02")  # 0 dBm is no reading
    np.testing.assert_allclose(log.scans.t - START_MS / 1000, [1.0, 2.0], atol=1e-3)
    np.testing.assert_array_equal(log.reported_t, log.scans.t)
    assert second.survey_walk().ble is second.ble


def test_faulty_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataSetError, match=r"holds no ilc20"):
        open_ilc20(tmp_path)
    folder = tmp_path / "x-F1"
    write_level(folder, [straight_walk()])
    with pytest.raises(DataSetError, match=r"no level 'y'; found: x-F1"):
        open_ilc20(tmp_path).level("y")
    imu = pq.read_table(folder / "imu.parquet")
    pq.write_table(imu.drop_columns(["gz"]), folder / "imu.parquet")
    with pytest.raises(DataSetError, match=r"imu.parquet: lacks the columns gz"):
        open_ilc20(tmp_path).level("x-F1").walks()
    pq.write_table(imu.slice(0, 10), folder / "imu.parquet")
    with pytest.raises(DataSetError, match=r"trace w ends behind the last row"):
        open_ilc20(tmp_path).level("x-F1").walks()
    (folder / "imu.parquet").write_bytes(b"PAR1 not really")
    with pytest.raises(DataSetError, match=r"imu.parquet: cannot be read"):
        open_ilc20(tmp_path).level("x-F1").walks()
    (folder / "floor.json").write_text('{"width_m": 3}')
    with pytest.raises(DataSetError, match="height_m"):
        _ = open_ilc20(tmp_path).level("x-F1").extent


def test_a_dictionary_column_over_several_row_groups_reads_like_a_plain_one(tmp_path: Path) -> None:
    scans = {name: [(1000 * i, f"ap{i}", -60, 10) for i in range(5)] for name in "ab"}
    write_level(tmp_path / "x-F1", [straight_walk("a"), straight_walk("b")], wifi=scans)
    plain = open_ilc20(tmp_path).level("x-F1").walks()
    path = tmp_path / "x-F1" / "wifi.parquet"
    table = pq.read_table(path)
    coded = table.set_column(2, "bssid", table["bssid"].dictionary_encode())
    coded = coded.set_column(0, "trace_id", coded["trace_id"].dictionary_encode())
    assert pa.types.is_dictionary(coded.schema.field("bssid").type)
    pq.write_table(coded, path, row_group_size=3)
    again = open_ilc20(tmp_path).level("x-F1").walks()
    assert [w.wifi.address for w in again if w.wifi] == [w.wifi.address for w in plain if w.wifi] != []


@pytest.mark.parametrize(
    ("name", "ordinal"), [("s-B1", -1), ("s-B2", -2), ("s-F1", 0), ("s-F8", 7), ("s-L3", 2), ("s-roof", 0), ("F2", 1)]
)
def test_ordinal_of_a_storey(name: str, ordinal: int) -> None:
    assert Ilc20Level(name, Path("unused")).ordinal == ordinal
