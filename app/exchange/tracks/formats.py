"""The formats of tracks in one table: it drives the API, the command line and the documents."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from app.exchange.tracks.csv_file import write_csv
from app.exchange.tracks.document import TrackDocument, TrackPoint
from app.exchange.tracks.geojson import write_geojson
from app.exchange.tracks.gpx import write_gpx
from app.exchange.tracks.mf_json import write_mf_json


class TrackFormat(StrEnum):
    """How a track is written to a file."""

    GEOJSON = "geojson"
    MF_JSON = "mf-json"
    GPX = "gpx"
    CSV = "csv"


@dataclass(frozen=True, slots=True)
class TrackFile:
    """A format: what its files are called and how they are written."""

    suffix: str
    media_type: str
    words: str
    write: Callable[[TrackDocument, Iterable[TrackPoint]], Iterator[bytes]]
    needs_anchor: bool = True


FORMATS: Mapping[TrackFormat, TrackFile] = {
    TrackFormat.GEOJSON: TrackFile(
        ".geojson", "application/geo+json", "points with everything, lines through what is claimed", write_geojson
    ),
    TrackFormat.MF_JSON: TrackFile(
        ".mf.json", "application/geo+json", "OGC Moving Features: trajectories with a time a position", write_mf_json
    ),
    TrackFormat.GPX: TrackFile(".gpx", "application/gpx+xml", "GPX 1.1: what is claimed, as tracks", write_gpx),
    TrackFormat.CSV: TrackFile(".csv", "text/csv", "a row a fix, level metres and degrees", write_csv, False),
}
