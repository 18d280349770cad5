"""From a real broker to a stub of the service: nothing is acknowledged before the service has it."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from isodyn_client import BridgeError
from isodyn_client.bridges.mqtt import Broker, MqttBridge, Poster
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
DEADLINE_S = 20.0
needs_broker = pytest.mark.skipif(
    MOSQUITTO is None and not os.environ.get("ISODYN_REQUIRE_SERVERS"), reason="mosquitto is not installed"
)


def message(number: int, device: str = "phone-1") -> bytes:
    return json.dumps({"messageId": number, "sessionId": "s", "deviceId": device, "payload": []}).encode()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Stub:
    """The service's ingest path: answers as it is told (200 when told nothing) and remembers what it took."""

    statuses: list[int] = field(default_factory=list)
    seen: list[tuple[str, int]] = field(default_factory=list)
    taken: list[int] = field(default_factory=list)
    changed: threading.Condition = field(default_factory=threading.Condition)
    url: str = ""

    def answer(self, path: str, body: bytes) -> int:
        with self.changed:
            status = self.statuses.pop(0) if self.statuses else 200
            number = json.loads(body)["messageId"]
            self.seen.append((path, status))
            if status == 200:
                self.taken.append(number)
            self.changed.notify_all()
            return status

    def wait(self, done: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(done, DEADLINE_S), (self.seen, self.taken)


@pytest.fixture
def stub() -> Iterator[Stub]:
    made = Stub()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            assert self.headers["Authorization"] is None
            self.send_response(made.answer(self.path, body))
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    made.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield made
    server.shutdown()
    thread.join()
    server.server_close()


class Mosquitto:
    """A broker on a port of its own that may be stopped and started again; it keeps its sessions on disk."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.config = folder / "mosquitto.conf"
        self.config.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence true\n"
            f"persistence_location {folder}/\nuser root\n"
        )
        self.process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        assert MOSQUITTO is not None
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self.config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        publisher(self.port).disconnect()

    def stop(self) -> None:
        if self.process is not None:
            self.process.terminate()
            self.process.wait(DEADLINE_S)
            self.process = None


def publisher(port: int) -> paho.Client:
    """A connected client; tries until the broker listens."""
    client = paho.Client(CallbackAPIVersion.VERSION2, client_id=f"publisher-{port}")
    connected = threading.Event()
    client.on_connect = lambda *_: connected.set()
    client.reconnect_delay_set(1, 1)
    client.connect_async("127.0.0.1", port)
    client.loop_start()
    assert connected.wait(DEADLINE_S)
    return client


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path)
    yield made
    made.stop()


class Running:
    """A bridge in a thread of its own."""

    def __init__(self, port: int, url: str, *, topic: str = "sensor-logger", retry_s: float = 0.02) -> None:
        self.stopped, self.said = threading.Event(), []
        self.connected = threading.Event()

        def sleep(_: float) -> bool:
            return self.stopped.wait(retry_s)

        def say(text: str) -> None:
            self.said.append(text)
            if text.startswith("connected"):
                self.connected.set()

        self.poster = Poster(url, {"phone-1": "tok/1"}, sleep=sleep, say=say)
        bridge = MqttBridge(Broker("mqtt", "127.0.0.1", port), topic, self.poster, self.stopped, say=say)
        self.thread = threading.Thread(target=bridge.run)
        self.thread.start()
        assert self.connected.wait(DEADLINE_S), self.said

    said: list[str]

    def stop(self) -> None:
        self.stopped.set()
        self.thread.join(DEADLINE_S)
        assert not self.thread.is_alive()
        self.poster.close()


@pytest.fixture
def running() -> Iterator[list[Running]]:
    """Bridges that are stopped at the end, whatever happens."""
    made: list[Running] = []
    yield made
    for one in made:
        one.stop()


def publish(port: int, *payloads: bytes, qos: int = 1, topic: str = "sensor-logger") -> None:
    client = publisher(port)
    for payload in payloads:
        client.publish(topic, payload, qos=qos).wait_for_publish(DEADLINE_S)
    client.disconnect()
    client.loop_stop()


@needs_broker
def test_messages_arrive_in_order_with_their_token(broker: Mosquitto, stub: Stub, running: list[Running]) -> None:
    running.append(Running(broker.port, stub.url))
    publish(broker.port, *[message(i) for i in range(20)])
    publish(broker.port, message(20), qos=0)
    stub.wait(lambda: len(stub.taken) == 21)
    assert stub.taken == list(range(21))
    assert {path for path, _ in stub.seen} == {"/v1/ingest/sensor-logger/tok%2F1"}


@needs_broker
def test_a_service_that_is_away_loses_nothing(broker: Mosquitto, stub: Stub, running: list[Running]) -> None:
    running.append(Running(broker.port, stub.url))
    stub.statuses += [503, 500, 200, 429, 200]
    publish(broker.port, *[message(i) for i in range(4)])
    stub.wait(lambda: len(stub.taken) == 4)
    assert stub.taken == [0, 1, 2, 3]
    assert [status for _, status in stub.seen] == [503, 500, 200, 429, 200, 200, 200]
    assert running[0].poster.counts.retries == 3


@needs_broker
def test_what_was_not_acknowledged_comes_to_the_next_bridge(
    broker: Mosquitto, stub: Stub, running: list[Running]
) -> None:
    stub.statuses += [503] * 100_000
    first = Running(broker.port, stub.url)
    running.append(first)
    publish(broker.port, message(0), message(1))
    stub.wait(lambda: len(stub.seen) > 3)
    running.remove(first)
    first.stop()
    publish(broker.port, message(2))  # while no bridge is there
    with stub.changed:
        stub.statuses.clear()
    running.append(Running(broker.port, stub.url))
    stub.wait(lambda: len(stub.taken) >= 3)
    assert stub.taken == [0, 1, 2]


@needs_broker
def test_a_broker_that_restarts_loses_nothing(broker: Mosquitto, stub: Stub, running: list[Running]) -> None:
    running.append(Running(broker.port, stub.url))
    publish(broker.port, message(0))
    stub.wait(lambda: stub.taken == [0])
    with stub.changed:
        stub.statuses += [503] * 100_000
    publish(broker.port, message(1))
    stub.wait(lambda: len(stub.seen) > 2)
    running[0].connected.clear()
    broker.stop()
    broker.start()
    assert running[0].connected.wait(DEADLINE_S)
    with stub.changed:
        stub.statuses.clear()
    publish(broker.port, message(2))
    stub.wait(lambda: 2 in stub.taken)
    assert sorted(set(stub.taken)) == [0, 1, 2]


@needs_broker
def test_what_cannot_be_read_is_counted_and_does_not_come_again(
    broker: Mosquitto, stub: Stub, running: list[Running]
) -> None:
    first = Running(broker.port, stub.url, topic="phones/+")
    running.append(first)
    stub.statuses += [422]
    for payload in (message(0), b"not JSON", b"[1]", message(9, device="unknown"), message(1)):
        publish(broker.port, payload, topic="phones/a")
    stub.wait(lambda: stub.taken == [1])
    running.remove(first)
    first.stop()
    assert (first.poster.counts.taken, first.poster.counts.refused) == (1, 4)
    assert any("422" in text for text in first.said)
    assert any("'unknown'" in text for text in first.said)
    running.append(Running(broker.port, stub.url, topic="phones/+"))
    publish(broker.port, message(2), topic="phones/a")
    stub.wait(lambda: 2 in stub.taken)
    assert stub.taken == [1, 2]


def test_the_pauses_grow_and_respect_retry_after() -> None:
    answers = [httpx.Response(503), httpx.Response(429, headers={"Retry-After": "9"}), httpx.ConnectError("x"),
               httpx.Response(503), httpx.Response(204)]  # fmt: skip
    pauses: list[float] = []

    def handle(_: httpx.Request) -> httpx.Response:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def sleep(seconds: float) -> bool:
        pauses.append(seconds)
        return False

    poster = Poster("http://s.test", {"*": "t"}, sleep=sleep, transport=httpx.MockTransport(handle))
    assert poster.post(message(0))
    assert pauses[1] == 9.0
    assert pauses[0] < pauses[2] < pauses[3]
    poster.close()


def test_remarks_are_told_and_not_asked_for_again() -> None:
    said: list[str] = []
    transport = httpx.MockTransport(lambda _: httpx.Response(499, text="switch on the gyroscope"))
    poster = Poster("http://s.test", {"*": "t"}, sleep=lambda _: True, transport=transport, say=said.append)
    assert poster.post(message(0))
    assert (poster.counts.remarked, poster.counts.taken, poster.counts.refused) == (1, 0, 0)
    assert "gyroscope" in said[0]
    poster.close()


def test_a_stop_in_the_middle_acknowledges_nothing() -> None:
    transport = httpx.MockTransport(lambda _: httpx.Response(503))
    poster = Poster("http://s.test", {"*": "t"}, sleep=lambda _: True, transport=transport)
    assert not poster.post(message(0))
    assert poster.counts.taken == poster.counts.refused == 0
    poster.close()


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("mqtt://h", Broker("mqtt", "h", 1883)),
        ("h:1884", Broker("mqtt", "h", 1884)),
        ("mqtts://u:p%40@h", Broker("mqtts", "h", 8883, "u", "p@")),
        ("ws://[::1]:9", Broker("ws", "::1", 9)),
    ],
)
def test_addresses(url: str, expected: Broker) -> None:
    assert Broker.parse(url) == expected


def test_a_password_from_elsewhere_wins() -> None:
    assert Broker.parse("mqtt://u:p@h", "q").password == "q"
    assert (Broker.parse("wss://h").transport, Broker.parse("wss://h").encrypted) == ("websockets", True)


@pytest.mark.parametrize("url", ["http://h", "mqtt://", "mqtt://h:99999"])
def test_other_addresses_are_refused(url: str) -> None:
    with pytest.raises(BridgeError, match="give"):
        Broker.parse(url)


def test_without_a_token_there_is_no_bridge() -> None:
    with pytest.raises(BridgeError, match="ingest-tokens"):
        Poster("http://s.test", {}, sleep=lambda _: True)
