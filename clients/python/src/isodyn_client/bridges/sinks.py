"""Where a bridge writes: UDP, TCP, a serial line, a stream."""

from __future__ import annotations

import contextlib
import socket
from typing import BinaryIO, Protocol

from isodyn_client.errors import BridgeError

_BACKLOG = 8


class Sink(Protocol):
    """Takes whole messages; losing some is better than holding up the others."""

    def send(self, message: bytes) -> None:
        """Write one message."""

    def close(self) -> None:
        """Let go of it."""


class UdpSink:
    """Datagrams to an address, one a message. Nobody may be listening: that is no error."""

    def __init__(self, host: str, port: int) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._address = address
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, message: bytes) -> None:
        """One datagram."""
        # a router that is away for a moment, or a refusal of the datagram before: the next one may arrive
        with contextlib.suppress(ConnectionError, TimeoutError, BlockingIOError):
            self._socket.sendto(message, self._address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpSink:
    """Listens, and sends to all who connect. One that does not read is dropped."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self._server = socket.create_server((host, port), backlog=_BACKLOG)
        self._server.setblocking(False)
        self._readers: list[socket.socket] = []

    @property
    def port(self) -> int:
        """Port that is listened on."""
        return int(self._server.getsockname()[1])

    @property
    def n_readers(self) -> int:
        """Connections at the last message."""
        return len(self._readers)

    def send(self, message: bytes) -> None:
        """To all; who connected since the last message is among them."""
        self._accept()
        for reader in tuple(self._readers):
            try:
                whole = reader.send(message) == len(message)
            except OSError:
                whole = False
            if not whole:  # its buffer is full: half a sentence would spoil the next one
                reader.close()
                self._readers.remove(reader)

    def close(self) -> None:
        """Close all connections."""
        for one in (*self._readers, self._server):
            one.close()
        self._readers.clear()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                reader, _ = self._server.accept()
                reader.setblocking(False)
                self._readers.append(reader)


class SerialSink:
    """A serial line; needs pyserial."""

    def __init__(self, device: str, baud: int = 4800) -> None:
        try:
            import serial
        except ImportError as error:
            raise BridgeError("a serial line needs pyserial: pip install pyserial") from error
        # SerialException is an OSError: whoever called reports it with the device's name
        self._line = serial.Serial(device, baud, write_timeout=5.0)

    def send(self, message: bytes) -> None:
        """Write, and wait until it is out."""
        self._line.write(message)
        self._line.flush()

    def close(self) -> None:
        """Close the line."""
        self._line.close()


class StreamSink:
    """A stream that is open already, such as standard output."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def send(self, message: bytes) -> None:
        """Write and flush."""
        self._stream.write(message)
        self._stream.flush()

    def close(self) -> None:
        """Leave it open: it is not ours."""
