"""A line that is cut again and again: a TCP relay whose connections die after so many bytes."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

_CHUNK = 4096
_RESET = struct.pack("ii", 1, 0)
"""SO_LINGER that makes close() reset the connection: nothing says good-bye."""


class CuttingRelay:
    """Relays connections to a local port; ``life`` gives the bytes (both ways) after which the next one is reset."""

    def __init__(self, port: int, life: Callable[[], int]) -> None:
        self.cuts = 0
        self._target = port
        self._life = life
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._serve, name="relay")

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listening.getsockname()[1]}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        with self._lock:
            for one in self._open:
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
        self._thread.join(10)
        for one in self._open:
            one.close()

    def _serve(self) -> None:
        pumps = []
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
                left = [self._life()]
                for one, other in ((near, far), (far, near)):
                    pumps.append(threading.Thread(target=self._pump, args=(one, other, left)))
                with self._lock:
                    self._open |= {near, far}
                for pump in pumps[-2:]:
                    pump.start()
        for pump in pumps:
            pump.join(10)

    def _pump(self, source: socket.socket, sink: socket.socket, left: list[int]) -> None:
        for chunk in _chunks(source):
            left[0] -= len(chunk)
            if left[0] < 0:
                self._cut(source, sink)
                return
            with contextlib.suppress(OSError):
                sink.sendall(chunk)
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _cut(self, *ends: socket.socket) -> None:
        with self._lock:
            self.cuts += 1
        for one in ends:
            with contextlib.suppress(OSError):
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)  # wakes whoever reads from it
            one.close()


def _chunks(source: socket.socket) -> Iterator[bytes]:
    with contextlib.suppress(OSError):
        while chunk := source.recv(_CHUNK):
            yield chunk
