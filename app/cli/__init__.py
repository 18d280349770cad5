"""The command line: ``isodyn ...``.

Every command imports what it needs when it runs, so that ``isodyn --help`` answers at once. Commands that talk to a
service do so through the Python client, like any other user.
"""


def main() -> None:
    """Run the command line."""
    from app.cli.root import app

    app()


__all__ = ["main"]
