"""The experiment file that makes phyphox a client: it sends what the sensors read, and shows the answer on the phone.

Written to phyphox's file format 1.17. What it sends is read by :mod:`app.exchange.phones.phyphox`; what it shows is
what :func:`answer` tells.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from app.engine.types import Status
from app.exchange.phones.errors import FormatError
from app.exchange.phones.phyphox import COLUMNS, MANUFACTURER, MODEL, TIME, UNIQUE_ID, Columns
from app.exchange.phones.readings import Sensor

FILE_FORMAT = "1.17"
INTERVAL_S = 1.0
RATE_HZ = 100.0
_BUFFER = 12_000
"""Readings a buffer keeps while the network is away: two minutes at 100 Hz; then the oldest go."""
_TRACK = 2_000
_INPUTS: Mapping[Sensor, tuple[str, tuple[str, ...]]] = {
    Sensor.MAGNETOMETER: ("magnetic_field", ("x", "y", "z")),
    Sensor.ACCELERATION: ("accelerometer", ("x", "y", "z")),
    Sensor.GYROSCOPE: ("gyroscope", ("x", "y", "z")),
    Sensor.PRESSURE: ("pressure", ("x",)),
    Sensor.GNSS: ("location", ("lat", "lon", "accuracy")),
}
_DESCRIPTION = "Sends what the phone's sensors read of the magnetic field and of your steps; shows where you are."
WAITING, RECORDING, REFUSED = 0, 8, 9
STATUS_CODES: Mapping[Status, int] = {
    Status.OK: 1, Status.AMBIGUOUS: 2, Status.INSUFFICIENT: 3, Status.OFF_MAP: 4, Status.DISTURBED: 5,
}  # fmt: skip
_WORDS: Mapping[int, str] = {
    WAITING: "waiting for the first position",
    1: "position known",
    2: "several places fit: walk on",
    3: "not yet known: walk on",
    4: "off the map",
    5: "disturbed: iron or magnets nearby",
    RECORDING: "recording",
    REFUSED: "refused: see the service",
}
"""What the phone shows for each code; phyphox receives numbers only."""


def experiment(
    post_url: str,
    *,
    title: str = "Isodyn",
    description: str = "",
    privacy_url: str | None = None,
    location: bool = False,
    rate_hz: float = RATE_HZ,
) -> bytes:
    """The experiment file.

    Parameters
    ----------
    post_url : str
        Where the phone sends to.
    title, description : str
        Shown in the phone's list of experiments.
    privacy_url : str or None
        What the phone offers to read before it sends.
    location : bool
        Satellite fixes are sent too; the phone asks for the permission.
    rate_hz : float, Hz
        Asked of the sensors; phones give what they can.

    Raises
    ------
    FormatError
        An address that is none.
    """
    if not post_url.startswith(("http://", "https://")) or any(ord(one) <= 32 for one in post_url):
        raise FormatError("post_url", f"is {post_url[:80]!r}; name an address that begins with http:// or https://")
    sensors = [sensor for sensor in _INPUTS if location or sensor is not Sensor.GNSS]
    root = Element("phyphox", version=FILE_FORMAT, locale="en")
    _leaf(root, "title", _plain(title) or "Isodyn")
    _leaf(root, "category", "Isodyn")
    _leaf(root, "icon", "ISO")
    _leaf(root, "description", _plain(description) or _DESCRIPTION)
    _containers(root, sensors)
    _network(root, sensors, post_url, privacy_url)
    _input(root, sensors, rate_hz)
    _views(root)
    _export(root)
    indent(root)
    written: bytes = tostring(root, encoding="utf-8", xml_declaration=False)
    return written + b"\n"


def answer(code: int, *, x: float | None = None, y: float | None = None, sd: float | None = None) -> bytes:
    """What the phone is told: position (m, level frame), standard deviation (m) and a code of the status.

    Columns, for a value that is not known is an empty one: phyphox shows nothing then.
    """
    values = {"x": x, "y": y, "sd": sd}
    told = {name: [] if one is None or not math.isfinite(one) else [round(one, 3)] for name, one in values.items()}
    return json.dumps({**told, "status": [code]}).encode()


def _leaf(parent: Element, tag: str, text: str, **attributes: str) -> Element:
    element = SubElement(parent, tag, attributes)
    element.text = text
    return element


def _plain(text: str) -> str:
    """Without what XML cannot hold."""
    return "".join(one if one.isprintable() else " " for one in text).strip()[:500]


def _names(columns: Columns) -> tuple[str, ...]:
    return (*columns.values, columns.time)


def _containers(root: Element, sensors: list[Sensor]) -> None:
    containers = SubElement(root, "data-containers")
    for sensor in sensors:
        for name in _names(COLUMNS[sensor]):
            _leaf(containers, "container", name, size=str(_BUFFER))
    for name in ("x", "y", "sd", "status"):
        _leaf(containers, "container", f"{name}_now", size="1")
    for name in ("x", "y"):
        _leaf(containers, "container", f"{name}_track", size=str(_TRACK))


def _network(root: Element, sensors: list[Sensor], post_url: str, privacy_url: str | None) -> None:
    connection = SubElement(
        SubElement(root, "network"),
        "connection",
        {
            "id": "isodyn", "address": post_url, "service": "http/post", "conversion": "json",
            "interval": f"{INTERVAL_S:g}", "autoConnect": "true", **({"privacy": privacy_url} if privacy_url else {}),
        },
    )  # fmt: skip
    for sensor in sensors:
        for name in _names(COLUMNS[sensor]):
            _leaf(connection, "send", name, id=name, type="buffer", datatype="array", keep="false")
    SubElement(connection, "send", {"id": TIME, "type": "time"})
    for name in (UNIQUE_ID, MODEL, MANUFACTURER):
        _leaf(connection, "send", name, id=name, type="meta")
    for name in ("x", "y", "sd", "status"):
        _leaf(connection, "receive", f"{name}_now", id=name, append="false")
    for name in ("x", "y"):
        _leaf(connection, "receive", f"{name}_track", id=name, append="true")


def _input(root: Element, sensors: list[Sensor], rate_hz: float) -> None:
    block = SubElement(root, "input")
    for sensor in sensors:
        kind, components = _INPUTS[sensor]
        element = SubElement(block, "location") if sensor is Sensor.GNSS else _sensor(block, kind, rate_hz)
        for name, component in zip(_names(COLUMNS[sensor]), (*components, "t"), strict=True):
            _leaf(element, "output", name, component=component)


def _sensor(block: Element, kind: str, rate_hz: float) -> Element:
    if kind == "pressure":  # many phones have none
        return SubElement(block, "sensor", {"type": kind, "ignoreUnavailable": "true"})
    # "request": readings as they are, none doubled or left out to meet the rate
    return SubElement(block, "sensor", {"type": kind, "rate": f"{rate_hz:g}", "rateStrategy": "request"})


def _views(root: Element) -> None:
    view = SubElement(SubElement(root, "views"), "view", label="Position")
    status = SubElement(view, "value", label="Status", precision="0")
    _leaf(status, "input", "status_now")
    for code, words in _WORDS.items():
        _leaf(status, "map", words, min=str(code), max=str(code))
    for name, label, size in (("x", "x", "2"), ("y", "y", "2"), ("sd", "give or take", "1")):
        value = SubElement(view, "value", label=label, unit="m", precision="1", size=size)
        _leaf(value, "input", f"{name}_now")
    graph = SubElement(view, "graph", label="Track", labelX="x", unitX="m", labelY="y", unitY="m", style="dots")
    _leaf(graph, "input", "x_track", axis="x")
    _leaf(graph, "input", "y_track", axis="y")


def _export(root: Element) -> None:
    """What the phone exports by hand: the track, for what the sensors read has been sent."""
    block = SubElement(SubElement(root, "export"), "set", name="Track")
    _leaf(block, "data", "x_track", name="x (m)")
    _leaf(block, "data", "y_track", name="y (m)")
