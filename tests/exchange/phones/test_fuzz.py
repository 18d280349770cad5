"""Whatever comes: readings, or an error that names field and remedy; nothing else, and soon."""

from __future__ import annotations

import contextlib
import io
import json
import os
import zipfile
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.engine.types import ImuSamples
from app.exchange.phones import PhoneFrame, Readings, assemble
from app.exchange.phones.files import FileChoices, PhoneFormat, Trip, read_trip
from app.exchange.phones.phyphox import read_body
from app.exchange.phones.phyphox_files import read_export as read_phyphox
from app.exchange.phones.places import position_of, read_markers
from app.exchange.phones.readings import in_time
from app.exchange.phones.sensor_logger import NAMES, read_message
from app.exchange.phones.sensor_logger_files import read_export as read_sensor_logger
from app.exchange.surveys import Findings
from tests.exchange.recordings import WALK, log_of
from tests.support.phones import (
    Phone,
    phyphox_bodies,
    phyphox_zip,
    sensor_logger_json,
    sensor_logger_messages,
    sensor_logger_zip,
)

EXAMPLES = int(os.environ.get("ISODYN_TEST_EXAMPLES", "120"))
"""Of each test; more by hand: ISODYN_TEST_EXAMPLES=20000."""
CALM = settings(
    max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
READERS: dict[str, Callable[[bytes], Readings]] = {
    "message": lambda content: read_message(content).readings,
    "body": lambda content: read_body(content, received_ns=1_700_000_000_000_000_000).readings,
    "sensor logger": lambda content: read_sensor_logger(content).readings,
    "phyphox": lambda content: read_phyphox(content).readings,
}


@cache
def valid() -> dict[str, list[bytes]]:
    """Short ones of each kind."""
    t = slice(0, 40)
    samples = WALK.samples
    short = ImuSamples(samples.t[t], samples.mag[t], samples.acc[t], samples.gyro[t])
    t0 = float(short.t[0])
    phone = Phone(barometer={t0 + 0.1: 1003.0}, location={t0 + 0.2: (48.1, 11.5, 5.0)})
    messages = sensor_logger_messages(short, WALK.waypoints, phone=phone, batch_s=0.3)
    zipped = sensor_logger_zip(short, WALK.waypoints, phone=phone)
    combined = b"time,Gravity_x,Gravity_y,Gravity_z\n1698501144401773000,0,0,9.8\n1698501144401774000,,,\n"
    return {
        "message": messages[:2],
        "body": phyphox_bodies(short, interval_s=0.4, pressure=True)[:2],
        "sensor logger": [zipped, sensor_logger_json(short, WALK.waypoints), combined],
        "phyphox": [
            phyphox_zip(short),
            phyphox_zip(short, ios=True, delimiter=";", decimal=","),
            "Time (s),X (µT),Y (µT),Z (µT)\n0.1,1,2,3\n0.2,4,5,NaN\n".encode(),
        ],
    }


def check(reader: str, content: bytes) -> None:
    """Read; what comes out can be assembled, and is in order."""
    refused: InputError | None = None
    readings = Readings()
    try:
        readings = READERS[reader](content)
    except InputError as error:
        refused = error
    assert refused is None or (refused.field and len(refused.message) < 400)
    for sensor, series in readings.series.items():
        assert series.values.shape == (len(series), sensor.width)
        assert np.isfinite(series.values).all()
        assert (np.diff(series.t_ns) > 0).all()
        assert all(in_time(int(t)) for t in series.t_ns[[0, -1]])
    for final in (False, True):
        part = assemble(Readings.unpack(readings.pack()), PhoneFrame.IOS, final=final)
        if part.samples is not None:
            assert (np.diff(part.samples.t) > 0).all()
            assert all(np.isfinite(getattr(part.samples, name)).all() for name in ("mag", "acc", "gyro"))


@pytest.mark.parametrize("reader", READERS)
@CALM
@given(content=st.binary(max_size=400), start=st.sampled_from([b"", b"[", b'{"payload":[', b"PK\x03\x04", b"time,x\n"]))
def test_random_bytes(reader: str, content: bytes, start: bytes) -> None:
    check(reader, start + content)


@st.composite
def mutations(draw: st.DrawFn, reader: str) -> bytes:
    """A valid one, mutated; of an archive mostly a table in it, for archives have checksums."""
    content = draw(st.sampled_from(valid()[reader]))
    if not content.startswith(b"PK") or draw(st.integers(0, 3)) == 0:
        return mutated(draw, content)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(out, "w") as target:
        names = source.namelist()
        chosen = draw(st.sampled_from(names))
        for name in names:
            table = source.read(name)
            target.writestr(name, mutated(draw, table) if name == chosen else table)
    return out.getvalue()


def mutated(draw: st.DrawFn, original: bytes) -> bytes:
    """Bytes changed, cut, doubled, or with a piece of something else among them."""
    content = bytearray(original)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(content) - 1)))
        kind = draw(st.sampled_from(["change", "cut", "double", "insert", "end"]))
        if kind == "change":
            content[at : at + 1] = bytes([draw(st.integers(0, 255))])
        elif kind == "cut":
            del content[at : at + draw(st.integers(1, 200))]
        elif kind == "double":
            content[at:at] = content[at : at + draw(st.integers(1, 200))]
        elif kind == "end":
            del content[at:]
        else:
            content[at:at] = draw(st.sampled_from(TOKENS))
    return bytes(content)


