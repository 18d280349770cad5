"""Messages of the phone application Sensor Logger (HTTP push and MQTT publish have one format).

::

    {"messageId": 0, "sessionId": "...", "deviceId": "...",
     "payload": [{"name": "magnetometer", "time": 1698501144401773000, "values": {"x": 1.5, "y": -20.1, "z": -39.0}}]}

Times are UTC nanoseconds. ``accelerometer`` is without gravity, which is told beside it. Units are those of
:class:`Sensor`; signs are the platform's, which the message does not name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from app.exchange.phones.collecting import Collector, number, shown, time_ns
from app.exchange.phones.errors import FormatError
from app.exchange.phones.json_text import parsed
from app.exchange.phones.readings import Readings, Sensor

MAX_READINGS = 200_000
"""Of one message: ten minutes of five sensors at 60 Hz."""
MAX_ID = 200
_MAX_VALUES = 20 * MAX_READINGS
"""A location has the most: 16."""
_MAX_IGNORED, _MAX_NAME = 32, 40
_XYZ = ("x", "y", "z")
VALUES: Mapping[Sensor, tuple[str, ...]] = {
    Sensor.PRESSURE: ("pressure",),
    Sensor.STEPS: ("steps",),
    Sensor.GNSS: ("latitude", "longitude", "horizontalAccuracy"),
}
"""Names of a reading's values; x, y, z of the others."""
NAMES: Mapping[str, Sensor] = {
    "magnetometer": Sensor.MAGNETOMETER,
    "magnetometeruncalibrated": Sensor.MAGNETOMETER_UNCALIBRATED,
    "accelerometer": Sensor.LINEAR_ACCELERATION,
    "totalacceleration": Sensor.ACCELERATION,
    "gravity": Sensor.GRAVITY,
    "gyroscope": Sensor.GYROSCOPE,
    "barometer": Sensor.PRESSURE,
    "pedometer": Sensor.STEPS,
    "location": Sensor.GNSS,
}
"""Names of sensors in messages, and in lower case in files. ``accelerometeruncalibrated`` is not taken: its unit is not
known (g on iOS unless standardised)."""
ANNOTATION = "annotation"


@dataclass(frozen=True, slots=True)
class Message:
    """One message.

    Attributes
    ----------
    message_id : int or None
        Counts up in a session; None where the message names none (a test push).
    session_id, device_id : str
        Empty where the message names none.
    readings : Readings
    ignored : tuple of str
        Names in the payload that are not taken, in order.
    dropped : int
        Readings without a value, or with one that no sensor reads.
    """

    message_id: int | None = None
    session_id: str = ""
    device_id: str = ""
    readings: Readings = field(default_factory=Readings)
    ignored: tuple[str, ...] = ()
    dropped: int = 0


def values_of(sensor: Sensor) -> tuple[str, ...]:
    """Names of a reading's values."""
    return VALUES.get(sensor, _XYZ)


def read_message(body: bytes) -> Message:
    """A message of the application; one without readings (a test push, an empty body) is one too.

    Raises
    ------
    FormatError
        Names the field and the remedy.
    """
    if not body.strip():
        return Message()
    found = parsed(body, "body", most=_MAX_VALUES)
    if not isinstance(found, dict):
        raise FormatError("body", f"is {shown(found)}; send an object with messageId, sessionId, deviceId and payload")
    payload = found.get("payload")
    if payload is not None and not isinstance(payload, list):
        raise FormatError("payload", f"is {shown(payload)}; send an array of readings")
    collector = Collector(MAX_READINGS, "payload")
    ignored: set[str] = set()
    for place, reading in enumerate(payload or ()):
        _take(reading, place, collector, ignored)
    return Message(
        message_id=_message_id(found.get("messageId")),
        session_id=_id(found, "sessionId"),
        device_id=_id(found, "deviceId"),
        readings=collector.readings(),
        ignored=tuple(sorted(ignored)),
        dropped=collector.dropped,
    )


def _take(reading: object, place: int, collector: Collector, ignored: set[str]) -> None:
    collector.row()
    if not isinstance(reading, dict) or not isinstance(name := reading.get("name"), str):
        raise FormatError(f"payload[{place}]", "is no reading; send an object with name, time and values")
    plain = name.strip().lower()
    sensor = NAMES.get(plain)
    if sensor is None and plain != ANNOTATION:
        if len(ignored) < _MAX_IGNORED:
            ignored.add(plain[:_MAX_NAME])
        return
    t_ns = time_ns(reading.get("time"), f"payload[{place}].time")
    values = reading.get("values")
    if not isinstance(values, dict):
        raise FormatError(f"payload[{place}].values", f"is {shown(values)}; send an object")
    if sensor is None:
        text = values.get("text")
        collector.note(t_ns, text if isinstance(text, str) else "")
        return
    taken = [number(values.get(one), f"payload[{place}].values.{one}") for one in values_of(sensor)]
    collector.add(sensor, t_ns, taken)


def _message_id(value: object) -> int | None:
    if value is None:
        return None
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 18:
        value = int(value)
    if type(value) is not int or not 0 <= value < 2**62:
        raise FormatError("messageId", f"is {shown(value)}; send a whole number from 0")
    return value


def _id(found: Mapping[str, object], name: str) -> str:
    value = found.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > MAX_ID:
        raise FormatError(name, f"is {shown(value)}; send a text of at most {MAX_ID} characters")
    return value
