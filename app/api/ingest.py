"""What phones are told: where to push to, what to choose in the app, and in one line what is wrong."""

from __future__ import annotations

from fastapi import Response

from app.exchange.phones.assembly import PhoneFrame, missing
from app.exchange.phones.readings import Readings
from app.services.ingest.records import IngestApp, IngestToken, Purpose

SHOWN = 499
"""The status with which Sensor Logger shows the text of an answer, once a recording."""
_SENSOR_LOGGER = [
    "Logger: switch on Magnetometer, Accelerometer, Gravity, Gyroscope, and Barometer where there is one",
    "Settings, Sampling Frequency: 50 Hz or more (0 ms: as fast as the phone can)",
    "Settings, Data Streaming: Enable HTTP Push, and paste the address into Push URL",
    "Settings, Data Streaming: Batching Period 1000 ms, or 500 ms for quicker positions",
    "Tap to Test Pushing: Isodyn answers 200",
]
_STANDARDISE = "Settings: switch on Standardise Units & Frames (this address expects it)"
_NOT_STANDARDISED = "Settings: leave Standardise Units & Frames off (this address is for an iPhone's own signs)"
_SURVEY = "Logger: switch on Annotation, and press it at every marked point, with the point's name as its text"
_PHYPHOX = [
    "In phyphox: +, add experiment from a QR code (or open the address on the phone)",
    "Start the experiment, and allow it to send data; the position appears on the screen",
]


def url_of(base: str, app: IngestApp, secret: str) -> str:
    """The address that an app is given; ``base`` ends in a slash."""
    end = "/experiment.phyphox" if app is IngestApp.PHYPHOX else ""
    return f"{base}v1/ingest/{app.value}/{secret}{end}"


def settings_of(token: IngestToken) -> list[str]:
    """What to choose in the app."""
    if token.app is IngestApp.PHYPHOX:
        return list(_PHYPHOX)
    signs = {PhoneFrame.STANDARDISED: [_STANDARDISE], PhoneFrame.IOS: [_NOT_STANDARDISED]}.get(token.frame, [])
    survey = [_SURVEY] if token.purpose is Purpose.SURVEY else []
    return [*_SENSOR_LOGGER, *signs, *survey]


def shown(text: str) -> Response:
    """An answer that the app shows to the person with the phone."""
    return Response(text, status_code=SHOWN, media_type="text/plain")


def lacking(readings: Readings) -> str | None:
    """What to switch on in the app; None if a message holds all that is needed."""
    names = missing(readings)
    if not names:
        return None
    return f"Isodyn cannot work without: {', '.join(names)}. Switch it on in the app, and record anew."
