"""The formats of maps in one table: it drives the API, the command line and the documents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import BinaryIO

from app.engine.errors import InputError
from app.exchange.maps.document import MapDocument, Rasters
from app.exchange.maps.esri_ascii import read_esri_ascii, write_esri_ascii
from app.exchange.maps.geotiff import read_geotiff, write_geotiff
from app.exchange.maps.incoming import ImportChoices, ImportedMap, map_of
from app.exchange.maps.netcdf import read_netcdf, write_netcdf
from app.exchange.maps.xyz import read_xyz, write_xyz

MAX_TEXT_NODES = 2_000_000
"""Nodes of a map that is written as text: about 100 bytes each."""


class MapFormat(StrEnum):
    """How a map is written to a file."""

    NETCDF = "netcdf"
    GEOTIFF = "geotiff"
    ESRI_ASCII = "esri-ascii"
    XYZ = "xyz"


@dataclass(frozen=True, slots=True)
class MapFile:
    """A format: what its files are called and how they are written and read."""

    suffix: str
    media_type: str
    words: str
    write: Callable[[MapDocument, BinaryIO], None]
    read: Callable[[bytes], Rasters]
    is_text: bool = False


FORMATS: Mapping[MapFormat, MapFile] = {
    MapFormat.NETCDF: MapFile(
        ".nc", "application/x-netcdf", "netCDF classic, CF-1.11; all layers in one file", write_netcdf, read_netcdf
    ),
    MapFormat.GEOTIFF: MapFile(
        ".zip", "application/zip", "zip of GeoTIFFs, one layer each", write_geotiff, read_geotiff
    ),
    MapFormat.ESRI_ASCII: MapFile(
        ".zip", "application/zip", "zip of ESRI ASCII grids, one layer each", write_esri_ascii, read_esri_ascii, True
    ),
    MapFormat.XYZ: MapFile(".xyz", "text/plain", "one line a node", write_xyz, read_xyz, True),
}


def write_map(document: MapDocument, kind: MapFormat, target: BinaryIO) -> None:
    """Write a map.

    Raises
    ------
    InputError
        Too large for a text format.
    """
    form = FORMATS[kind]
    rows, columns = document.grid.shape
    if form.is_text and rows * columns > MAX_TEXT_NODES:
        raise InputError("format", f"{kind.value} takes at most {MAX_TEXT_NODES} nodes; ask for netcdf or geotiff")
    form.write(document, target)


def read_map(content: bytes, kind: MapFormat, level_id: str, choices: ImportChoices) -> ImportedMap:
    """Read a map for a level.

    Raises
    ------
    InputError
        Names the place in the file, and what would be accepted.
    """
    return map_of(FORMATS[kind].read(content), level_id, choices)
