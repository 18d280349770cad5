"""All commands under one name."""

from __future__ import annotations

from typing import Annotated

import typer

from app.cli import (
    bench,
    bridges,
    contributions,
    database,
    demo,
    devices,
    evaluate,
    exchange,
    follow,
    geofences,
    keys,
    locate,
    maps,
    planning,
    recordings,
    replay,
    serve,
    sessions,
    stream,
    survey_guide,
    surveys,
    tracks,
    versions,
    webhooks,
)
from app.cli.common import NAMED

app = typer.Typer(
    name="isodyn",
    help="Isodyn: open network-side geomagnetic positioning.\n\n"
    "Try it:  isodyn demo   ·   run it:  isodyn serve   ·   then: survey, map, locate, replay, evaluate, bench.\n\n"
    "Commands that talk to a service take its address from --url or ISODYN_URL and the API key from --key or "
    "ISODYN_KEY.",
    context_settings=NAMED,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.command("serve")(serve.serve)
app.command("demo")(demo.demo)
surveys.app.command("export")(exchange.export_survey)
surveys.app.command("import")(exchange.import_survey)
surveys.app.command("start")(survey_guide.start)
surveys.app.command("watch")(survey_guide.watch)
maps.app.command("import")(exchange.import_map)
app.add_typer(surveys.app, name="survey")
app.add_typer(maps.app, name="map")
app.add_typer(contributions.app, name="contributions")
for _command in (versions.publish, versions.rollback, versions.history, versions.sources, versions.diff):
    maps.app.command(_command.__name__)(_command)
maps.app.command("quality")(planning.quality)
maps.app.command("suggest")(planning.suggest)
maps.app.command("forecast")(planning.forecast)
app.command("locate")(locate.locate)
app.command("replay")(replay.replay)
app.command("stream")(stream.stream)
app.command("follow")(follow.follow)
sessions.app.command("export")(tracks.export)
app.add_typer(sessions.app, name="session")
app.add_typer(devices.app, name="device")
app.add_typer(recordings.app, name="recording")
app.add_typer(recordings.markers, name="markers")
app.add_typer(geofences.app, name="geofence")
app.add_typer(webhooks.app, name="webhook")
app.add_typer(bridges.app, name="bridge")
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(bench.app, name="bench")
app.add_typer(keys.app, name="keys")
app.add_typer(database.app, name="db")


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"isodyn {version('isodyn')}")
        except PackageNotFoundError:
            typer.echo("isodyn (source tree)")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = (
        False
    ),
) -> None:
    """Take the options that stand before the command."""
