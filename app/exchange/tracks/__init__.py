"""Tracks of sessions as files: GeoJSON, OGC MF-JSON Trajectory, GPX 1.1 and CSV."""

from app.exchange.tracks.csv_file import COLUMNS
from app.exchange.tracks.document import TrackDocument, TrackPoint
from app.exchange.tracks.formats import FORMATS, TrackFile, TrackFormat

__all__ = ["COLUMNS", "FORMATS", "TrackDocument", "TrackFile", "TrackFormat", "TrackPoint"]
