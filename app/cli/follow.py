"""``isodyn follow``: positions as they come."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, Key, Url, connect, reported

if TYPE_CHECKING:
    from isodyn_client import Client, IsodynError, LastKnown, PlanFix


@reported
def follow(
    session: Annotated[str | None, typer.Argument(help="Id of the session (ses_...).", show_default=False)] = None,
    level: Annotated[str | None, typer.Option(help="All sessions on this level (lvl_...) instead.")] = None,
    venue: Annotated[str | None, typer.Option(help="All sessions in this venue (ven_...) instead.")] = None,
    after: Annotated[int, typer.Option(min=-1, help="Of one session: behind this fix; -1: from the start.")] = -1,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Print the positions of a session as they come, each once, until it is closed; or where all of a level are.

    A connection that is cut goes on where it was. Ctrl+C ends it.

    Example:  isodyn follow --level lvl_...
    """
    if (session is None) == (level is None and venue is None) or (level is not None and venue is not None):
        raise typer.BadParameter("name one session, or --level, or --venue", param_hint="SESSION")
    with connect(url, key) as client:
        try:
            if session is not None:
                for fix in client.follow(session, after=after, on_trouble=_trouble):
                    typer.echo(_line(str(fix.number), fix))
            else:
                _all(client, venue, level)
        except KeyboardInterrupt:
            return


def _all(client: Client, venue_id: str | None, level_id: str | None) -> None:
    from isodyn_client import LastKnown, SessionChange

    for told in client.follow_all(venue_id=venue_id, level_id=level_id):
        if isinstance(told, LastKnown):
            typer.echo(_line(told.session_id, told))
        elif isinstance(told, SessionChange):
            typer.echo(f"{told.id}  {told.status.value}")
        else:
            for one in told.sessions:
                typer.echo(_line(one.session_id, one))


def _line(name: str, fix: PlanFix | LastKnown) -> str:
    if fix.t_ms is None or fix.x is None or fix.y is None or fix.cov_xx is None or fix.cov_yy is None:
        return f"{name}  nothing known yet"
    when = f"{datetime.fromtimestamp(fix.t_ms / 1000.0, UTC):%H:%M:%S.%f}"[:-3]
    sd = ((fix.cov_xx + fix.cov_yy) / 2.0) ** 0.5
    sure = "sure" if fix.sure else ""
    status = "" if fix.status is None else fix.status.value
    return (
        f"{name}  {when}  {fix.x:8.2f} {fix.y:8.2f} m  ±{sd:5.2f}  {status:12} {sure:4}  {fix.level_id or ''}".rstrip()
    )


def _trouble(error: IsodynError) -> None:
    typer.secho(f"{error}; trying on", fg=typer.colors.YELLOW, err=True)
