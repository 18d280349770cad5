"""Messages and exports of Sensor Logger."""

from __future__ import annotations

import io
import json
import struct
import zipfile

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.types import ImuSamples
from app.exchange.phones import FormatError, PhoneFrame, Readings, Sensor, assemble
from app.exchange.phones import recorded as recorded_module
from app.exchange.phones.sensor_logger import read_message
from app.exchange.phones.sensor_logger_files import read_export
from tests.exchange.recordings import WALK
from tests.support.phones import Phone, sensor_logger_json, sensor_logger_messages, sensor_logger_zip

T = 1_698_501_144_401_773_001


def body(*readings: object, **head: object) -> bytes:
    return json.dumps({"messageId": 0, "sessionId": "s", "deviceId": "d", "payload": readings, **head}).encode()


def reading(name: str = "magnetometer", time: object = T, **values: object) -> dict[str, object]:
    return {"name": name, "time": time, "values": values or {"x": 1.5, "y": -20.25, "z": -39.0}, "accuracy": 3}


def samples_of(readings: Readings, frame: PhoneFrame) -> ImuSamples:
    part = assemble(readings, frame, final=True)
    assert part.samples is not None
    return part.samples


def assert_same(found: ImuSamples, expected: ImuSamples) -> None:
    assert found.t == pytest.approx(expected.t, abs=1e-6)
    for name, within in (("mag", 1e-9), ("acc", 1e-9), ("gyro", 1e-9)):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=within), name


@pytest.mark.parametrize("ios", [False, True])
def test_messages_give_the_samples_back(ios: bool) -> None:
    bodies = sensor_logger_messages(WALK.samples, WALK.waypoints, phone=Phone(ios=ios), swapped=[2], repeated=[4])
    messages = [read_message(one) for one in bodies]
    assert [one.message_id for one in messages][:6] == [0, 1, 3, 2, 4, 4]
    assert {one.session_id for one in messages} == {Phone().session_id}
    whole = Readings.merged(one.readings for one in messages)
    assert_same(samples_of(whole, PhoneFrame.IOS if ios else PhoneFrame.ANDROID), WALK.samples)
    assert [note.text for note in whole.annotations] == [
        f"{x:.3f},{y:.3f}" for x, y in zip(WALK.waypoints.x, WALK.waypoints.y, strict=True)
    ]


def test_asynchronous_sensors_stay_close_to_the_truth() -> None:
    bodies = sensor_logger_messages(WALK.samples, phone=Phone(asynchronous=True))
    found = samples_of(Readings.merged(read_message(one).readings for one in bodies), PhoneFrame.ANDROID)
    assert len(found) > 0.98 * len(WALK.samples)
    truth = np.stack([np.interp(found.t, WALK.samples.t, WALK.samples.acc[:, i]) for i in range(3)], axis=1)
    assert np.sqrt(((found.acc - truth) ** 2).mean()) < 0.12


def test_times_are_exact() -> None:
    """Neighbouring nanoseconds are one float."""
    assert float(T) == float(T + 1)
    found = read_message(body(reading(time=T), reading(time=T + 1), reading(time=str(T + 2))))
    assert found.readings.series[Sensor.MAGNETOMETER].t_ns.tolist() == [T, T + 1, T + 2]


def test_all_kinds_of_readings() -> None:
    found = read_message(
        body(
            reading("Barometer", pressure=1003.2, relativeAltitude=0.1),
            reading("pedometer", steps=12),
            reading("location", latitude=48.1, longitude=11.5, horizontalAccuracy=8.0, speed=-1),
            reading("location", T + 1, latitude=48.1, longitude=11.5, horizontalAccuracy=-1.0),
            reading("annotation", text=" door 3 ", millisecond_press_duration=80),
            reading("magnetometeruncalibrated"),
        )
    )
    series = found.readings.series
    assert series[Sensor.PRESSURE].values.tolist() == [[1003.2]]
    assert series[Sensor.STEPS].values.tolist() == [[12.0]]
    assert series[Sensor.GNSS].values.tolist() == [[48.1, 11.5, 8.0]]
    assert [(note.t_ns, note.text) for note in found.readings.annotations] == [(T, "door 3")]
    assert len(series[Sensor.MAGNETOMETER_UNCALIBRATED]) == 1
    assert found.dropped == 1


