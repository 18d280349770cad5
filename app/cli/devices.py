"""``isodyn device``: phones that push, and the addresses they push to."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

if TYPE_CHECKING:
    from isodyn_client import NewIngestToken, Prior

app = typer.Typer(
    context_settings=NAMED, no_args_is_help=True, help="Let phones push: addresses for Sensor Logger and phyphox."
)


class App(StrEnum):
    """What sends."""

    SENSOR_LOGGER = "sensor-logger"
    PHYPHOX = "phyphox"


class For(StrEnum):
    """What recordings are for."""

    LOCATE = "locate"
    SURVEY = "survey"


class Signs(StrEnum):
    """Signs of the accelerometer."""

    ANDROID = "android"
    IOS = "ios"
    STANDARDISED = "standardised"


class Build(StrEnum):
    """What follows a survey walk."""

    NONE = "none"
    DRAFT = "draft"
    PUBLISH = "publish"


OfDevice = Annotated[str | None, typer.Option("--device", help="Only of this device (dev_...).")]


@app.command("add")
@reported
def add(
    name: Annotated[str, typer.Argument(help="Name of the phone.")],
    level: Annotated[str | None, typer.Option(help="Level it is located on, or surveys (lvl_...).")] = None,
    venue: Annotated[str | None, typer.Option(help="Venue (ven_...), to be located on any level of it.")] = None,
    app: Annotated[App, typer.Option(help="What runs on the phone.")] = App.SENSOR_LOGGER,
    purpose: Annotated[For, typer.Option(help="What its recordings are for.")] = For.LOCATE,
    frame: Annotated[
        Signs, typer.Option(help="Signs of the accelerometer: ios for an iPhone, unless the app standardises it.")
    ] = Signs.ANDROID,
    start: Annotated[
        str | None, typer.Option(help="Where each recording starts, in level metres: X,Y.", show_default=False)
    ] = None,
    radius: Annotated[float, typer.Option(min=0.1, help="How well that is known, m.")] = 3.0,
    contribute: Annotated[bool, typer.Option("--contribute", help="Offer what it sees to the maps.")] = False,
    survey: Annotated[str | None, typer.Option(help="Where survey walks go (srv_...); else a new one.")] = None,
    build: Annotated[Build, typer.Option(help="What follows a survey walk.")] = Build.PUBLISH,
    route: Annotated[
        str | None,
        typer.Option(help='Markers in the order they are walked: "A1,A2,B1". For annotations without a text.'),
    ] = None,
    device: Annotated[str | None, typer.Option(help="A device that is known (dev_...), instead of a new one.")] = None,
    phone_url: Annotated[
        str | None,
        typer.Option(help="Address of the service as the phone reaches it.", show_default="that of --url"),
    ] = None,
    qr: Annotated[bool, typer.Option("--qr/--no-qr", help="Show the address as a QR code, too.")] = True,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Register a phone and print the address it pushes to, as text and QR code, and what to choose in the app.

    The address holds the key: whoever has it can send as this phone, and nothing else. It is shown this once.

    Example:  isodyn device add "Ada's phone" --level lvl_... --start 12.5,40 --url http://192.168.1.20:8080
    """
    from app.cli.pairing import address_for_phone, reach_hint

    prior = None if start is None else _start(start, radius)
    with connect(url, key) as client:
        device_id = device or client.create_device(name).id
        made = client.create_ingest_token(
            name,
            device_id,
            app=app.value,
            level_id=level,
            venue_id=venue,
            purpose=purpose.value,
            survey_id=survey,
            frame=frame.value,
            prior=prior,
            contribute=contribute or None,
            build=build.value if purpose is For.SURVEY else None,
            route=None if route is None else [one.strip() for one in route.split(",")],
        )
    reached_at = phone_url or url
    _show(made, address_for_phone(made.url, reached_at), qr=qr)
    if hint := reach_hint(reached_at):
        typer.secho(hint, fg=typer.colors.YELLOW, err=True)


def _show(made: NewIngestToken, address: str, *, qr: bool) -> None:
    from app.cli.pairing import qr_code

    typer.echo(address)
    if qr:
        typer.echo(qr_code(address))
    for number, line in enumerate(made.settings, start=1):
        typer.echo(f"{number}. {line}")
    typer.echo(f"device {made.device_id}, token {made.id}; revoke it with: isodyn device revoke {made.id}")


def _start(text: str, radius_m: float) -> Prior:
    from isodyn_client import Prior

    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter("needs level metres as X,Y", param_hint="--start") from error
    return Prior(x=x, y=y, radius_m=radius_m)


@app.command("list")
@reported
def list_devices(url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List devices, newest first.

    Example:  isodyn device list
    """
    with connect(url, key) as client:
        rows = [(one.id, one.name, one.model or "", f"{one.created_at:%Y-%m-%d %H:%M}") for one in client.devices()]
    print_table(("device", "name", "model", "since (UTC)"), rows, empty="no devices yet")


@app.command("tokens")
@reported
def tokens(device: OfDevice = None, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List the tokens of push addresses, newest first, without their secrets.

    Example:  isodyn device tokens --device dev_...
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.name,
                one.device_id,
                one.app,
                one.purpose,
                one.level_id or one.venue_id,
                "never" if one.last_used_at is None else f"{one.last_used_at:%Y-%m-%d %H:%M}",
                "" if one.revoked_at is None else f"revoked {one.revoked_at:%Y-%m-%d %H:%M}",
            )
            for one in client.ingest_tokens(device_id=device)
        ]
    print_table(("token", "name", "device", "app", "for", "at", "used (UTC)", ""), rows, empty="no tokens yet")


@app.command("revoke")
@reported
def revoke(
    token_id: Annotated[str, typer.Argument(help="Id of the token (igt_...).")],
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Make a push address useless, at once and for good; what it sent stays.

    Example:  isodyn device revoke igt_...
    """
    with connect(url, key) as client:
        client.revoke_ingest_token(token_id)
    typer.echo(f"{token_id} is revoked")
