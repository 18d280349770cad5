"""The example node, with stand-ins for ROS: what it publishes, field by field."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

import httpx
import isodyn_client
import pytest
from test_client_follow import VENUE, N, Server

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2" / "isodyn_node.py"


class Message:
    """A message without definition: whatever is set is kept."""


class Publisher:
    def __init__(self, kind: type, topic: str) -> None:
        self.kind, self.topic, self.published = kind, topic, []  # type: ignore[var-annotated]

    def publish(self, message: Any) -> None:
        assert isinstance(message, self.kind)
        self.published.append(message)


class Node:
    parameters: dict[str, str] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.name = name
        self.publishers: dict[str, Publisher] = {}

    def declare_parameter(self, name: str, default: str) -> Any:
        return types.SimpleNamespace(value=self.parameters.get(name, default))

    def create_publisher(self, kind: type, topic: str, depth: int) -> Publisher:
        return self.publishers.setdefault(topic, Publisher(kind, topic))

    def get_logger(self) -> Any:
        return types.SimpleNamespace(warning=lambda text: None)


def set_message_fields(message: Any, values: dict[str, Any]) -> None:
    vars(message).update(values)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Any:
    def module(name: str, **members: Any) -> None:
        made = types.ModuleType(name)
        vars(made).update(members)
        monkeypatch.setitem(sys.modules, name, made)

    module("rclpy")
    module("rclpy.node", Node=Node)
    module("geometry_msgs")
    module("geometry_msgs.msg", PoseWithCovarianceStamped=type("Pose", (Message,), {}))
    module("sensor_msgs")
    module("sensor_msgs.msg", NavSatFix=type("NavSatFix", (Message,), {}))
    module("rosidl_runtime_py")
    module("rosidl_runtime_py.set_message", set_message_fields=set_message_fields)
    spec = importlib.util.spec_from_file_location("isodyn_node", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@pytest.mark.parametrize("anchored", [True, False])
def test_every_fix_is_published_once(example: Any, monkeypatch: pytest.MonkeyPatch, anchored: bool) -> None:
    server = Server(None)
    venue = VENUE if anchored else VENUE | {"anchor": None}

    def handle(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, json=venue) if "/venues/" in request.url.path else server.handle(request)

    made = isodyn_client.Client("http://s.test", "k", transport=httpx.MockTransport(handle))
    monkeypatch.setattr(isodyn_client, "Client", lambda: made)
    monkeypatch.setattr(Node, "parameters", {"session": "ses_1"})
    node = example.IsodynNode()
    node.follow()
    poses = node.publishers["pose"].published
    fixes = node.publishers["fix"].published
    # a session that is over is told from its newest segment on; the stub has one
    assert [message.pose["pose"]["position"]["x"] for message in poses] == [float(i) for i in range(N)]
    assert len(fixes) == (N if anchored else 0)
    assert all(message.status["status"] == 0 for message in fixes)
    assert all(len(message.position_covariance) == 9 for message in fixes)
