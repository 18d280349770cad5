"""Storage: adapters of the service ports over SQL (SQLite by default) and a local cache of maps.

:class:`Database` opens transactions (units of work), :class:`FileMapCache` keeps assembled maps as files that
workers memory-map.
"""

from typing import TYPE_CHECKING, Any

from app.storage.map_cache import FileMapCache

if TYPE_CHECKING:
    from app.storage.database import Database

__all__ = ["Database", "FileMapCache"]


def __getattr__(name: str) -> Any:
    # Imported when asked for: workers need the map cache only, and SQLAlchemy would cost the first segment of each
    # one or two seconds.
    if name == "Database":
        from app.storage.database import Database

        return Database
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
