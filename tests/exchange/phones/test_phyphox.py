"""phyphox: what our experiment sends, the experiment itself, and exports."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from app.engine.types import ImuSamples, Status
from app.exchange.phones import FormatError, PhoneFrame, Readings, Sensor, assemble
from app.exchange.phones.phyphox import COLUMNS, read_body
from app.exchange.phones.phyphox_experiment import REFUSED, STATUS_CODES, WAITING, answer, experiment
from app.exchange.phones.phyphox_files import read_export
from tests.exchange.recordings import WALK
from tests.support.phones import PAUSE_S, phyphox_bodies, phyphox_zip

NOW = 1_700_000_000_000_000_000
URL = "https://maps.example/v1/ingest/phyphox/tok?a=1&b=2"


def samples_of(readings: Readings, frame: PhoneFrame) -> ImuSamples:
    part = assemble(readings, frame, final=True)
    assert part.samples is not None
    return part.samples


@pytest.mark.parametrize("ios", [False, True])
def test_bodies_give_the_samples_back(ios: bool) -> None:
    bodies = [read_body(one, received_ns=NOW) for one in phyphox_bodies(WALK.samples, ios=ios, pressure=True)]
    frame = PhoneFrame.IOS if ios else PhoneFrame.ANDROID
    assert {one.frame for one in bodies} == {frame}
    assert {one.unique_id for one in bodies} == {"0123456789abcdef"}
    assert len({one.started_ns for one in bodies}) == 1
    whole = Readings.merged(one.readings for one in bodies)
    found = samples_of(whole, frame)
    assert found.t == pytest.approx(WALK.samples.t, abs=1e-3)  # the phone tells its clock in milliseconds
    assert np.diff(found.t) == pytest.approx(np.diff(WALK.samples.t), abs=2e-6)
    for name in ("mag", "acc", "gyro"):
        assert np.array_equal(getattr(found, name), getattr(WALK.samples, name)), name
    assert len(whole.series[Sensor.PRESSURE]) == len(bodies)


def test_a_phone_that_tells_no_clock_read_just_now() -> None:
    first, second, *_ = phyphox_bodies(WALK.samples, timed=False)
    one = read_body(first, received_ns=NOW)
    assert max(int(series.t_ns[-1]) for series in one.readings.series.values()) == NOW
    two = read_body(second, received_ns=NOW + 3_000_000_000, started_ns=one.started_ns)
    whole = Readings.merged([one.readings, two.readings])
    assert np.diff(whole.series[Sensor.MAGNETOMETER].t_ns).max() < 30_000_000


def test_pauses_are_skipped_by_the_experiments_clock() -> None:
    body = {
        "mx": [1, 2, 3], "my": [0, 0, 0], "mz": [0, 0, None], "mt": [0.5, 1.5, 1.6],
        "time": {"now": 0, "events": [
            {"event": "START", "experimentTime": 0.0, "systemTime": 1.7e9},
            {"event": "PAUSE", "experimentTime": 1.0, "systemTime": 1.7e9 + 1},
            {"event": "START", "experimentTime": 1.0, "systemTime": 1.7e9 + 60},
        ]},
    }  # fmt: skip
    found = read_body(json.dumps(body).encode(), received_ns=NOW)
    t_ns = found.readings.series[Sensor.MAGNETOMETER].t_ns
    assert t_ns.tolist() == [1_700_000_000_500_000_000, 1_700_000_060_500_000_000]
    assert (found.started_ns, found.dropped) == (1_700_000_000_000_000_000, 1)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"mx": 3}, "mx", "array of numbers"),
        ({"mx": ["east"]}, r"mx\[0\]", "send a number"),
        ({"mt": None}, "mt", "is missing beside mx"),
        ({"mx": [1.0] * 9}, "mx", "send as many"),
        ({"uniqueID": 7}, "uniqueID", "a text"),
        ({"time": 5}, "time", "no events"),
        ({"time": {"events": [4]}}, "time.events", "no event"),
        ({"time": {"events": [{"event": "START"}]}}, "time.events", "no numbers"),
        (
            {"time": {"events": [{"event": "START", "experimentTime": 0, "systemTime": 9e15}]}},
            "time.events",
            "no time between",
        ),
    ],
)
def test_what_is_wrong_names_field_and_remedy(change: dict[str, object], field: str, words: str) -> None:
    body = {"mx": [1.0], "my": [2.0], "mz": [3.0], "mt": [0.1], **change}
    with pytest.raises(FormatError, match=rf"^{field}.*{words}"):
        read_body(json.dumps(body).encode(), received_ns=NOW)


def test_an_empty_body_is_one_without_readings() -> None:
    found = read_body(b'{"mx": [], "my": [], "mz": [], "mt": [], "battery": 5}', received_ns=NOW)
    assert (len(found.readings), found.ignored, found.frame) == (0, ("battery",), None)
    for content in (b"", b"[]", b"nothing"):
        with pytest.raises(FormatError):
            read_body(content, received_ns=NOW)


def test_the_experiment_sends_what_is_read_and_shows_what_is_answered() -> None:
    root = ElementTree.fromstring(experiment(URL, title="Mall <2>", location=True))
    assert (root.tag, root.get("version"), root.findtext("title")) == ("phyphox", "1.17", "Mall <2>")
    connection = root.find("network/connection")
    assert connection is not None
    assert connection.get("address") == URL
    assert (connection.get("service"), connection.get("conversion"), connection.get("interval")) == (
        "http/post",
        "json",
        "1",
    )
    sent = {one.get("id"): one for one in connection.findall("send")}
    for columns in COLUMNS.values():
        for name in (*columns.values, columns.time):
            assert (sent[name].text, sent[name].get("keep"), sent[name].get("datatype")) == (name, "false", "array")
    assert sent["time"].get("type") == "time"
    assert sent["uniqueID"].get("type") == "meta"
    containers = [one.text for one in root.findall("data-containers/container")]
    assert len(containers) == len(set(containers))
    used = [one.text for path in ("input//output", "views//input", ".//receive") for one in root.findall(path)]
    assert set(used) <= set(containers)
    assert {one.text for one in root.findall("input//output")} >= {"mx", "at", "gz", "p", "la", "lq"}
    assert {one.get("type") for one in root.findall("input/sensor")} == {
        "magnetic_field",
        "accelerometer",
        "gyroscope",
        "pressure",
    }
    received = {one.get("id") for one in connection.findall("receive")}
    assert received == set(json.loads(answer(WAITING)))


def test_location_is_asked_for_only_when_wanted() -> None:
    root = ElementTree.fromstring(experiment(URL))
    assert root.find("input/location") is None
    assert "la" not in {one.get("id") for one in root.findall("network/connection/send")}


def test_every_status_has_words_on_the_phone() -> None:
    root = ElementTree.fromstring(experiment(URL))
    shown = {(one.get("min"), one.get("max")) for one in root.findall("views//map")}
    assert shown >= {(str(code), str(code)) for code in (*STATUS_CODES.values(), WAITING, REFUSED)}
    assert set(STATUS_CODES) == set(Status)


def test_answers() -> None:
    assert json.loads(answer(WAITING)) == {"x": [], "y": [], "sd": [], "status": [0]}
    told = json.loads(answer(STATUS_CODES[Status.OK], x=1.23456, y=-2.0, sd=float("nan")))
    assert told == {"x": [1.235], "y": [-2.0], "sd": [], "status": [1]}


@pytest.mark.parametrize("url", ["ftp://x", "javascript:alert(1)", "https://x/\n", ""])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(FormatError, match="http"):
        experiment(url)


@pytest.mark.parametrize(
    ("ios", "delimiter", "decimal"), [(False, ",", "."), (True, ";", ","), (False, "\t", ","), (True, "\t", ".")]
)
def test_an_export_gives_the_samples_back(ios: bool, delimiter: str, decimal: str) -> None:
    found = read_export(phyphox_zip(WALK.samples, ios=ios, delimiter=delimiter, decimal=decimal))
    assert found.frame is (PhoneFrame.IOS if ios else PhoneFrame.ANDROID)
    assert (found.assumed, found.dropped) == ((), 0)
    samples = samples_of(found.readings, found.frame)
    assert samples.t == pytest.approx(WALK.samples.t, abs=1e-3)
    for name in ("mag", "acc", "gyro"):
        assert getattr(samples, name) == pytest.approx(getattr(WALK.samples, name), abs=1e-6), name


def test_an_export_with_a_pause() -> None:
    t = WALK.samples.t + np.where(np.arange(len(WALK.samples)) >= 300, PAUSE_S, 0.0)
    found = read_export(phyphox_zip(replace(WALK.samples, t=t), paused_at=300))
    assert samples_of(found.readings, PhoneFrame.ANDROID).t == pytest.approx(t, abs=1e-3)


def test_an_export_without_a_date() -> None:
    content = phyphox_zip(WALK.samples, dated=False)
    found = read_export(content)
    assert "2020-01-01" in found.assumed[0]
    dated = read_export(content, start_s=WALK.samples.t[0] - 0.5)
    assert dated.assumed == ()
    assert samples_of(dated.readings, PhoneFrame.ANDROID).t == pytest.approx(WALK.samples.t, abs=1e-3)


@pytest.mark.parametrize(
    ("header", "sensors"),
    [
        ("Time (s),Magnetic Field x (µT),Magnetic Field y (µT),Magnetic Field z (µT),Absolute field (µT)",
         {Sensor.MAGNETOMETER}),
        ('"t (s)","X (µT)","Y (µT)","Z (µT)"', {Sensor.MAGNETOMETER}),
        ("Zeit (s);Magnetfeld x (µT);Magnetfeld y (µT);Magnetfeld z (µT)", {Sensor.MAGNETOMETER}),
        ("Time (s),Linear Acceleration x (m/s^2),Linear Acceleration y (m/s^2),Linear Acceleration z (m/s^2)",
         {Sensor.LINEAR_ACCELERATION}),
        ("Time (s)\tBeschleunigung x (m/s²)\tBeschleunigung y (m/s²)\tBeschleunigung z (m/s²)", {Sensor.ACCELERATION}),
        ("Time (s),Gyroscope x (rad/s),Gyroscope y (rad/s),Gyroscope z (rad/s),Pressure (hPa)",
         {Sensor.GYROSCOPE, Sensor.PRESSURE}),
        ("Time (s),Latitude (°),Longitude (°),Height (m),Velocity (m/s),Horizontal Accuracy (m)", {Sensor.GNSS}),
    ],
)  # fmt: skip
def test_columns_are_found_by_their_labels(header: str, sensors: set[Sensor]) -> None:
    delimiter = next(one for one in ";\t," if one in header)
    row = delimiter.join(["0", "48", "11", "9", "1000", "8"][: header.count(delimiter) + 1])
    found = read_export(f"{header}\n{row}\n".encode())
    assert set(found.readings.series) == sensors


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no columns of a sensor"),
        (b"a,b\n1,2\n", "no columns of a sensor"),
        (b"Time (s),X (\xc2\xb5T),Y (\xc2\xb5T)\n0,1,2\n", "no columns of a sensor"),
        (b"Time (s),X (\xc2\xb5T),Y (\xc2\xb5T),Z (\xc2\xb5T)\n0,1,2,up\n", "line 2: Z .* is 'up'"),
        (phyphox_zip(WALK.samples)[:-30], "damaged archive"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(content: bytes, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        read_export(content)
