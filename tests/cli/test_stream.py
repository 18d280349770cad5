"""``isodyn stream`` against a real service: files, datagrams, a serial line, and a network that is not there."""

from __future__ import annotations

import os
import random
import socket
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import isodyn_client as isodyn
import numpy as np
import pytest
import serial
from click.testing import Result

from app.cli.convert import samples_of
from app.cli.process import free_port
from app.cli.sources import LineSplitter, UdpLines, file_lines
from app.cli.streaming import RealPace, SpoolInUseError, claimed, line_of
from app.evaluation.datasets.ilc20 import Ilc20Level, RecordedWalk
from tests.cli.conftest import SAMPLE, Service, Surveyed, run

HEADER = "t_ms,mx,my,mz,ax,ay,az,gx,gy,gz"
PLAIN = "t,mx,my,mz,ax,ay,az,gx,gy,gz"


@pytest.fixture(scope="module")
def walk() -> RecordedWalk:
    return next(walk for walk in Ilc20Level("site1-F2", SAMPLE).walks("train") if walk.walk_id.startswith("5dda402"))


def rows(walk: RecordedWalk) -> list[str]:
    samples = samples_of(walk.samples)
    table = np.column_stack([samples.t_ms, samples.mag, samples.acc, samples.gyro])
    return [",".join(f"{value:.6f}" for value in row) for row in table]


def stream(service: Service, *options: str | Path, spool: Path, url: str | None = None) -> Result:
    return run("stream", *options, "--spool", spool, ISODYN_URL=url or service.url, ISODYN_KEY=service.key)


@pytest.fixture
def device_id(service: Service) -> str:
    """A device of one test: its sessions are that test's."""
    with service.client() as client:
        return client.create_device("cart").id


def sessions_of(service: Service, device_id: str) -> list[isodyn.SessionInfo]:
    with service.client() as client:
        return list(client.sessions(device_id=device_id))


def start_of(walk: RecordedWalk) -> list[str]:
    return ["--x", f"{walk.waypoints.x[0]:.2f}", "--y", f"{walk.waypoints.y[0]:.2f}"]


@pytest.fixture
def file(walk: RecordedWalk, tmp_path: Path) -> Path:
    made = tmp_path / "drive.csv"
    made.write_text("\n".join([HEADER, *rows(walk)]) + "\n")
    return made


def sent(service: Service, session_id: str) -> int:
    with service.client() as client:
        return sum(one.n_samples or 0 for one in client.segments(session_id))


def test_a_file_becomes_a_session(
    service: Service, surveyed: Surveyed, device_id: str, walk: RecordedWalk, file: Path, tmp_path: Path
) -> None:
    done = stream(
        service,
        "--csv",
        file,
        "--level",
        surveyed.level_id,
        "--device",
        device_id,
        *start_of(walk),
        spool=tmp_path / "spool",
    )
    assert done.exit_code == 0, done.output
    (session,) = sessions_of(service, device_id)
    assert session.status is isodyn.SessionStatus.CLOSED
    assert session.prior.x == pytest.approx(walk.waypoints.x[0], abs=0.01)
    assert sent(service, session.id) == len(walk.samples)
    with service.client() as client:
        fixes = client.positions(session.id)
    printed = [text for text in done.stdout.splitlines() if surveyed.level_id in text]
    assert len(printed) == session.next_seq == len(list(_pieces(walk)))
    assert f"{fixes.x[-1]:.2f}" in printed[-1]
    assert f"{len(fixes)} fixes" in done.stderr
    # the same samples as by the client, so the same fixes
    with service.client() as client, client.open_session(surveyed.level_id, prior=session.prior) as direct:
        results = list(direct.send_all(samples_of(walk.samples), wait=20))
    assert sum(len(result.fixes or ()) for result in results) == len(fixes)


def _pieces(walk: RecordedWalk) -> Iterator[isodyn.Samples]:
    return samples_of(walk.samples).split(5.0)


