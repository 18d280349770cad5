"""What commands share: options, the client, error messages, tables, progress bars."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, NoReturn, ParamSpec, TypeVar

import typer

if TYPE_CHECKING:
    from isodyn_client import Client
    from rich.progress import Progress as Bars

P = ParamSpec("P")
R = TypeVar("R")

NAMED = {"help_option_names": ["-h", "--help"]}
FAILED = 1

Url = Annotated[
    str,
    typer.Option("--url", envvar="ISODYN_URL", help="Address of the service.", rich_help_panel="Service"),
]
Key = Annotated[
    str | None,
    typer.Option("--key", envvar="ISODYN_KEY", help="API key (isk_...).", rich_help_panel="Service"),
]
DEFAULT_URL = "http://127.0.0.1:8080"


def connect(url: str, key: str | None) -> Client:
    """Client of the service."""
    from isodyn_client import Client, RetryPolicy

    return Client(url, key, retry=RetryPolicy(retries=3))


def reported(command: Callable[P, R]) -> Callable[P, R]:
    """Turn the errors that a command may meet into one line on stderr and exit status 1."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        from isodyn_client import IsodynError

        from app.cli.errors import CommandError
        from app.engine.errors import EngineError
        from app.evaluation.errors import EvaluationError
        from app.services.errors import ServiceError

        try:
            return command(*args, **kwargs)
        except (IsodynError, CommandError, EngineError, EvaluationError, ServiceError, OSError) as error:
            fail(error)

    run.__doc__ = reflowed(command.__doc__ or "")
    return run


def reflowed(text: str) -> str:
    """Paragraphs without the line breaks of the source, which help would keep; examples stay on lines of their own."""
    paragraphs = re.split(r"\n\s*\n", inspect.cleandoc(text))
    return "\n\n".join(re.sub(r"\n(?!Example:|\.)", " ", paragraph) for paragraph in paragraphs)


def fail(error: Exception) -> NoReturn:
    """Say what went wrong and what may help, and leave."""
    typer.secho(f"error: {error}", fg=typer.colors.RED, err=True)
    if hint := hint_for(error):
        typer.secho(hint, err=True)
    raise typer.Exit(FAILED) from error


def hint_for(error: Exception) -> str:
    """What a newcomer most likely has to do."""
    from isodyn_client import ConnectionFailedError, ForbiddenError, NoMapError, UnauthorizedError

    hints: dict[type[Exception], str] = {
        ConnectionFailedError: "Is the service running? Start it with `isodyn serve`, or name another one with --url.",
        UnauthorizedError: "Pass a key with --key or ISODYN_KEY. The first start of a service prints an admin key; "
        "`isodyn keys create --local` makes another one.",
        ForbiddenError: "Make a key with that scope: isodyn keys create NAME --scope ...",
        NoMapError: "Build one first: isodyn survey upload ..., then isodyn map build LEVEL",
    }
    return next((hint for kind, hint in hints.items() if isinstance(error, kind)), "")


def print_table(columns: Sequence[str], rows: Iterable[Sequence[object]], *, empty: str = "nothing there") -> None:
    """Aligned columns. Nothing is cut off or wrapped: ids are meant to be copied, output to be piped."""
    lines = [tuple(columns), *(tuple(str(cell) for cell in row) for row in rows)]
    if len(lines) == 1:
        typer.echo(empty)
        return
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    lines.insert(1, tuple("-" * width for width in widths))
    for line in lines:
        typer.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def progress_bars() -> Bars:
    """Progress bars with a text, a share, and the time gone by; on stderr, so that output can be piped."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=32),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("[dim]{task.fields[text]}"),
        console=Console(stderr=True),
    )