TOKENS = [
    b"null", b"NaN", b"-Infinity", b"1e999", b"-1", b"9" * 30, b"9" * 5000, b'"', b"{", b"[" * 2000, b"]", b",", b"\n",
    b"\x00", b"\xff\xfe", b'{"x":1}', "\u00b2".encode(), "\u0663".encode(), b"1_0", b"1e5", b"true", b"\\ud800",
]  # fmt: skip


@pytest.mark.parametrize("reader", READERS)
@CALM
@given(data=st.data())
def test_mutated_valid_ones(reader: str, data: st.DataObject) -> None:
    check(reader, data.draw(mutations(reader)))


SCALAR = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=12)
KEY = st.sampled_from(["x", "text", "events", "event", "experimentTime", "systemTime"])
LEAF = SCALAR | st.just("START") | st.just(1.7e9)
INNER = LEAF | st.lists(LEAF, max_size=3) | st.dictionaries(KEY, LEAF, max_size=3)
VALUE = INNER | st.lists(INNER, max_size=3) | st.dictionaries(KEY, INNER | st.lists(INNER, max_size=2), max_size=3)
NAME = st.sampled_from([*NAMES, "annotation", "microphone", "Magnetometer", "Metadata"]) | VALUE
TIME = st.integers(1_698_501_144_401_773_000, 1_698_501_146_401_773_000) | VALUE
ROW = st.fixed_dictionaries(
    {},
    optional={
        "name": NAME, "sensor": NAME, "time": TIME,
        "values": st.dictionaries(st.sampled_from(["x", "y", "z", "pressure", "steps", "text"]), VALUE) | VALUE,
        "x": VALUE, "y": VALUE, "z": VALUE,
    },
)  # fmt: skip
BODY = st.dictionaries(
    st.sampled_from(["mx", "my", "mz", "mt", "p", "pt", "time", "uniqueID", "deviceModel"]),
    st.lists(VALUE, max_size=5) | st.lists(st.floats(0, 10), max_size=5) | VALUE,
)


@CALM
@given(rows=st.lists(ROW, max_size=6) | VALUE, head=st.dictionaries(st.sampled_from(["messageId", "sessionId"]), VALUE))
def test_json_of_any_shape(rows: object, head: dict[str, object]) -> None:
    check("message", json.dumps({**head, "payload": rows}).encode())
    check("sensor logger", json.dumps(rows).encode())


