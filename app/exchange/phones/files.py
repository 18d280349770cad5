"""Recordings of phones as files, whichever application wrote them: told apart, read, assembled."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from app.engine.errors import InputError
from app.engine.types import RadioScans
from app.exchange.maps.archive import DAMAGED_ZIP
from app.exchange.phones import phyphox_files, sensor_logger_files
from app.exchange.phones.assembly import Assembled, PhoneFrame, assemble, missing
from app.exchange.phones.collecting import plausible
from app.exchange.phones.errors import FormatError
from app.exchange.phones.readings import MAX_TIME_NS, MIN_TIME_NS, NS, Readings, Sensor, Series
from app.exchange.phones.recorded import Recorded, is_zip
from app.exchange.surveys.getsensordata import LogChoices, SensorLog, read_sensor_log
from app.exchange.surveys.recording import Findings

_UPSIDE_DOWN = -5.0
"""m/s^2: median of a phone's z that lay face down all the time, or whose signs are Apple's."""
_LISTED = 12


class PhoneFormat(StrEnum):
    """Who wrote a file."""

    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"
    GETSENSORDATA = "getsensordata"


@dataclass(frozen=True, slots=True)
class FileChoices:
    """What the sender says of a file.

    Attributes
    ----------
    frame : PhoneFrame
        Signs of a file that does not tell them.
    start_s : float or None
        Unix seconds at which a recording without a date began.
    radio : bool
        Whether Wi-Fi and BLE readings are taken along (GetSensorData).
    """

    frame: PhoneFrame = PhoneFrame.ANDROID
    start_s: float | None = None
    radio: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Trip:
    """One recording on one time base, with what else was read."""

    assembled: Assembled
    wifi: RadioScans | None = None
    ble: RadioScans | None = None


def format_of(content: bytes) -> PhoneFormat:
    """Who wrote a file, by what is in it.

    Raises
    ------
    FormatError
        Nobody known.
    """
    if is_zip(content):
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                names = {name.lower() for name in archive.namelist()[:1000]}
        except DAMAGED_ZIP as error:
            raise FormatError("file", "is a damaged archive; export the recording again") from error
        return PhoneFormat.PHYPHOX if "meta/time.csv" in names else PhoneFormat.SENSOR_LOGGER
    start = content[:65_536].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith((b"%", b"MAGN;", b"ACCE;", b"GYRO;")) or b"\nMAGN;" in start:
        return PhoneFormat.GETSENSORDATA
    first = start.split(b"\n", 1)[0].lower()
    if start.startswith((b"[", b"{")) or b"seconds_elapsed" in first:
        return PhoneFormat.SENSOR_LOGGER
    if b"(s)" in first:
        return PhoneFormat.PHYPHOX
    raise FormatError("file", f"does not tell its format; name it: --format {', '.join(PhoneFormat)}")


def read_trip(content: bytes, kind: PhoneFormat, choices: FileChoices, findings: Findings) -> Trip:
    """A recording, assembled.

    Parameters
    ----------
    content : bytes
    kind : PhoneFormat
    choices : FileChoices
    findings : Findings
        Is told what was assumed and left out.

    Raises
    ------
    InputError
        No such file, or sensors are missing; names the place and the remedy.
    """
    wifi: RadioScans | None = None
    ble: RadioScans | None = None
    if kind is PhoneFormat.GETSENSORDATA:
        log = read_sensor_log(io.BytesIO(content), _log_choices(choices), findings)
        recorded, wifi, ble = _of_log(log), log.wifi, log.ble
    elif kind is PhoneFormat.PHYPHOX:
        recorded = phyphox_files.read_export(content, start_s=choices.start_s)
    else:
        recorded = sensor_logger_files.read_export(content)
    lacking = missing(recorded.readings)
    if lacking:
        raise InputError(
            "file", f"has no readings of {', '.join(lacking)}; record them too: a position needs all three sensors"
        )
    _account(recorded, choices, findings)
    assembled = assemble(recorded.readings, recorded.frame or choices.frame, final=True)
    if assembled.samples is None:
        raise InputError("file", "has no time at which all sensors read; record them together")
    if recorded.frame is None and np.median(assembled.samples.acc[:, 2]) < _UPSIDE_DOWN:
        findings.assume("a phone held face down most of the time; if it was an iPhone, say --frame ios")
    return Trip(assembled, wifi, ble)


def _log_choices(choices: FileChoices) -> LogChoices:
    return replace(LogChoices(), radio=choices.radio, start_s=choices.start_s, aids=True)


def _of_log(log: SensorLog) -> Recorded:
    """A log of Android's sensors as readings."""
    names = {
        "mag": Sensor.MAGNETOMETER, "acc": Sensor.ACCELERATION, "gyro": Sensor.GYROSCOPE, "pressure": Sensor.PRESSURE,
        "gnss": Sensor.GNSS,
    }  # fmt: skip
    series = {}
    for name, (t, values) in log.readings.items():
        true = np.array([plausible(names[name], row) for row in values.tolist()], dtype=bool)
        true &= (t >= MIN_TIME_NS / NS) & (t <= MAX_TIME_NS / NS)
        t_ns = np.round(t[true] * 1e6).astype(np.int64) * (NS // 1_000_000)
        if true.any():
            series[names[name]] = Series.ordered(t_ns, values[true])
    return Recorded(Readings(series), PhoneFrame.ANDROID)


def _account(recorded: Recorded, choices: FileChoices, findings: Findings) -> None:
    for words in recorded.assumed:
        findings.assume(words)
    if recorded.frame is None:
        findings.assume(f"signs as {choices.frame.value} (--frame tells others): the file does not name the platform")
    else:
        findings.assume(f"signs as {recorded.frame.value}, as the file tells")
    if recorded.dropped:
        findings.skipped.append(f"{recorded.dropped} rows without a usable value")
    if recorded.ignored:
        more = len(recorded.ignored) - _LISTED
        listed = ", ".join(recorded.ignored[:_LISTED]) + (f" and {more} more" if more > 0 else "")
        findings.skipped.append(f"what a position does not need: {listed}")