def test_unknown_names_are_ignored_and_empty_readings_dropped() -> None:
    found = read_message(
        body(
            {"name": "microphone", "time": "whenever", "values": None},
            reading("wrist motion"),
            reading("orientation", qx=0.0),
            reading(x=None, y=1.0, z=2.0),
            reading(x=1.0),
        )
    )
    assert found.ignored == ("microphone", "orientation", "wrist motion")
    assert (len(found.readings), found.dropped) == (0, 2)
    not_json = b'{"payload":[{"name":"gravity","time":%d,"values":{"x":NaN,"y":0,"z":9.8}}]}' % T
    assert read_message(not_json).dropped == 1


@pytest.mark.parametrize("content", [b"", b" \n", b"{}", b'{"payload": []}', b'{"payload": null}', b'{"msg": "test"}'])
def test_a_test_push_is_a_message_without_readings(content: bytes) -> None:
    found = read_message(content)
    assert (len(found.readings), found.message_id, found.session_id) == (0, None, "")


@pytest.mark.parametrize(
    ("content", "field", "words"),
    [
        (b"[1]", "body", "send an object"),
        (b"{", "body", "no JSON"),
        (b"\xff\xfe", "body", "no JSON"),
        (b"[" * 100_000, "body", "no JSON"),
        (b'{"payload": 3}', "payload", "an array"),
        (body(3), "payload[0]", "no reading"),
        (body(reading(time=1.5e18)), "payload[0].time", "as an integer"),
        (body(reading(time=True)), "payload[0].time", "as an integer"),
        (body(reading(time="1698501144.4")), "payload[0].time", "as an integer"),
        (body(reading(time=10**19)), "payload[0].time", "no time between"),
        (body({"name": "gravity", "time": T, "values": [1, 2, 3]}), "payload[0].values", "send an object"),
        (body(reading(x="north", y=1, z=2)), "payload[0].values.x", "send a number"),
        (body(reading(x=True, y=1, z=2)), "payload[0].values.x", "send a number"),
        (body(messageId=-1), "messageId", "whole number"),
        (body(sessionId=5), "sessionId", "a text"),
        (body(deviceId="d" * 300), "deviceId", "at most 200"),
    ],
)
def test_what_is_wrong_names_field_and_remedy(content: bytes, field: str, words: str) -> None:
    with pytest.raises(FormatError, match=words) as raised:
        read_message(content)
    assert raised.value.field == field
    assert isinstance(raised.value, InputError)


def test_messages_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.exchange.phones.sensor_logger.MAX_READINGS", 10)
    assert len(read_message(body(*[reading(time=T + i) for i in range(10)])).readings) == 10
    with pytest.raises(FormatError, match="in parts"):
        read_message(body(*[{"name": "unknown"}] * 11))


@pytest.mark.parametrize("content", [b"[" + b"{}," * 5_000_000 + b"{}]", b'{"payload":[' + b"1,[]," * 2_500_000])
def test_what_would_swell_in_memory_is_not_parsed(content: bytes) -> None:
    with pytest.raises(FormatError, match="more than 4000000 values"):
        read_message(content)


@pytest.mark.parametrize(
    ("phone", "standardised", "frame"),
    [
        (Phone(), False, PhoneFrame.ANDROID),
        (Phone(ios=True), False, PhoneFrame.IOS),
        (Phone(ios=True), True, PhoneFrame.STANDARDISED),
        (Phone(uncalibrated=True), False, PhoneFrame.ANDROID),
    ],
)
def test_an_export_gives_the_samples_back(phone: Phone, standardised: bool, frame: PhoneFrame) -> None:
    found = read_export(sensor_logger_zip(WALK.samples, WALK.waypoints, phone=phone, standardised=standardised))
    assert found.frame is frame
    assert found.ignored == ("Battery.csv",)
    assert_same(samples_of(found.readings, frame), WALK.samples)
    assert len(found.readings.annotations) == len(WALK.waypoints)


def test_a_json_export_gives_the_samples_back() -> None:
    found = read_export(sensor_logger_json(WALK.samples, WALK.waypoints))
    assert found.frame is None
    assert_same(samples_of(found.readings, PhoneFrame.ANDROID), WALK.samples)
    assert len(found.readings.annotations) == len(WALK.waypoints)