@CALM
@given(body=BODY)
def test_bodies_of_any_shape(body: dict[str, object]) -> None:
    check("body", json.dumps(body).encode())


CELL = st.sampled_from(["", "0", "1.5", "-3", "NaN", "1e999", "x", '"', "\u0663", "1698501144401773000", "1,5", " 7 "])
HEADERS = st.sampled_from(
    [
        "time", "seconds_elapsed", "x", "y", "z", "text", "Time (s)", "X (µT)", "Y (µT)", "Z (µT)", "Gravity_x",
        "Gravity_y", "Gravity_z", "Pressure (hPa)", "((((", "",
    ]
)  # fmt: skip
TABLES = ["Gravity", "Magnetometer", "Metadata", "Annotation", "meta/time", "meta/device", "a/Gravity"]


@CALM
@given(
    tables=st.dictionaries(
        st.sampled_from(TABLES),
        st.tuples(st.lists(HEADERS, max_size=6), st.lists(st.lists(CELL, max_size=6), max_size=4)),
        max_size=4,
    ),
    delimiter=st.sampled_from([",", ";", "\t"]),
)
def test_tables_of_any_shape(tables: dict[str, tuple[list[str], list[list[str]]]], delimiter: str) -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, (header, rows) in tables.items():
            content = "\n".join(delimiter.join(row) for row in [header, *rows])
            archive.writestr(f"{name}.csv", content)
            check("phyphox", content.encode())
            check("sensor logger", content.encode())
    check("phyphox", out.getvalue())
    check("sensor logger", out.getvalue())


LINE = st.tuples(
    st.sampled_from(["MAGN", "ACCE", "GYRO", "PRES", "GNSS", "POSI", "WIFI", "BLE4", "%"]),
    st.lists(
        st.floats(-2e12, 2e12).map(repr)
        | st.sampled_from(["", "x", "nan", "1e12", "a4:2b:8c:91:00:f7", "0.02", "0.04"]),
        max_size=9,
    ),
).map(lambda parts: ";".join([parts[0], *parts[1]]))


@CALM
@given(lines=st.lists(LINE, max_size=12), valid=st.booleans())
def test_logs_of_any_shape(lines: list[str], valid: bool) -> None:
    content = (log_of()[:9000] if valid else b"") + "\n".join(lines).encode()
    found: Trip | None = None
    with contextlib.suppress(InputError):
        found = read_trip(content, PhoneFormat.GETSENSORDATA, FileChoices(radio=True), Findings())
    if found is not None and (samples := found.assembled.samples) is not None:
        assert (np.diff(samples.t) > 0).all()
        assert np.isfinite(samples.acc).all()


@CALM
@given(text=st.text(max_size=120), content=st.binary(max_size=200))
def test_annotations_and_markers_of_any_shape(text: str, content: bytes) -> None:
    position = position_of(text, {})
    assert position is None or all(abs(value) <= 1e6 for value in position)
    for start in (b"", b"name,x,y\n", b"name;x;y\nDoor;"):
        markers = {}
        with contextlib.suppress(InputError):
            markers = read_markers(start + content)
        assert all(np.isfinite(place).all() for place in markers.values())


def test_what_takes_long_to_read_is_refused_or_read_soon() -> None:
    """Nested, repeated and endless content, at the sizes that a request may have."""
    assert position_of("1 " * 2**20, {}) is None
    assert position_of("x" + " " * 2**20, {}) is None
    for content in (b"[" * 2**20, b'{"payload":[' + b"{}," * 10_000, b"9" * 2**20, b"NaN" + b"9" * 2**20, b'"' * 2**20):
        for reader in READERS:
            check(reader, content)
    check("sensor logger", (",".join(["a_" * 3000] * 150) + "\n").encode())
    check("phyphox", (",".join([" " * 3000 + "("] * 150) + "\n").encode())
