"""From an MQTT broker to the service: messages of Sensor Logger, each posted once the broker has it safe.

A message is acknowledged only after the service answered 2xx, or refused it for good; until then the broker keeps it
(QoS 1, persistent session). What the broker sends twice the service recognises by its ``messageId``.
"""

from __future__ import annotations

import contextlib
import json
import queue
import random
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal
from urllib.parse import quote, unquote, urlsplit

import httpx

from isodyn_client.connection import Connection
from isodyn_client.errors import BridgeError
from isodyn_client.retry import RetryPolicy, retry_after

QOS = 1
MAX_WAITING = 1000
"""Messages of QoS 0 that wait here; what comes beyond is lost. With QoS 1 the broker holds back what is not
acknowledged."""
ANY_DEVICE = "*"
_PORTS = {"mqtt": 1883, "mqtts": 8883, "ws": 8000, "wss": 8884}
_REMARK = 499
"""With words for the person with the phone: a message that is of no use, or that was stored and lacks something."""
_PASSING = frozenset({408, 425, 429, 500, 502, 503, 504})


@dataclass(frozen=True, slots=True)
class Broker:
    """Where the messages come from; ``scheme`` is ``mqtt``, ``mqtts``, ``ws`` or ``wss``."""

    scheme: str
    host: str
    port: int
    user: str | None = None
    password: str | None = None

    @classmethod
    def parse(cls, url: str, password: str | None = None) -> Broker:
        """``mqtt://user:password@host:1883``; the password may come from elsewhere."""
        parts = urlsplit(url if "://" in url else f"mqtt://{url}")
        if parts.scheme not in _PORTS or not parts.hostname:
            raise BridgeError(f"broker {url!r} is no address; give {', '.join(f'{one}://HOST:PORT' for one in _PORTS)}")
        try:
            port = parts.port or _PORTS[parts.scheme]
        except ValueError as error:
            raise BridgeError(f"broker {url!r}: {error}; give a port from 1 to 65535") from error
        user = unquote(parts.username) if parts.username else None
        given = unquote(parts.password) if parts.password else None
        return cls(parts.scheme, parts.hostname, port, user, password or given)

    @property
    def encrypted(self) -> bool:
        """Whether the connection is over TLS."""
        return self.scheme in ("mqtts", "wss")

    @property
    def transport(self) -> Literal["tcp", "websockets"]:
        """What paho calls the transport."""
        return "websockets" if self.scheme in ("ws", "wss") else "tcp"