def test_a_combined_table() -> None:
    content = (
        "time,seconds_elapsed,Magnetometer_z,Magnetometer_y,Magnetometer_x,Gyroscope_x,Barometer_pressure,Gravity_x\n"
        f"{T},0,3,2,1,,1003.5,1\n{T + 5},0,,,,,1003.6,\n\n{T + 9},0,6,5,4\n"
    )
    found = read_export(content.encode())
    assert found.readings.series[Sensor.MAGNETOMETER].values.tolist() == [[1.0, 2.0, 3.0]]
    assert found.readings.series[Sensor.PRESSURE].values.tolist() == [[1003.5], [1003.6]]
    assert set(found.readings.series) == {Sensor.MAGNETOMETER, Sensor.PRESSURE}  # what lacks axes is no sensor
    assert found.dropped == 1


def zipped(**files: str) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/") + ".csv", content)
    return out.getvalue()


HEAD = "time,seconds_elapsed,z,y,x\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "neither a zip file nor JSON"),
        (b"a,b\n1,2\n", "neither a zip file nor JSON"),
        (b"PK\x03\x04" + b"\0" * 40, "damaged archive"),
        (sensor_logger_zip(WALK.samples)[:-40], "damaged archive"),
        (zipped(readme="x"), "no table of Sensor Logger"),
        (zipped(Magnetometer="time,x,y\n1,2,3\n"), "lacks z"),
        (zipped(Magnetometer="x,y,z\n1,2,3\n"), "lacks time"),
        (zipped(Magnetometer=HEAD + "yesterday,0,1,2,3\n"), "line 2: time: is 'yesterday'"),
        (zipped(Magnetometer=HEAD + f"{T},0,1,2,east\n"), "line 2: x: is 'east'"),
        (zipped(Magnetometer=HEAD + f'{T},0,"1,2,3\n' * 3), "line 3: is no CSV"),
        (zipped(a__Gravity=HEAD, b__Gravity=HEAD), "is there twice"),
        (b'{"sensor": "x"}', "no array of readings"),
        (b'[{"sensor": "Gravity"}]', r"\[0\].time"),
        (b"[7]", "no reading"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(content: bytes, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        read_export(content)


def far_away() -> bytes:
    """An archive whose file begins, it says, at byte 2^64 - 10."""
    content = zipped(Gravity=HEAD)
    at, end = content.index(b"PK\x01\x02"), content.index(b"PK\x05\x06")
    entry, tail = bytearray(content[at:end]), bytearray(content[end:])
    extra = struct.pack("<HHQ", 1, 8, 2**64 - 10)
    entry[42:46] = b"\xff" * 4
    entry[30:32] = struct.pack("<H", len(extra))
    entry += extra
    tail[12:16] = struct.pack("<L", len(entry))
    return content[:at] + bytes(entry) + bytes(tail)


def test_uncommon_archives_are_refused() -> None:
    unnamed = zipped(Gravity=HEAD).replace(b"Gravity.csv", b"\0ravity.csv")
    with pytest.raises(InputError, match="damaged archive"):
        read_export(unnamed)
    with pytest.raises(InputError, match="damaged archive"):
        read_export(far_away())
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("Gravity.csv", HEAD)
    with pytest.raises(InputError, match="uncommon way"):
        read_export(packed.getvalue())


def test_archives_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Gravity.csv", HEAD + "\n" * 4_000_000)
    assert len(bomb.getvalue()) < 10_000
    with pytest.raises(FormatError, match="more than 3000000 readings"):
        read_export(bomb.getvalue())
    monkeypatch.setattr(recorded_module, "MAX_INFLATED", 1_000_000)
    with pytest.raises(FormatError, match="bytes of tables"):
        read_export(bomb.getvalue())


def test_commas_of_annotations_are_not_quoted() -> None:
    table = f"time,seconds_elapsed,text,millisecond_press_duration\n{T},1.0,12.5,40,80\n{T + 1},2.0,door 3,80\n"
    found = read_export(zipped(Annotation=table))
    assert [note.text for note in found.readings.annotations] == ["12.5,40", "door 3"]


def test_a_recording_that_was_broken_off_is_read_as_far_as_it_goes() -> None:
    found = read_export(zipped(Gravity=HEAD + f"{T},0,9.8,0,0\n{T + 10},0,9.8,0\n"))
    assert found.readings.series[Sensor.GRAVITY].values.tolist() == [[0.0, 0.0, 9.8]]
    assert found.dropped == 1
