"""Maps as files: netCDF (CF), GeoTIFF, ESRI ASCII grids and XYZ."""

from app.exchange.maps.document import MapDocument, Rasters
from app.exchange.maps.formats import FORMATS, MapFile, MapFormat, read_map, write_map
from app.exchange.maps.incoming import DEFAULT_SD, ImportChoices, ImportedMap

__all__ = [
    "DEFAULT_SD",
    "FORMATS",
    "ImportChoices",
    "ImportedMap",
    "MapDocument",
    "MapFile",
    "MapFormat",
    "Rasters",
    "read_map",
    "write_map",
]
