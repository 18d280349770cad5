"""Storage: adapters of the service ports over SQL (SQLite by default) and a local cache of maps.

:class:`Database` opens transactions (units of work), :class:`FileMapCache` keeps assembled maps as files that
workers memory-map.
"""

from app.storage.database import Database
from app.storage.map_cache import FileMapCache

__all__ = ["Database", "FileMapCache"]