def test_without_a_network_the_disk_keeps_it_and_the_next_run_sends_it_first(
    service: Service,
    surveyed: Surveyed,
    device_id: str,
    walk: RecordedWalk,
    file: Path,
    tmp_path: Path,
) -> None:
    spool, away = tmp_path / "spool", f"http://127.0.0.1:{free_port()}"
    texts = file.read_text().splitlines()
    half = len(texts) // 2
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    first.write_text("\n".join(texts[:half]))
    second.write_text("\n".join([HEADER, *texts[half:]]))
    waiting = threading.Event()
    n_pieces = len(list(samples_of(walk.samples)[: half - 1].split(5.0)))

    def stop_when_it_waits() -> None:
        while len(list(spool.glob("*.segment"))) < n_pieces:
            waiting.wait(0.05)
        os.kill(os.getpid(), 15)

    stopper = threading.Thread(target=stop_when_it_waits)
    stopper.start()
    cut = stream(service, "--csv", first, "--level", surveyed.level_id, "--device", device_id, spool=spool, url=away)
    stopper.join()
    assert "nothing is lost" in cut.stderr
    assert f"wait in {spool}" in cut.stderr
    assert len(list(spool.glob("*.segment"))) == n_pieces > 2
    done = stream(service, "--csv", second, "--level", surveyed.level_id, "--device", device_id, spool=spool)
    assert done.exit_code == 0, done.output
    assert not list(spool.glob("*.segment"))
    (session,) = sessions_of(service, device_id)
    assert sent(service, session.id) == len(walk.samples)
    with service.client() as client:
        starts = [one.t_start_ms for one in client.segments(session.id)]
    assert starts == sorted(starts)  # type: ignore[type-var]


def test_datagrams_out_of_order_lost_and_twice(
    service: Service, surveyed: Surveyed, device_id: str, walk: RecordedWalk, tmp_path: Path
) -> None:
    """Three lines a datagram; neighbours change places, some are lost, some come twice."""
    port = free_port()
    texts = rows(walk)
    packets = ["\n".join(texts[i : i + 3]) for i in range(0, len(texts), 3)]
    rng = random.Random(1)
    kept = [packet for packet in packets if rng.random() > 0.05]
    order = sorted(range(len(kept)), key=lambda i: i + rng.uniform(0, 3))
    arriving = [kept[i] for i in order for _ in range(1 + (rng.random() < 0.1))]
    n_rows = sum(len(packet.splitlines()) for packet in kept)
    spool = tmp_path / "spool"

    def drive() -> None:
        pause = threading.Event()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not (spool / "lock").exists():
                pause.wait(0.05)
            for _ in range(20):  # until the receiver listens
                sender.sendto(b"# hello\n", ("127.0.0.1", port))
                pause.wait(0.02)
            for i, packet in enumerate(arriving):
                sender.sendto(packet.encode(), ("127.0.0.1", port))
                if i % 4 == 0:
                    pause.wait(0.01)
        while not any(one.next_seq for one in sessions_of(service, device_id)):
            pause.wait(0.1)
        pause.wait(3.0)  # longer than the silence after which the rest is sent
        os.kill(os.getpid(), 15)

    driver = threading.Thread(target=drive)
    driver.start()
    options = ("--udp", f"127.0.0.1:{port}", "--columns", PLAIN, "--unit", "t=ms")
    done = stream(service, *options, "--level", surveyed.level_id, "--device", device_id, spool=spool)
    driver.join()
    assert done.exit_code == 0, done.output
    (session,) = sessions_of(service, device_id)
    assert sent(service, session.id) == n_rows
    assert session.status is isodyn.SessionStatus.CLOSED
    assert "rows that came too late or twice" in done.stderr


