"""``isodyn serve``."""

from __future__ import annotations

import signal
import socket
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

from app.cli.common import reported


@reported
def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; 0.0.0.0 for all.", show_default="127.0.0.1")
    ] = (None),
    port: Annotated[int | None, typer.Option(help="TCP port; 0 takes a free one.", show_default="8080")] = None,
    data_dir: Annotated[
        Path | None, typer.Option(help="Folder of the database and the map cache.", show_default="data")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Workers that locate segments.", show_default="one a core")
    ] = None,
) -> None:
    """Run the service.

    The first start in a folder prints an admin key once. All settings are environment variables ISODYN_...
    (docs/settings.md); the options here win over them.

    Example:  isodyn serve --port 8080 --data-dir data
    """
    from pydantic import ValidationError

    from app.cli.errors import SettingsError, StartError
    from app.settings import PoolKind, Settings
    from app.workers.bootstrap import worker_context

    given: dict[str, Any] = {"host": host, "port": port, "data_dir": data_dir, "workers": workers}
    try:
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        raise SettingsError([(str(one["loc"][0]), one["msg"]) for one in error.errors()]) from error
    check_port(settings.host, settings.port)
    if settings.pool is PoolKind.PROCESSES:
        # workers get ready while this process imports what it needs itself
        worker_context(settings.kernel_cache_dir)
    # takes some seconds to import: only once the settings are in order
    from app import main

    try:
        with main.claim_data_dir(settings.data_dir):
            pass
    except main.DataDirInUseError as error:
        raise StartError(str(error)) from error
    # The server puts the handlers of before back when it has shut down, and raises its signal again: with the default
    # handler the process would die on the spot, without its exit handlers (temporary folders would be left behind).
    signal.signal(signal.SIGTERM, _leave)
    main.serve(settings)


def _leave(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(0)


def check_port(host: str, port: int) -> None:
    """Find out whether the address can be listened on before anything is started: the answer comes at once."""
    from app.cli.errors import StartError

    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        reason = error.strerror or str(error)
        raise StartError(f"cannot listen on {host} port {port} ({reason.lower()}); choose another --port") from error
