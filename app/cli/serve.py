"""``isodyn serve``."""

from __future__ import annotations

from pathlib import Path
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
    from app import main
    from app.settings import Settings

    given: dict[str, Any] = {"host": host, "port": port, "data_dir": data_dir, "workers": workers}
    main.serve(Settings(**{name: value for name, value in given.items() if value is not None}))