def test_a_serial_line(
    service: Service,
    surveyed: Surveyed,
    device_id: str,
    walk: RecordedWalk,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    opened = threading.Event()

    class Opened(serial.Serial):  # type: ignore[misc, unused-ignore]
        """Tells when it is open: what is written before is thrown away, as of every serial line."""

        def open(self) -> None:
            super().open()
            opened.set()

    monkeypatch.setattr(serial, "Serial", Opened)
    texts = rows(walk)[:600]
    spool = tmp_path / "spool"

    def drive() -> None:
        pause = threading.Event()
        assert opened.wait(30)
        os.write(master, f"{texts[0][3:]}\r\n".encode())  # the end of a line that began before
        for text in texts:
            os.write(master, f"{text}\r\n".encode())
        while not any(one.next_seq for one in sessions_of(service, device_id)):
            pause.wait(0.1)
        pause.wait(3.0)
        os.kill(os.getpid(), 15)

    driver = threading.Thread(target=drive)
    driver.start()
    options = ("--serial", os.ttyname(slave), "--columns", PLAIN, "--unit", "t=ms")
    done = stream(service, *options, "--level", surveyed.level_id, "--device", device_id, spool=spool)
    driver.join()
    os.close(master)
    os.close(slave)
    assert done.exit_code == 0, done.output
    (session,) = sessions_of(service, device_id)
    assert sent(service, session.id) == 600, done.stderr
    assert "left out" not in done.stderr


def test_what_is_refused_for_good_ends_it_and_keeps_the_lines(
    service: Service, surveyed: Surveyed, file: Path, tmp_path: Path
) -> None:
    done = stream(service, "--csv", file, "--level", "lvl_0", spool=tmp_path / "spool")
    assert done.exit_code == 1
    assert "no level 'lvl_0'" in done.stderr
    assert list((tmp_path / "spool").glob("*.segment"))


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--csv", "x"), 2, "--level, or --venue"),
        (("--level", "l"), 2, "say where the lines come from"),
        (("--csv", "x", "--udp", "1", "--level", "l"), 2, "say where the lines come from"),
        (("--csv", "x", "--level", "l", "--x", "1"), 2, "both --x and --y"),
        (("--csv", "/no/such/file", "--level", "l"), 1, "No such file"),
        (("--csv", "x", "--level", "l", "--unit", "mag=V"), 1, "name one of"),
        (("--csv", "x", "--level", "l", "--column", "mag_x"), 1, "no pair"),
    ],
)
def test_options_that_do_not_fit_are_explained(tmp_path: Path, options: tuple[str, ...], code: int, words: str) -> None:
    result = run("stream", *options, "--spool", tmp_path)
    assert result.exit_code == code
    assert words in " ".join(result.output.replace("│", " ").split())


def test_a_header_without_a_sensor_is_explained(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t,mx,my,mz\n1,2,3,4\n")
    result = run("stream", "--csv", file, "--level", "l", "--spool", tmp_path / "s")
    assert result.exit_code == 1
    assert "lacks acc_x" in result.output


def test_one_process_a_spool(tmp_path: Path) -> None:
    with claimed(tmp_path), pytest.raises(SpoolInUseError, match="--spool"), claimed(tmp_path):
        pass
    with claimed(tmp_path):
        pass


def test_lines_of_pieces() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"a\r\nb") == ["a"]
    assert splitter.feed(b"c\n\xff\n") == ["bc", "\ufffd"]
    assert splitter.feed(b"x" * 70_000) == []
    assert splitter.feed(b"y\nz\n") == ["y", "z"]


def test_datagrams_hold_lines_and_silence_is_told() -> None:
    lines = UdpLines("127.0.0.1", 0)
    source = iter(lines)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"a\nb\n", ("127.0.0.1", lines.port))
        assert next(source) == ["a", "b"]
        assert next(source) == []
    source.close()  # type: ignore[attr-defined]


def test_files_come_in_handfuls(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("x\n" * 1000)
    batches = list(file_lines(file))
    assert sum(map(len, batches)) == 1000
    assert len(batches) > 3


def test_the_pace_of_measuring() -> None:
    waits: list[float] = []
    stopped = threading.Event()
    stopped.wait = lambda timeout=None: bool(waits.append(timeout or 0.0))  # type: ignore[method-assign]
    now = [50.0]
    pace = RealPace(stopped, clock=lambda: now[0])
    pace(1005.0)
    now[0] = 51.0
    pace(1010.0)
    now[0] = 70.0
    pace(1015.0)
    assert waits == [0.0, 4.0, 0.0]


def test_a_line_of_a_position() -> None:
    position = isodyn.Position(
        t_ms=1_764_000_000_250.0, kind="filtered", x=1.5, y=-2.25, cov_xx=1.0, cov_xy=0.0, cov_yy=1.0, heading_deg=0.0,
        status="ok", quality=0.5, sure=True, level_id="lvl_1",
        ellipse95={"semi_major_m": 3.0, "semi_minor_m": 3.0, "angle_deg": 0.0},
    )  # fmt: skip
    assert line_of(position) == "16:00:00.2  x     1.50  y    -2.25  95 %   3.0 m  ok, sure  lvl_1"
