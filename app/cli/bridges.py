"""``isodyn bridge``: positions to what other programs read, and messages of a broker to the service."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, reported

if TYPE_CHECKING:
    from isodyn_client import Client
    from isodyn_client.bridges.feed import DeviceFeed, SessionFeed
    from isodyn_client.bridges.sinks import Sink

app = typer.Typer(
    context_settings=NAMED,
    no_args_is_help=True,
    help="Stand between the service and programs that speak NMEA, MAVLink or MQTT.",
)

SessionId = Annotated[str | None, typer.Option("--session", help="Follow this session (ses_...).", show_default=False)]
DeviceId = Annotated[
    str | None,
    typer.Option("--device", help="Follow the newest open session of this device (dev_...).", show_default=False),
]
Udp = Annotated[str | None, typer.Option("--udp", help="Send datagrams to HOST:PORT.", show_default=False)]
Serial = Annotated[str | None, typer.Option("--serial", help="Write to this serial line.", show_default=False)]
FromStart = Annotated[
    bool, typer.Option("--from-start", help="All fixes of the session; else from its newest segment on.")
]
Unsure = Annotated[
    bool,
    typer.Option("--unsure", help="Pass on fixes that are ok but not sure, too (methods that call no fix sure)."),
]
Poll = Annotated[
    float, typer.Option(min=0.05, max=60.0, help="Seconds between questions, where the service has no events.")
]


@app.command("nmea")
@reported
def nmea(
    session: SessionId = None,
    device: DeviceId = None,
    udp: Udp = None,
    tcp_listen: Annotated[
        str | None,
        typer.Option(help="Listen on PORT or HOST:PORT, and send to all who connect.", show_default=False),
    ] = None,
    serial: Serial = None,
    baud: Annotated[int, typer.Option(help="Of the serial line.")] = 4800,
    stdout: Annotated[bool, typer.Option("--stdout", help="Write to standard output.")] = False,
    talker: Annotated[
        str, typer.Option(help="Two letters: GP is heard by all programs, IN is integrated navigation.")
    ] = "GP",
    sentences: Annotated[str, typer.Option(help="Which, in this order.")] = "GGA,RMC,GST",
    unsure: Unsure = False,
    from_start: FromStart = False,
    poll: Poll = 1.0,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Pass positions on as NMEA 0183: for gpsd, QGIS, chart plotters.

    Positions say that they are estimated (GGA quality 6, RMC mode E, no satellites) and how well (GST); where nothing
    is sure there is none (quality 0, status V). The venue needs an anchor.

    Example:  isodyn bridge nmea --session ses_... --tcp-listen 10110
    """
    from isodyn_client.bridges.nmea import NmeaEncoder

    from app.cli.bridging import checked, run_bridge

    encoder = checked(lambda: NmeaEncoder(talker, tuple(sentences.upper().split(","))))
    sink = _sink(udp=udp, tcp_listen=tcp_listen, serial=serial, baud=baud, stdout=stdout)
    with connect(url, key) as client:
        feed = _feed(client, session, device, from_start=from_start, poll=poll)
        run_bridge(feed, encoder.encode, sink, sure_only=not unsure)


@app.command("mavlink")
@reported
def mavlink(
    session: SessionId = None,
    device: DeviceId = None,
    udp: Udp = None,
    serial: Serial = None,
    baud: Annotated[int, typer.Option(help="Of the serial line.")] = 57600,
    altitude: Annotated[
        float | None,
        typer.Option(
            help="Metres above sea level, if you know it: makes the fix three-dimensional.", show_default=False
        ),
    ] = None,
    system: Annotated[int, typer.Option(min=1, max=255, help="MAVLink system id of the sender.")] = 1,
    gps_id: Annotated[int, typer.Option(min=0, max=7, help="Which of several receivers this stands for.")] = 0,
    unsure: Unsure = False,
    from_start: FromStart = False,
    poll: Poll = 1.0,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Pass positions on as MAVLink GPS_INPUT: for ArduPilot with GPS1_TYPE 14.

    Where nothing is sure the message says so (no fix). The venue needs an anchor.

    Example:  isodyn bridge mavlink --device dev_... --udp 127.0.0.1:14550
    """
    from isodyn_client.bridges.mavlink import MavlinkEncoder

    from app.cli.bridging import run_bridge

    encoder = MavlinkEncoder(system=system, gps_id=gps_id, altitude_m=altitude)
    sink = _sink(udp=udp, serial=serial, baud=baud)
    with connect(url, key) as client:
        feed = _feed(client, session, device, from_start=from_start, poll=poll)
        run_bridge(feed, encoder.encode, sink, sure_only=not unsure)


@app.command("mqtt")
@reported
def mqtt(
    broker: Annotated[str, typer.Option(help="mqtt://USER@HOST:PORT, or mqtts, ws, wss.")],
    topic: Annotated[str, typer.Option(help="May hold + and #.")] = "sensor-logger",
    tokens: Annotated[
        Path | None,
        typer.Option(help='JSON file: {"deviceId": "ingest token"}; "*" is for all others.', show_default=False),
    ] = None,
    token_env: Annotated[
        str | None,
        typer.Option(help="Name of an environment variable that holds one token for all.", show_default=False),
    ] = None,
    password: Annotated[
        str | None,
        typer.Option(envvar="ISODYN_MQTT_PASSWORD", help="Of the broker's user.", show_default=False),
    ] = None,
    client_id: Annotated[
        str, typer.Option(help="Names the session that the broker keeps while the bridge is away.")
    ] = "isodyn-bridge",
    url: Url = DEFAULT_URL,
) -> None:
    """Take Sensor Logger's messages from an MQTT broker and post them to the service.

    A message is acknowledged when the service has it, so what was published with QoS 1 is not lost while either is
    away. Messages that cannot be read are counted and dropped.

    Example:  isodyn bridge mqtt --broker mqtt://localhost --tokens tokens.json
    """
    from app.cli.bridging import read_tokens, run_mqtt

    run_mqtt(broker, topic, read_tokens(tokens, token_env), password=password, client_id=client_id, url=url)


def _feed(
    client: Client, session: str | None, device: str | None, *, from_start: bool, poll: float
) -> SessionFeed | DeviceFeed:
    from isodyn_client.bridges.feed import DeviceFeed, SessionFeed

    from app.cli.bridging import say

    def trouble(error: Exception) -> None:
        say(f"{error}; trying again")

    if (session is None) == (device is None):
        raise typer.BadParameter("give --session or --device, one of the two")
    if session is not None:
        return SessionFeed(client, session, from_start, poll, trouble)
    return DeviceFeed(client, str(device), from_start, poll, trouble)


def _sink(
    *, udp: str | None, serial: str | None, baud: int, tcp_listen: str | None = None, stdout: bool = False
) -> Sink:
    from isodyn_client.bridges import sinks

    from app.cli.bridging import host_and_port, say

    if sum((udp is not None, serial is not None, tcp_listen is not None, stdout)) != 1:
        raise typer.BadParameter("say where to write, once: --udp, --tcp-listen, --serial or --stdout")
    if udp is not None:
        return sinks.UdpSink(*host_and_port(udp))
    if serial is not None:
        return sinks.SerialSink(serial, baud)
    if tcp_listen is not None:
        host, port = host_and_port(tcp_listen, default_host="127.0.0.1")
        listening = sinks.TcpSink(port, host)
        say(f"listening on {host}:{listening.port}")
        return listening
    return sinks.StreamSink(sys.stdout.buffer)
