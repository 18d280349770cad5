"""Where lines of a logger come from: a file, a pipe, datagrams, a serial line.

A source is an iterator of lists of lines; an empty list says that nothing came for a moment.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from app.cli.errors import CommandError, InputFileError

Lines = Iterator[list[str]]
TICK_S = 0.2
MAX_LINE = 64 * 1024
_BUFFER = 4 * 2**20
_CHUNK = 256
"""Lines of a file that are handed on at a time."""


class LineSplitter:
    """Whole lines of bytes that come in pieces; what is no line after 64 KiB is given up."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[str]:
        """Lines that are complete now."""
        *lines, self._rest = (self._rest + piece).replace(b"\r\n", b"\n").split(b"\n")
        if len(self._rest) > MAX_LINE:
            self._rest = b""
        return [line.decode("utf-8", "replace") for line in lines]


def file_lines(path: Path) -> Lines:
    """Lines of a file, or of standard input for ``-``."""
    if str(path) == "-":
        yield from _stream_lines(sys.stdin.buffer, path)
    else:
        with path.open("rb") as file:
            yield from _stream_lines(file, path)


def _stream_lines(file: BinaryIO, path: Path) -> Lines:
    batch: list[str] = []
    while raw := file.readline(MAX_LINE + 1):
        if len(raw) > MAX_LINE:
            raise InputFileError(path, f"has a line longer than {MAX_LINE} bytes; is this a text file?")
        batch.append(raw.decode("utf-8", "replace"))
        if len(batch) >= _CHUNK:
            yield batch
            batch = []
    yield batch


class UdpLines:
    """Datagrams, each a line or several."""

    def __init__(self, host: str, port: int) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
        )[0]
        self._socket = socket.socket(family, kind, protocol)
        # while a segment is written to disk nobody reads: the kernel keeps what comes, as far as it may
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._socket.bind(address)
        self._socket.settimeout(TICK_S)

    @property
    def port(self) -> int:
        """Port that is listened on."""
        return int(self._socket.getsockname()[1])

    def __iter__(self) -> Lines:
        with self._socket:
            while True:
                received: list[str] = []
                with contextlib.suppress(TimeoutError):
                    received = self._socket.recv(65_535).decode("utf-8", "replace").splitlines()
                yield received


def serial_lines(device: str, baud: int) -> Lines:
    """Lines of a serial port.

    The first line is most likely the rest of one, and half a time is a wrong one: it is left out unless it is a header.
    """
    try:
        import serial
    except ImportError as error:
        raise CommandError("a serial line needs pyserial: pip install 'isodyn[serial]'") from error

    splitter, begun = LineSplitter(), False
    with serial.Serial(device, baud, timeout=TICK_S) as port:
        while True:
            lines = splitter.feed(port.read(max(1, port.in_waiting)))
            if lines and not begun:
                begun = True
                lines = lines if lines[0][:1].isalpha() else lines[1:]
            yield lines
