"""Files of phones told apart, read and assembled."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.types import ImuSamples
from app.exchange.phones import FormatError, PhoneFrame
from app.exchange.phones.files import FileChoices, PhoneFormat, Trip, format_of, read_trip
from app.exchange.surveys import Findings
from tests.exchange.recordings import PLANE, WALK, log_of
from tests.support.phones import Phone, phyphox_zip, sensor_logger_json, sensor_logger_zip


def read(content: bytes, kind: PhoneFormat | None = None, **choices: object) -> tuple[Trip, Findings]:
    findings = Findings()
    said = FileChoices(**choices)  # type: ignore[arg-type]
    return read_trip(content, kind or format_of(content), said, findings), findings


def samples_of(trip: Trip) -> ImuSamples:
    assert trip.assembled.samples is not None
    return trip.assembled.samples


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (sensor_logger_zip(WALK.samples), PhoneFormat.SENSOR_LOGGER),
        (sensor_logger_json(WALK.samples), PhoneFormat.SENSOR_LOGGER),
        (b"time,seconds_elapsed,Magnetometer_x\n", PhoneFormat.SENSOR_LOGGER),
        (phyphox_zip(WALK.samples), PhoneFormat.PHYPHOX),
        ('"Time (s)";"X (µT)"\n'.encode(), PhoneFormat.PHYPHOX),
        (log_of(), PhoneFormat.GETSENSORDATA),
        (b"MAGN;0.1;0.1;1;2;3;3\n", PhoneFormat.GETSENSORDATA),
    ],
)
def test_formats_are_told_by_what_is_in_them(content: bytes, kind: PhoneFormat) -> None:
    assert format_of(content) is kind


@pytest.mark.parametrize("content", [b"", b"t,x,y\n1,2,3\n", b"\x89PNG", b"PK\x03\x04junk"])
def test_what_nobody_writes_is_refused(content: bytes) -> None:
    with pytest.raises(FormatError):
        format_of(content)


def test_a_log_without_positions_is_a_trip() -> None:
    content = b"\n".join(line for line in log_of().splitlines() if not line.startswith(b"POSI"))
    content += b"\nGNSS;3.0;3.0;48.15;11.57;520.0;0.0;8.0;1.0;9;8\nGNSS;4.0;4.0;48.15;11.57;520.0;0.0;-1.0;1.0;9;8\n"
    trip, _ = read(content, radio=True)
    samples = samples_of(trip)
    assert abs(len(samples) - len(WALK.samples)) < 10
    assert np.median(np.linalg.norm(samples.acc, axis=1)) == pytest.approx(9.9, abs=0.5)
    part = trip.assembled
    assert part.pressure is not None
    assert set(part.pressure.hpa) == {954.2}
    assert part.gnss is not None
    assert part.gnss.accuracy_m.tolist() == [8.0]  # an accuracy below zero is none
    assert part.gnss.t[0] - samples.t[0] == pytest.approx(3.0, abs=0.1)
    assert trip.wifi is not None
    assert len(set(trip.wifi.address)) == 5
    assert read(content)[0].wifi is None


def test_a_log_with_positions_is_a_trip_too() -> None:
    trip, _ = read(log_of(plane=PLANE))
    assert len(samples_of(trip)) > 800


def test_signs_are_the_files_or_the_senders() -> None:
    apple = sensor_logger_json(WALK.samples, phone=Phone(ios=True))
    trip, findings = read(apple, frame=PhoneFrame.IOS)
    assert samples_of(trip).acc == pytest.approx(WALK.samples.acc, abs=1e-9)
    assert any("does not name the platform" in note for note in findings.assumed)
    _, findings = read(apple)
    assert any("--frame ios" in note for note in findings.assumed)
    told, findings = read(sensor_logger_zip(WALK.samples, phone=Phone(ios=True)))
    assert samples_of(told).acc == pytest.approx(WALK.samples.acc, abs=1e-9)
    assert any("as the file tells" in note for note in findings.assumed)


def test_what_is_missing_is_said() -> None:
    content = "Time (s),X (µT),Y (µT),Z (µT)\n0,1,2,3\n".encode()
    with pytest.raises(InputError, match="no readings of gyroscope, accelerometer, gravity"):
        read(content)
