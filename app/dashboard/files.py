"""The dashboard's files: read once, with their tags, and compressed once."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import as_file, files
from pathlib import Path

from app.api.etag import content_tag

_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""Media types of what is served; other files are not."""
_LEAST_TO_COMPRESS = 1024


@dataclass(frozen=True)
class StaticFile:
    """One file and what HTTP says of it."""

    content: bytes
    media_type: str

    @cached_property
    def tag(self) -> str:
        """Strong tag of the plain content."""
        return content_tag(self.content)

    @cached_property
    def zipped(self) -> bytes | None:
        """Compressed content; None if that would save nothing."""
        if len(self.content) < _LEAST_TO_COMPRESS:
            return None
        return gzip.compress(self.content, compresslevel=6, mtime=0)


def static_file(name: str) -> StaticFile | None:
    """A file below ``static/`` by its path there; None if there is none of this name."""
    return _all_files().get(name)


@lru_cache(maxsize=1)
def plotly() -> StaticFile:
    """The chart library, as its Python package brings it."""
    with as_file(files("plotly") / "package_data" / "plotly.min.js") as path:
        return StaticFile(path.read_bytes(), _TYPES[".js"])


@lru_cache(maxsize=1)
def _all_files() -> dict[str, StaticFile]:
    # All are read at once, and names are looked up among these: a path of a request never reaches the file system.
    folder = Path(__file__).parent / "static"
    return {
        path.relative_to(folder).as_posix(): StaticFile(path.read_bytes(), _TYPES[path.suffix])
        for path in folder.rglob("*")
        if path.suffix in _TYPES
    }
