"""What the bridges of the command line share: the loop, what it says, a clean end."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, TypeVar

import typer

from app.cli.errors import InputFileError

if TYPE_CHECKING:
    from isodyn_client.bridges.feed import DeviceFeed, SessionFeed
    from isodyn_client.bridges.place import GeoFix
    from isodyn_client.bridges.sinks import Sink

T = TypeVar("T")
_SAY_EVERY_S = 10.0


def say(text: str) -> None:
    """A line for whoever watches, on stderr: output may be piped."""
    typer.echo(text, err=True)


def checked(make: Callable[[], T]) -> T:
    """What was made of options; their faults as the command line tells them."""
    try:
        return make()
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def host_and_port(text: str, default_host: str | None = None) -> tuple[str, int]:
    """``HOST:PORT``, or ``PORT`` alone where there is a default host; IPv6 in brackets."""
    host, _, port = text.rpartition(":")
    host = host.strip("[]") or (default_host or "")
    if not host or not (port.isascii() and port.isdigit() and int(port) <= 65535):
        form = "HOST:PORT" if default_host is None else "PORT or HOST:PORT"
        raise typer.BadParameter(f"{text!r} is not {form}")
    return host, int(port)


@dataclass(slots=True)
class Stop:
    """Whether somebody asked for the end."""

    asked: bool = False

    def check(self) -> None:
        """End the block now, if that was asked for."""
        if self.asked:
            raise KeyboardInterrupt


@contextmanager
def until_stopped() -> Iterator[Stop]:
    """Ctrl-C and SIGTERM end the block, quietly; what stands behind it is still done.

    A loop should check what it is given: an exception raised while something is being cleaned up is lost.
    """
    stop = Stop()

    def leave(_number: int, _frame: FrameType | None) -> None:
        stop.asked = True
        stop.check()

    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, leave) if main else None
    try:
        yield stop
    except KeyboardInterrupt:
        say("stopped")
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)


@dataclass(slots=True)
class Account:
    """What was passed on, told now and then."""

    clock: Callable[[], float] = time.monotonic
    n: int = 0
    claimed: int = 0
    session_id: str = ""
    _next: float = field(default=0.0)

    def add(self, fix: GeoFix, session_id: str) -> None:
        """One more fix."""
        if session_id != self.session_id:
            self.session_id = session_id
            say(f"session {session_id}")
        self.n += 1
        self.claimed += fix.claimed

    def look(self) -> None:
        """Tell, if it is time."""
        if self.clock() >= self._next:
            self._next = self.clock() + _SAY_EVERY_S
            say(self.words())

    def words(self) -> str:
        """The figures."""
        return f"{self.n} fixes passed on, {self.claimed} of them with a position"


def run_bridge(
    feed: SessionFeed | DeviceFeed, encode: Callable[[GeoFix], bytes], sink: Sink, *, sure_only: bool
) -> None:
    """Pass fixes on until the session ends or someone stops it."""
    from isodyn_client.bridges.feed import anchored
    from isodyn_client.bridges.place import Georeference

    account = Account()
    places: dict[str, Georeference] = {}
    try:
        with until_stopped() as stop:
            for batch in feed.batches():
                stop.check()
                for told in batch:
                    if told.session.id not in places:
                        places = {told.session.id: Georeference(anchored(told), sure_only)}
                    fix = places[told.session.id].place(told.fix)
                    sink.send(encode(fix))
                    account.add(fix, told.session.id)
                account.look()
    finally:
        sink.close()
        say(account.words())


def read_tokens(file: Path | None, variable: str | None) -> Mapping[str, str]:
    """Ingest tokens by ``deviceId``, from a file or for all devices from the environment."""
    from isodyn_client.bridges.mqtt import ANY_DEVICE

    if (file is None) == (variable is None):
        raise typer.BadParameter("give --tokens or --token-env, one of the two")
    if variable is not None:
        if not (token := os.environ.get(variable, "").strip()):
            raise typer.BadParameter(f"the environment variable {variable} is not set")
        return {ANY_DEVICE: token}
    assert file is not None  # noqa: S101  # one of the two is given
    try:
        tokens = json.loads(file.read_text())
    except ValueError as error:
        raise InputFileError(file, f"is no JSON ({error})") from error
    if not (isinstance(tokens, dict) and tokens and all(isinstance(token, str) for token in tokens.values())):
        raise InputFileError(file, 'is not of the form {"deviceId": "ingest token"}')
    return tokens


def run_mqtt(
    broker: str, topic: str, tokens: Mapping[str, str], *, password: str | None, client_id: str, url: str
) -> None:
    """Post messages until someone stops it."""
    from isodyn_client.bridges.mqtt import Broker, MqttBridge, Poster

    stopped = threading.Event()
    poster = Poster(url, tokens, sleep=stopped.wait, say=say)
    bridge = MqttBridge(Broker.parse(broker, password), topic, poster, stopped, client_id, say)
    try:
        with until_stopped():
            bridge.run()
    finally:
        stopped.set()
        poster.close()
        counts = poster.counts
        say(
            f"{counts.taken} messages taken, {counts.remarked} with a remark, {counts.refused} refused, "
            f"{counts.lost} lost, {counts.retries} retries"
        )
