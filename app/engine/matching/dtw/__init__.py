"""Dynamic time warping of a profile onto lines of the map."""

from app.engine.matching.dtw import subsequence, voting, windows

ENTRIES = (*windows.ENTRIES, subsequence.ENTRY, voting.ENTRY)

__all__ = ["ENTRIES"]
