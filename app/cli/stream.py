"""``isodyn stream``: the lines of a vehicle's logger as a session."""

from __future__ import annotations

import threading
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, reported

if TYPE_CHECKING:
    from app.cli.sources import Lines


class FrameName(StrEnum):
    """Axes of the sensors."""

    ANDROID = "android"
    IOS = "ios"
    FRD = "frd"
    FLU = "flu"


@reported
def stream(
    csv: Annotated[Path | None, typer.Option(help="Lines of a file; - is standard input.", show_default=False)] = None,
    udp: Annotated[
        str | None, typer.Option(help="Lines in datagrams to PORT or HOST:PORT of this machine.", show_default=False)
    ] = None,
    serial: Annotated[str | None, typer.Option(help="Lines of this serial line.", show_default=False)] = None,
    baud: Annotated[int, typer.Option(help="Of the serial line.")] = 115200,
    level: Annotated[str | None, typer.Option(help="Id of the level (lvl_...).", show_default=False)] = None,
    venue: Annotated[
        str | None, typer.Option(help="Id of the venue (ven_...), if the level is unknown.", show_default=False)
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Names of the columns, separated by commas, if the lines have no header.", show_default=False
        ),
    ] = None,
    column: Annotated[
        list[str] | None, typer.Option(help="A column with a name of its own: mag_x=HEADER.", show_default=False)
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(help="A unit: mag=nT, acc=g, gyro=deg/s, t=ms, speed=km/h.", show_default=False),
    ] = None,
    frame: Annotated[FrameName, typer.Option(help="Axes of the sensors.")] = FrameName.ANDROID,
    start: Annotated[
        str | None,
        typer.Option(help="When a clock without a date began, ISO 8601; live lines: now.", show_default=False),
    ] = None,
    segment: Annotated[float, typer.Option(min=1.0, max=60.0, help="Seconds in a segment.")] = 5.0,
    rate_real: Annotated[
        bool, typer.Option("--rate-real/--as-fast", help="Send a file as slowly as it was measured.")
    ] = False,
    x: Annotated[float | None, typer.Option(help="Where it began on the level, plan metres.")] = None,
    y: Annotated[float | None, typer.Option(help="Where it began, plan metres.")] = None,
    radius: Annotated[float, typer.Option(help="How far from (x, y) it may have begun, metres.")] = 3.0,
    heading: Annotated[
        float | None, typer.Option(help="Direction of the device's y axis, degrees counter-clockwise from +x.")
    ] = None,
    device: Annotated[str | None, typer.Option(help="Id of the device (dev_...).", show_default=False)] = None,
    method: Annotated[
        str | None, typer.Option(help="Positioning method (GET /v1/methods).", show_default="the service's")
    ] = None,
    spool: Annotated[
        Path | None,
        typer.Option(help="Folder of what is not sent yet.", show_default="~/.isodyn/spool/ID"),
    ] = None,
    spool_mb: Annotated[int, typer.Option(min=1, help="Largest size of the spool, MB; the oldest goes first.")] = 256,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Send the lines of a vehicle's logger as a session, and print its positions.

    Columns are those of survey files: t, mag x y z, acc x y z (with gravity), gyro x y z, and if there is one the speed
    of the wheels. What cannot be sent now waits on disk and goes in order later, after a restart too.

    Example:  isodyn stream --csv drive.csv --level lvl_... --frame frd

    Example:  isodyn stream --udp 9000 --venue ven_... --columns t,mx,my,mz,ax,ay,az,gx,gy,gz,speed
    """
    import isodyn_client as isodyn

    from app.cli.streaming import Pump, RealPace, Teller, claimed, stream_lines
    from app.cli.survey_files import pairs_of, start_of
    from app.exchange.vehicles import Cutter, LineChoices, LineReader

    if (level is None) == (venue is None):
        raise typer.BadParameter("give --level, or --venue if the level is unknown")
    if (x is None) != (y is None):
        raise typer.BadParameter("give both --x and --y, or neither")
    if sum(one is not None for one in (csv, udp, serial)) != 1:
        raise typer.BadParameter("say where the lines come from, once: --csv, --udp or --serial")
    live = csv is None
    choices = LineChoices(
        header=tuple(name.strip() for name in columns.split(",")) if columns else (),
        columns=pairs_of("column", column or ()),
        units=pairs_of("unit", unit or ()),
        start_s=None if start is None else start_of(start),
        live=live,
    )
    stopped = threading.Event()
    folder = spool or Path.home() / ".isodyn" / "spool" / str(level or venue)
    priors = iter([isodyn.Prior(x=x, y=y, radius_m=radius, heading_deg=heading)])
    with claimed(folder), connect(url, key) as client:
        kept = isodyn.Spool(folder, spool_mb * 2**20)
        teller = Teller()

        def open_session() -> isodyn.SessionInfo:
            # where it began is known of the first trip only
            return client.create_session(
                level, venue_id=venue, method=method, prior=next(priors, isodyn.Prior()), device_id=device
            )

        pump = Pump(
            LineReader(choices),
            Cutter(segment) if live else Cutter(segment, reorder_s=0.0),
            kept,
            stopped,
            frame.value,
            live=live,
            pace=RealPace(stopped) if rate_real and not live else None,
        )
        uploader = isodyn.Uploader(client, kept, open_session, teller.result, teller.trouble)
        stream_lines(pump, uploader, _source(csv, udp, serial, baud), teller)


def _source(csv: Path | None, udp: str | None, serial: str | None, baud: int) -> Lines:
    from app.cli.bridging import host_and_port, say
    from app.cli.sources import UdpLines, file_lines, serial_lines

    if csv is not None:
        return file_lines(csv)
    if udp is not None:
        host, port = host_and_port(udp, default_host="0.0.0.0")  # noqa: S104  # a vehicle is another machine
        lines = UdpLines(host, port)
        say(f"listening on {host}:{lines.port}")
        return iter(lines)
    return serial_lines(str(serial), baud)
