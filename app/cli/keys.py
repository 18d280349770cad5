"""``isodyn keys``: API keys."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

app = typer.Typer(context_settings=NAMED, no_args_is_help=True, help="Create, list and revoke API keys.")


class Scope(StrEnum):
    """What a key may do."""

    LOCATE = "locate"
    SURVEY = "survey"
    ADMIN = "admin"


@app.command("create")
@reported
def create(
    name: Annotated[str, typer.Argument(help="Who or what will use it.")],
    scope: Annotated[
        list[Scope] | None,
        typer.Option(
            help="locate: sessions; survey: also venues, walks, maps; admin: all. May be repeated.",
            show_default="locate",
        ),
    ] = None,
    local: Annotated[
        bool, typer.Option("--local", help="Write straight into the data directory of a service on this machine.")
    ] = False,
    data_dir: Annotated[
        Path | None, typer.Option(help="Data directory, with --local.", show_default="ISODYN_DATA_DIR or data")
    ] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Create a key and print its secret, which is shown only this once.

    With --local no key is needed: the way back in when the admin key is lost. It works while the service runs.

    Example:  isodyn keys create "phone app" --scope locate
    Example:  isodyn keys create admin --scope admin --local
    """
    scopes = [one.value for one in scope or [Scope.LOCATE]]
    if local:
        typer.echo(_create_locally(name, scopes, data_dir))
        return
    with connect(url, key) as client:
        typer.echo(client.create_key(name, scopes).secret)


def _create_locally(name: str, scopes: list[str], data_dir: Path | None) -> str:
    from app.cli.database import opened
    from app.services.accounts import AccountService
    from app.services.clock import utc_now
    from app.services.records import Scope as KeyScope

    with opened(data_dir) as database:
        _, secret = AccountService(uow=database, clock=utc_now).create_key(name, {KeyScope(one) for one in scopes})
    return secret


@app.command("list")
@reported
def list_keys(url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List keys without their secrets.

    Example:  isodyn keys list
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.name,
                " ".join(sorted(one.scopes)),
                f"{one.created_at:%Y-%m-%d %H:%M}",
                f"{one.last_used_at:%Y-%m-%d %H:%M}" if one.last_used_at else "never",
                f"revoked {one.revoked_at:%Y-%m-%d}" if one.revoked_at else "",
            )
            for one in client.keys()  # noqa: SIM118  # not a dict
        ]
    print_table(("key", "name", "scopes", "created (UTC)", "last used", ""), rows)


@app.command("revoke")
@reported
def revoke(
    key_id: Annotated[str, typer.Argument(help="Id of the key (key_...).")], url: Url = DEFAULT_URL, key: Key = None
) -> None:
    """Revoke a key, at once and for good.

    Example:  isodyn keys revoke key_...
    """
    with connect(url, key) as client:
        client.revoke_key(key_id)
    typer.echo(f"{key_id} is revoked")
