"""``isodyn contributions``: what everyday sessions offered to maps, and its review."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.common import DEFAULT_URL, NAMED, Key, Url, connect, print_table, reported

if TYPE_CHECKING:
    import isodyn_client as isodyn

app = typer.Typer(
    context_settings=NAMED,
    no_args_is_help=True,
    help="Look at what sessions offered to maps; take it out, put it back; list changes of the field.",
)
ContributionId = Annotated[str, typer.Argument(help="Id of the contribution (ctr_...).")]
OfLevel = Annotated[str | None, typer.Option(help="Only of this level.")]


@app.command("list")
@reported
def list_contributions(
    level: OfLevel = None,
    state: Annotated[str | None, typer.Option(help="offered, used, waiting, quarantined, rejected or empty.")] = None,
    session: Annotated[str | None, typer.Option(help="Only of this session.")] = None,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """List contributions, newest first.

    Example:  isodyn contributions list --level lvl_... --state quarantined
    """
    with connect(url, key) as client:
        rows = [
            (one.id, one.state, f"{one.n_kept}/{one.n_steps}", one.n_agreed, one.n_disagreed, one.verdict)
            for one in client.contributions(level_id=level, state=state, session_id=session)
        ]
    print_table(("contribution", "state", "steps", "agree", "differ", "verdict"), rows, empty="no contributions yet")


@app.command("show")
@reported
def show(contribution_id: ContributionId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Show one contribution.

    Example:  isodyn contributions show ctr_...
    """
    with connect(url, key) as client:
        _print(client.contribution(contribution_id))


@app.command("reject")
@reported
def reject(contribution_id: ContributionId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Take a contribution out of its map, whatever the weighing says of it; the map is updated.

    Example:  isodyn contributions reject ctr_...
    """
    with connect(url, key) as client:
        _print(client.reject_contribution(contribution_id))


@app.command("restore")
@reported
def restore(contribution_id: ContributionId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Offer a rejected contribution again.

    Example:  isodyn contributions restore ctr_...
    """
    with connect(url, key) as client:
        _print(client.restore_contribution(contribution_id))


@app.command("delete")
@reported
def delete(contribution_id: ContributionId, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """Forget a contribution for good; the map is updated without it.

    Example:  isodyn contributions delete ctr_...
    """
    with connect(url, key) as client:
        client.delete_contribution(contribution_id)


@app.command("changes")
@reported
def changes(level: OfLevel = None, url: Url = DEFAULT_URL, key: Key = None) -> None:
    """List lasting changes of the field that independent passes agree on, newest first.

    Example:  isodyn contributions changes --level lvl_...
    """
    with connect(url, key) as client:
        rows = [
            (
                one.id,
                one.level_id,
                "({:.1f}, {:.1f}) to ({:.1f}, {:.1f}) m".format(*one.box),
                ", ".join(f"{value:+.1f}" for value in one.delta),
                "?" if one.after is None else f"{one.after:%Y-%m-%d %H:%M}",
                "?" if one.before is None else f"{one.before:%Y-%m-%d %H:%M}",
            )
            for one in client.field_changes(level_id=level)
        ]
    print_table(("change", "level", "where", "by (uT)", "after", "before"), rows, empty="no changes found")


def _print(one: isodyn.Contribution) -> None:
    where = "nowhere" if one.box is None else "({:.1f}, {:.1f}) to ({:.1f}, {:.1f}) m".format(*one.box)
    print_table(
        ("contribution", one.id),
        [
            ("state", one.state),
            ("session, level", f"{one.session_id}, {one.level_id}"),
            ("steps", f"{one.n_kept} of {one.n_steps} offered, {one.n_rows} rows"),
            ("where", where),
            ("independent evidence", f"agrees at {one.n_agreed} places, differs at {one.n_disagreed}"),
            ("verdict", one.verdict or "not yet weighed"),
            ("left out", "; ".join(one.reasons) or "nothing"),
        ],
    )
