"""Files and bridges through the command line, against a real service."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import socket
import threading
import xml.etree.ElementTree as ET
from pathlib import Path

import httpx
import isodyn_client as isodyn
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from isodyn_client.bridges import Georeference
from isodyn_client.follow import Follower

from app.cli.bridging import host_and_port, read_tokens, until_stopped
from app.cli.convert import samples_of
from app.cli.errors import InputFileError
from app.engine.geodesy import TangentPlane
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed, run

ANCHOR = isodyn.Anchor(latitude_deg=31.2, longitude_deg=121.4, bearing_deg=20.0)


@pytest.fixture(scope="module")
def walked(service: Service, surveyed: Surveyed) -> isodyn.SessionInfo:
    """A closed session of a device on a level that has an anchor."""
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]))
    with service.client() as client:
        client.update_venue(client.level(surveyed.level_id).venue_id, anchor=ANCHOR)
        device = client.create_device("cart")
        with client.open_session(surveyed.level_id, prior=start, device_id=device.id) as session:
            list(session.send_all(samples_of(walk.samples), wait=20))
        return client.session_info(session.id)


@given(st.floats(-85, 85), st.floats(-180, 180), st.floats(0, 360), st.floats(-3000, 3000), st.floats(-3000, 3000))
def test_the_client_places_like_the_service(lat: float, lon: float, bearing: float, x: float, y: float) -> None:
    anchor = isodyn.Anchor(latitude_deg=lat, longitude_deg=lon, bearing_deg=bearing, height_m=100.0)
    longitude, latitude = TangentPlane(lat, lon, bearing, 100.0).to_wgs84(x, y)
    assert Georeference(anchor).degrees(x, y) == (latitude, longitude)


@pytest.mark.parametrize("form", ["geojson", "mf-json", "gpx", "csv"])
def test_a_track_is_written(service: Service, walked: isodyn.SessionInfo, tmp_path: Path, form: str) -> None:
    file = tmp_path / "track"
    said = service.isodyn("session", "export", walked.id, "--format", form, "-o", file).stderr
    assert str(file.stat().st_size) in said
    with service.client() as client:
        assert file.read_bytes() == client.track(walked.id, format=form)
        told = client.positions(walked.id)
    if form == "gpx":
        points = ET.parse(file).getroot().findall(".//{*}trkpt")
        assert len(points) == sum(status is isodyn.Status.OK for status in told.status)
        assert len(points) > 10


def sentences(text: str, name: str) -> list[list[str]]:
    return [line.split("*")[0].split(",") for line in text.splitlines() if line.startswith(name)]


def test_nmea_of_a_session_that_is_over(service: Service, walked: isodyn.SessionInfo) -> None:
    done = service.isodyn("bridge", "nmea", "--session", walked.id, "--from-start", "--stdout")
    with service.client() as client:
        told = client.positions(walked.id)
    gga = sentences(done.stdout, "$GPGGA")
    assert [row[6] == "6" for row in gga] == told.sure.tolist()
    assert sum(told.sure) > 5
    place = TangentPlane(ANCHOR.latitude_deg, ANCHOR.longitude_deg, ANCHOR.bearing_deg)
    for i, row in enumerate(gga):
        if row[6] == "6":
            longitude, latitude = place.to_wgs84(float(told.x[i]), float(told.y[i]))
            assert int(row[2][:2]) + float(row[2][2:]) / 60 == pytest.approx(latitude, abs=1.1e-7)
            assert int(row[4][:3]) + float(row[4][3:]) / 60 == pytest.approx(longitude, abs=1.1e-7)
    sd = [(float(row[6]), float(row[7])) for row in sentences(done.stdout, "$GPGST") if row[6]]
    assert sd == [pytest.approx((north, east), abs=0.006) for north, east in _deviations(told) if north]
    assert f"{len(told)} fixes passed on, {sum(told.sure)} of them with a position" in done.stderr


def _deviations(told: isodyn.Fixes) -> list[tuple[float, float]]:
    b = math.radians(ANCHOR.bearing_deg)
    found = []
    for (xx, xy), (_, yy) in told.covariance[told.sure]:
        north = xx * math.sin(b) ** 2 - 2 * xy * math.sin(b) * math.cos(b) + yy * math.cos(b) ** 2
        east = xx * math.cos(b) ** 2 + 2 * xy * math.sin(b) * math.cos(b) + yy * math.sin(b) ** 2
        found.append((math.sqrt(north), math.sqrt(east)))
    return found


def test_mavlink_goes_out_as_datagrams(service: Service, walked: isodyn.SessionInfo) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10)
        address = f"127.0.0.1:{receiver.getsockname()[1]}"
        service.isodyn("bridge", "mavlink", "--session", walked.id, "--from-start", "--udp", address, "--unsure")
        first = receiver.recv(300)
    assert (first[0], int.from_bytes(first[7:10], "little")) == (0xFD, 232)


def test_a_bridge_follows_a_device_and_stops_on_request(
    service: Service, surveyed: Surveyed, walked: isodyn.SessionInfo
) -> None:
    """Sentences come while the session goes on; SIGTERM ends the bridge in order."""
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(30)
        address = f"127.0.0.1:{receiver.getsockname()[1]}"
        received: list[bytes] = []

        def drive() -> None:
            with (
                service.client() as client,
                client.open_session(surveyed.level_id, prior=start, device_id=walked.device_id) as session,
            ):
                pieces = session.send_all(samples_of(walk.samples), wait=20)
                for _ in range(2):
                    next(pieces)
                    received.append(receiver.recv(300))
                # while the session goes on: the bridge waits for more
                os.kill(os.getpid(), 15)

        driver = threading.Thread(target=drive)
        driver.start()
        done = service.isodyn("bridge", "nmea", "--device", str(walked.device_id), "--udp", address, "--poll", "0.1")
        driver.join()
    assert all(one.startswith(b"$GPGGA") for one in received)
    assert len(received) == 2
    assert "stopped" in done.stderr
    assert "fixes passed on" in done.stderr


def test_a_request_to_stop_is_not_lost_while_something_is_cleaned_up() -> None:
    """An exception out of a signal handler vanishes if it is raised in a finalizer."""
    with until_stopped() as stop:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        stop.check()
        pytest.fail("the loop went on")


def test_a_venue_without_an_anchor_is_explained(service: Service, surveyed: Surveyed) -> None:
    with service.client() as client:
        venue_id = client.level(surveyed.level_id).venue_id
        venue = client.venue(venue_id)
        try:
            with client.open_session(surveyed.level_id) as session:
                walk = Ilc20Level("site1-F2", SAMPLE).walks("train")[0]
                next(session.send_all(samples_of(walk.samples), wait=20))
            headers = {"X-API-Key": service.key}
            path = f"{service.url}/v1/venues/{venue_id}"
            httpx.patch(path, json={"anchor": None}, headers=headers, trust_env=False).raise_for_status()
            refused = run(
                "bridge", "nmea", "--session", session.id, "--stdout", "--from-start",
                ISODYN_URL=service.url, ISODYN_KEY=service.key,
            )  # fmt: skip
            assert refused.exit_code == 1
            assert "has no anchor" in refused.output
        finally:
            client.update_venue(venue_id, anchor=venue.anchor)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("nmea", "--stdout"), "--session or --device"),
        (("nmea", "--session", "s"), "say where to write"),
        (("nmea", "--session", "s", "--stdout", "--udp", "h:1"), "say where to write"),
        (("nmea", "--session", "s", "--udp", "h"), "HOST:PORT"),
        (("nmea", "--session", "s", "--stdout", "--talker", "gps"), "talker"),
        (("nmea", "--session", "s", "--stdout", "--sentences", "GLL"), "GGA, RMC, GST"),
        (("mqtt", "--broker", "mqtt://h"), "--tokens or --token-env"),
        (("mqtt", "--broker", "mqtt://h", "--token-env", "NO_SUCH_VARIABLE"), "NO_SUCH_VARIABLE is not set"),
    ],
)
def test_options_that_do_not_fit_are_explained(options: tuple[str, ...], words: str) -> None:
    result = run("bridge", *options)
    assert result.exit_code == 2
    assert words in " ".join(result.output.replace("│", " ").split())


def test_addresses_in_words() -> None:
    assert host_and_port("h:1") == ("h", 1)
    assert host_and_port("[::1]:10110") == ("::1", 10110)
    assert host_and_port("10110", default_host="127.0.0.1") == ("127.0.0.1", 10110)
    for text in ("h", "h:", ":1", "h:99999", "h:x"):
        with pytest.raises(typer.BadParameter):
            host_and_port(text)


def test_tokens_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "tokens.json"
    file.write_text(json.dumps({"phone": "t"}))
    assert read_tokens(file, None) == {"phone": "t"}
    for text in ("{", "[]", "{}", '{"a": 1}'):
        file.write_text(text)
        with pytest.raises(InputFileError, match=r"tokens\.json"):
            read_tokens(file, None)


def test_a_session_is_followed_by_its_events(service: Service, surveyed: Surveyed) -> None:
    """Without one question for positions, from the first fix to the last, and again from the middle."""
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    start = isodyn.Prior(x=float(walk.waypoints.x[0]), y=float(walk.waypoints.y[0]))
    asked: list[str] = []

    class Watching(httpx.HTTPTransport):
        def handle_request(self, request: httpx.Request) -> httpx.Response:
            asked.append(request.url.path.rpartition("/")[2])
            return super().handle_request(request)

    with service.client() as client, isodyn.Client(service.url, service.key, transport=Watching()) as watcher:
        session = client.open_session(surveyed.level_id, prior=start)
        batches = Follower(watcher, session.id).batches()
        found: list[int] = []
        for _ in session.send_all(samples_of(walk.samples), wait=20):
            found += [fix.number for fix in next(batch for batch in batches if batch)]
        assert "events" in asked
        assert "positions" not in asked
        session.close()
        found += [fix.number for batch in batches for fix in batch]
        told = session.positions()
        assert found == list(range(len(told)))
        middle = len(told) // 2
        later = [fix for batch in Follower(watcher, session.id, middle).batches() for fix in batch]
        assert [fix.number for fix in later] == list(range(middle + 1, len(told)))
        assert [fix.x for fix in later] == told.x[middle + 1 :].tolist()
