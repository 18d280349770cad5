"""Dynamic time warping of a profile onto lines of the map."""

from app.engine.matching.dtw import subsequence, windows

ENTRIES = (*windows.ENTRIES, subsequence.ENTRY)

__all__ = ["ENTRIES"]