@dataclass(slots=True)
class Counts:
    """What became of the messages."""

    taken: int = 0
    remarked: int = 0
    refused: int = 0
    lost: int = 0
    retries: int = 0


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it came; ``connection`` counts the connections to the broker."""

    payload: bytes
    mid: int
    qos: int
    connection: int


class Poster:
    """Posts messages to the service with the token of the device they come from.

    Parameters
    ----------
    url : str
        Address of the service.
    tokens : mapping
        ``deviceId`` to ingest token; ``*`` is for all others.
    sleep : callable
        Waits so many seconds, or less when the bridge is stopped; returns True if it is.
    """

    def __init__(
        self,
        url: str,
        tokens: Mapping[str, str],
        *,
        sleep: Callable[[float], bool],
        policy: RetryPolicy = RetryPolicy(base_s=0.5, max_pause_s=30.0),  # noqa: B008  # frozen
        transport: httpx.BaseTransport | None = None,
        say: Callable[[str], None] = lambda _: None,
        rng: random.Random | None = None,
    ) -> None:
        if not tokens:
            raise BridgeError("no ingest token; make one with POST /v1/ingest-tokens and name it with --tokens")
        self.counts = Counts()
        self._tokens = dict(tokens)
        self._sleep = sleep
        self._policy = policy
        self._say = say
        self._rng = rng or random.Random()
        # the token is the credential: no API key goes along
        options = Connection(url.rstrip("/"), None, 30.0).options()
        self._http = httpx.Client(transport=transport, **options)

    def close(self) -> None:
        """Close the connections to the service."""
        self._http.close()

    def post(self, payload: bytes) -> bool:
        """Post one message until the service has taken or refused it; False if the bridge was stopped before."""
        token, fault = self._token_for(payload)
        if token is None:
            self._refuse(fault)
            return True
        attempt = 0
        while True:
            status, words, asked_for = self._once(token, payload)
            if 200 <= status < 300:
                self.counts.taken += 1
                return True
            if status == _REMARK:
                self.counts.remarked += 1
                self._say(f"the service says: {words}")
                return True
            if status and status not in _PASSING:
                self._refuse(f"the service refused a message: {status} {words}")
                return True
            self.counts.retries += 1
            pause = self._policy.pause_s(min(attempt, 16), self._rng, asked_for)
            self._say(f"the service does not take messages now ({words}); again in {pause:.1f} s")
            if self._sleep(pause):
                return False
            attempt += 1

    def _once(self, token: str, payload: bytes) -> tuple[int, str, float | None]:
        """Status (0: no answer), words, and for how many seconds to stay away."""
        path = f"/v1/ingest/sensor-logger/{quote(token, safe='')}"
        try:
            answer = self._http.post(path, content=payload, headers={"Content-Type": "application/json"})
        except httpx.TransportError as error:
            return 0, str(error) or type(error).__name__, None
        return answer.status_code, answer.text[:200].replace("\n", " "), retry_after(answer)

    def _token_for(self, payload: bytes) -> tuple[str | None, str]:
        try:
            message: Any = json.loads(payload)
        except ValueError as error:
            return None, f"a message is no JSON: {error}"
        if not isinstance(message, dict):
            return None, "a message is no JSON object"
        device = str(message.get("deviceId", ""))
        token = self._tokens.get(device) or self._tokens.get(ANY_DEVICE)
        return token, f"no ingest token for deviceId {device[:60]!r}; add it to the tokens file"

    def _refuse(self, words: str) -> None:
        self.counts.refused += 1
        self._say(words)


@dataclass
class MqttBridge:
    """Takes messages from a broker and posts them, one after the other.

    Attributes
    ----------
    broker : Broker
    topic : str
        May hold the wildcards ``+`` and ``#``.
    poster : Poster
    client_id : str
        Names the persistent session at the broker: the same one goes on where it stopped.
    """

    broker: Broker
    topic: str
    poster: Poster
    stopped: threading.Event
    client_id: str = "isodyn-bridge"
    say: Callable[[str], None] = lambda _: None
    _waiting: queue.Queue[Message] = field(default_factory=queue.Queue)
    _connection: int = 0

    def run(self) -> None:
        """Until ``stopped`` is set; what is not acknowledged by then the broker keeps for the next time."""
        client = self._client()
        client.connect_async(self.broker.host, self.broker.port)
        client.loop_start()
        try:
            while not self.stopped.is_set():
                with contextlib.suppress(queue.Empty):
                    self._handle(client, self._waiting.get(timeout=0.2))
        finally:
            client.disconnect()
            client.loop_stop()

    def _handle(self, client: Any, message: Message) -> None:
        if message.qos and message.connection != self._connection:
            return  # the broker sends it again on the new connection
        if self.poster.post(message.payload) and message.qos and message.connection == self._connection:
            client.ack(message.mid, message.qos)

    def _client(self) -> Any:
        try:
            from paho.mqtt import client as paho
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as error:
            raise BridgeError("MQTT needs paho-mqtt: pip install paho-mqtt") from error
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id=self.client_id,
            clean_session=False,
            transport=self.broker.transport,
            manual_ack=True,
        )
        if self.broker.user is not None:
            client.username_pw_set(self.broker.user, self.broker.password)
        if self.broker.encrypted:
            client.tls_set()
        client.reconnect_delay_set(1, 30)
        client.on_connect = self._connected
        client.on_connect_fail = lambda *_: self.say(f"no connection to {self.broker.host}:{self.broker.port} yet")
        client.on_disconnect = self._disconnected
        client.on_message = self._arrived
        return client

    def _connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self.say(f"the broker refuses: {reason}")
            return
        self._connection += 1
        client.subscribe(self.topic, qos=QOS)
        self.say(f"connected to {self.broker.host}:{self.broker.port}, topic {self.topic}")

    def _disconnected(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if not self.stopped.is_set():
            self.say(f"the broker is away ({reason}); trying again")

    def _arrived(self, _client: Any, _data: Any, message: Any) -> None:
        if not message.qos and self._waiting.qsize() >= MAX_WAITING:
            self.poster.counts.lost += 1  # the broker has forgotten it, and waiting here would lose the link
            return
        self._waiting.put(Message(bytes(message.payload), message.mid, message.qos, self._connection))
