from __future__ import annotations

import io
import os
import socket

import pytest
from isodyn_client.bridges import SerialSink, StreamSink, TcpSink, UdpSink


def test_datagrams_and_nobody_listening() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        port = receiver.getsockname()[1]
        sink = UdpSink("127.0.0.1", port)
        sink.send(b"one")
        sink.send(b"two")
        assert [receiver.recv(100) for _ in range(2)] == [b"one", b"two"]
    for _ in range(5):  # the port is closed now: the refusals come back with later datagrams
        sink.send(b"three")
    sink.close()


def test_all_who_connect_get_the_next_message_whole() -> None:
    sink = TcpSink(0)
    sink.send(b"nobody\n")
    readers = [socket.create_connection(("127.0.0.1", sink.port), timeout=5) for _ in range(2)]
    sink.send(b"one\n")
    assert sink.n_readers == 2
    assert [reader.recv(100) for reader in readers] == [b"one\n"] * 2
    readers[0].close()
    for _ in range(3):
        sink.send(b"two\n")
    assert sink.n_readers == 1
    sink.close()
    received = b""
    while piece := readers[1].recv(100):
        received += piece
    assert received == b"two\n" * 3
    readers[1].close()


def test_who_does_not_read_is_dropped_and_holds_nobody_up() -> None:
    sink = TcpSink(0)
    with socket.create_connection(("127.0.0.1", sink.port), timeout=5):
        sink.send(b"x")
        for _ in range(200):
            sink.send(b"x" * 100_000)
        assert sink.n_readers == 0
    sink.close()


def test_a_serial_line() -> None:
    master, slave = os.openpty()
    sink = SerialSink(os.ttyname(slave), 4800)
    sink.send(b"$GPGGA,,*00\r\n")
    assert os.read(master, 100).startswith(b"$GPGGA")
    sink.close()
    os.close(master)
    os.close(slave)
    with pytest.raises(OSError, match="no-such-line"):
        SerialSink("/dev/no-such-line")


def test_a_stream_stays_open() -> None:
    stream = io.BytesIO()
    sink = StreamSink(stream)
    sink.send(b"a")
    sink.close()
    assert stream.getvalue() == b"a"
