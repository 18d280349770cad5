"""The matchers by name: each module tells what its own can do, this one puts them side by side."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from app.engine.matching import declination, dtw, magcom
from app.engine.matching.entry import MatcherEntry

_ENTRIES: tuple[MatcherEntry, ...] = (magcom.ENTRY, *dtw.ENTRIES, declination.ENTRY)
MATCHERS: Mapping[str, MatcherEntry] = MappingProxyType({entry.name: entry for entry in _ENTRIES})
