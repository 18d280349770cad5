"""Sensor Logger's messages through a real broker and a real service: a walk becomes a session."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

from app.cli.process import free_port
from app.evaluation.datasets.ilc20 import Ilc20Level
from tests.cli.conftest import SAMPLE, Service, Surveyed, run
from tests.support.phones import sensor_logger_messages
from tests.support.programs import program

DEADLINE_S = 30.0


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    """Port of a broker of its own."""
    port = free_port()
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
    process = subprocess.Popen(
        [program("mosquitto"), "-c", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    yield port
    process.terminate()
    process.wait(DEADLINE_S)


def connected(port: int) -> paho.Client:
    client = paho.Client(CallbackAPIVersion.VERSION2)
    ready = threading.Event()
    client.on_connect = lambda *_: ready.set()
    client.reconnect_delay_set(1, 1)
    client.connect_async("127.0.0.1", port)
    client.loop_start()
    assert ready.wait(DEADLINE_S)
    return client


def test_a_phone_behind_a_broker_is_located(service: Service, surveyed: Surveyed, broker: int, tmp_path: Path) -> None:
    walk = next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))
    bodies = sensor_logger_messages(walk.samples)
    device = json.loads(bodies[0])["deviceId"]
    headers = {"X-API-Key": service.key}
    pause = threading.Event()

    with httpx.Client(base_url=service.url, headers=headers, trust_env=False) as api:

        def ok(method: str, path: str, **more: Any) -> Any:
            answer = api.request(method, path, **more)
            assert answer.is_success, answer.text
            return answer.json()

        device_id = ok("POST", "/v1/devices", json={"name": "phone"})["id"]
        token = ok(
            "POST",
            "/v1/ingest-tokens",
            json={
                "name": "phone", "app": "sensor-logger", "device_id": device_id, "level_id": surveyed.level_id,
                "prior": {"x": float(walk.waypoints.x[0]), "y": float(walk.waypoints.y[0]), "radius_m": 3.0},
            },
        )  # fmt: skip
        tokens = tmp_path / "tokens.json"
        tokens.write_text(json.dumps({device: token["token"]}))

        def recordings() -> list[dict[str, Any]]:
            found: list[dict[str, Any]] = ok("GET", "/v1/recordings", params={"token_id": token["id"]})["items"]
            return found

        def until(done: Callable[[], bool]) -> None:
            for _ in range(int(DEADLINE_S / 0.05)):
                if done():
                    return
                pause.wait(0.05)

        def phone() -> None:
            client = connected(broker)
            # again until the bridge has subscribed: a repeated message is one message
            until(lambda: bool(client.publish("sensor-logger", bodies[0], qos=1) and recordings()))
            for body in bodies[1:]:
                client.publish("sensor-logger", body, qos=1).wait_for_publish(DEADLINE_S)
            until(lambda: recordings()[0]["n_messages"] == len(bodies))
            client.disconnect()
            client.loop_stop()
            os.kill(os.getpid(), 15)

        thread = threading.Thread(target=phone)
        thread.start()
        done = run(
            "bridge", "mqtt", "--broker", f"mqtt://127.0.0.1:{broker}", "--tokens", tokens, ISODYN_URL=service.url
        )
        thread.join()
        assert done.exit_code == 0, done.output
        (recording,) = recordings()
        assert recording["n_messages"] == len(bodies), done.stderr
        closed = ok("POST", f"/v1/recordings/{recording['id']}/close")
        assert (closed["state"], closed["problem"]) == ("closed", "")
    with service.client() as client:
        session = client.session_info(closed["session_id"])
        client.wait_for_segment(session.id, session.next_seq - 1)
        assert len(client.positions(session.id)) > 20
    assert ", 0 refused, 0 lost" in done.stderr
