"""Maps as GeoTIFF (OGC 19-008r4): one float32 layer a file, in a zip archive with ``metadata.json``.

An anchored level lies in a transverse Mercator projection about its anchor, at the anchor's height (the scale at the
origin), which agrees with the tangent plane of the level frame to a millimetre within two kilometres; the bearing of
the frame is a rotation of the raster.
"""

from __future__ import annotations

import io
import math
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO
from xml.sax.saxutils import escape, unescape

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import Float64Array
from app.exchange.maps.archive import ArchiveWriter, is_zip, read_archive
from app.exchange.maps.document import Layer, MapDocument, Rasters, even_axis
from app.exchange.maps.esri_ascii import joined

SUFFIXES = (".tif", ".tiff")
_STRIP_ROWS = 64
_MAX_NODES = 16_000_000
_ASCII, _SHORT, _LONG, _DOUBLE = 2, 3, 4, 12
_CODES: Mapping[int, str] = {_SHORT: "H", _LONG: "I", _DOUBLE: "d"}
_PIXEL_SCALE, _TIE_POINT, _MATRIX, _KEYS, _KEY_DOUBLES, _KEY_TEXT = 33550, 33922, 34264, 34735, 34736, 34737
_GDAL_METADATA, _GDAL_NO_DATA = 42112, 42113
_RASTER_TYPE, _POINT = 1025, 2
_USER_DEFINED = 32767
_OURS = re.compile(r'<Item name="([A-Za-z0-9_]{1,40})">([^<]{0,200})</Item>')
_PLACE = ("x0", "y0", "cell_m")
_DAMAGED = (OSError, SyntaxError, ValueError, KeyError, IndexError, TypeError, OverflowError, EOFError, struct.error,
            RuntimeError, AttributeError, MemoryError, UserWarning,
            Image.DecompressionBombError)  # fmt: skip
"""What Pillow raises over damaged files (warnings too, where they are errors)."""


def write_geotiff(document: MapDocument, target: BinaryIO) -> None:
    """Write an archive of one GeoTIFF a layer; its strips are deflated already."""
    with ArchiveWriter(target, compressed=False) as archive:
        units = {}
        for layer in document.layers():
            archive.add(f"{layer.name}.tif", tiff_bytes(document, layer))
            units[layer.name] = layer.unit
        archive.add_metadata({**document.attributes(), "units": " ".join(f"{k}={v}" for k, v in units.items())})


@dataclass(frozen=True, slots=True)
class _Tag:
    """A field of a TIFF directory."""

    id: int
    kind: int
    values: Sequence[int | float] | bytes

    @property
    def count(self) -> int:
        return len(self.values)

    def data(self) -> bytes:
        if isinstance(self.values, bytes):
            return self.values
        return struct.pack(f"<{len(self.values)}{_CODES[self.kind]}", *self.values)


def tiff_bytes(document: MapDocument, layer: Layer) -> bytes:
    """One layer as a little-endian TIFF; the first image row is the highest y, pixels are points."""
    rows, columns = layer.values.shape
    north_up = np.ascontiguousarray(layer.values[::-1], "<f4")
    strips = [zlib.compress(north_up[i : i + _STRIP_ROWS].tobytes(), 6) for i in range(0, rows, _STRIP_ROWS)]
    sizes = [len(strip) for strip in strips]
    offsets = (8 + np.cumsum([0, *sizes[:-1]])).tolist()
    tags = [
        _Tag(256, _LONG, (columns,)),
        _Tag(257, _LONG, (rows,)),
        _Tag(258, _SHORT, (32,)),
        _Tag(259, _SHORT, (8,)),  # deflate
        _Tag(262, _SHORT, (1,)),
        _Tag(270, _ASCII, _text(f"{document.title}: {layer.words}, {layer.unit}")),
        _Tag(273, _LONG, offsets),
        _Tag(277, _SHORT, (1,)),
        _Tag(278, _LONG, (_STRIP_ROWS,)),
        _Tag(279, _LONG, sizes),
        _Tag(305, _ASCII, _text(document.software)),
        _Tag(339, _SHORT, (3,)),  # IEEE floating point
        *_place_tags(document),
        _Tag(_GDAL_METADATA, _ASCII, _text(_metadata(document, layer))),
    ]
    body = b"".join(strips)
    body += b"\0" * (len(body) % 2)
    return struct.pack("<2sHI", b"II", 42, 8 + len(body)) + body + _directory(tags, 8 + len(body))


def _text(text: str) -> bytes:
    # TIFF texts are ASCII; what is not stays readable
    return text.encode("ascii", "replace") + b"\0"


def _directory(tags: Sequence[_Tag], at: int) -> bytes:
    """A directory at byte ``at``, and behind it the values that do not fit into its entries."""
    behind = at + 2 + 12 * len(tags) + 4
    entries, extra = [], b""
    for tag in sorted(tags, key=lambda one: one.id):
        data = tag.data()
        if len(data) <= 4:
            field = data.ljust(4, b"\0")
        else:
            field = struct.pack("<I", behind + len(extra))
            extra += data + b"\0" * (len(data) % 2)
        entries.append(struct.pack("<HHI", tag.id, tag.kind, tag.count) + field)
    return struct.pack("<H", len(tags)) + b"".join(entries) + struct.pack("<I", 0) + extra


def _place_tags(document: MapDocument) -> list[_Tag]:
    grid, plane = document.grid, document.plane
    top = grid.y0 + (grid.shape[0] - 1) * grid.cell_m
    if plane is None or plane.bearing_deg == 0.0:
        place = [
            _Tag(_PIXEL_SCALE, _DOUBLE, (grid.cell_m, grid.cell_m, 0.0)),
            _Tag(_TIE_POINT, _DOUBLE, (0.0, 0.0, 0.0, grid.x0, top, 0.0)),
        ]
    else:
        place = [_Tag(_MATRIX, _DOUBLE, _turned(grid.x0, top, grid.cell_m, plane.bearing_deg))]
    return [*place, *_crs_tags(plane)]


def _turned(x0: float, top: float, cell_m: float, bearing_deg: float) -> tuple[float, ...]:
    """Matrix from column and row to east and north of the anchor (+y of the level frame has this bearing)."""
    c, s = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    east = (cell_m * c, -cell_m * s, 0.0, x0 * c + top * s)
    north = (-cell_m * s, -cell_m * c, 0.0, top * c - x0 * s)
    return (*east, *north, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def _crs_tags(plane: TangentPlane | None) -> list[_Tag]:
    words = "level frame, metres" if plane is None else "transverse Mercator about the venue's anchor, WGS 84"
    text = f"{words}|"
    doubles: tuple[float, ...] = ()
    keys = [(1024, 0, 1, _USER_DEFINED if plane is None else 1), (_RASTER_TYPE, 0, 1, _POINT)]
    keys.append((1026, _KEY_TEXT, len(text), 0))
    if plane is not None:
        doubles = (plane.longitude_deg, plane.latitude_deg, 0.0, 0.0, _scale(plane))
        keys += [(2048, 0, 1, 4326), (3072, 0, 1, _USER_DEFINED), (3074, 0, 1, _USER_DEFINED), (3075, 0, 1, 1)]
        keys.append((3076, 0, 1, 9001))
        keys += [(key, _KEY_DOUBLES, 1, i) for i, key in enumerate((3080, 3081, 3082, 3083, 3092))]
    flat = [number for key in [(1, 1, 0, len(keys)), *keys] for number in key]
    tags = [_Tag(_KEYS, _SHORT, flat), _Tag(_KEY_TEXT, _ASCII, _text(text))]
    return [*tags, _Tag(_KEY_DOUBLES, _DOUBLE, doubles)] if doubles else tags


def _scale(plane: TangentPlane) -> float:
    """Lengths at the height of the plane over those on the ellipsoid, by its Gaussian radius of curvature there."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    radius = a * math.sqrt(1 - e2) / (1 - e2 * math.sin(math.radians(plane.latitude_deg)) ** 2)
    return 1.0 + plane.height_m / radius


def _metadata(document: MapDocument, layer: Layer) -> str:
    """GDAL's XML, which QGIS shows: the layer, and where it lies in the level frame (the raster may be turned)."""
    grid = document.grid
    items: dict[str, str] = {"layer": layer.name, "units": layer.unit, "long_name": layer.words}
    items |= {"x0": repr(float(grid.x0)), "y0": repr(float(grid.y0)), "cell_m": repr(float(grid.cell_m))}
    items |= {k: v for k, v in document.attributes().items() if isinstance(v, str)}
    body = "".join(f'<Item name="{name}">{escape(value)}</Item>' for name, value in items.items())
    return f"<GDALMetadata>{body}</GDALMetadata>"


def read_geotiff(content: bytes) -> Rasters:
    """Read an archive of single-layer GeoTIFFs of one lattice, or one of them (its layer is named ``value``).

    Raises
    ------
    InputError
        Damaged, more than one sample a pixel, turned without saying how, or without a place.
    """
    if not is_zip(content):
        x, y, values, layer = _read_tiff(content)
        return Rasters(x, y, {layer: values}, {}, {})
    files = read_archive(content)
    grids = {}
    for name, part in files.items():
        stem, dot, suffix = name.rpartition(".")
        if dot + suffix.lower() in SUFFIXES:
            try:
                x, y, values, _ = _read_tiff(part)
            except InputError as error:
                raise InputError(f"{name}, {error.field}", error.message) from error
            grids[stem.lower()] = (x, y, values)
    return joined(grids, files)


def _read_tiff(content: bytes) -> tuple[Float64Array, Float64Array, Float64Array, str]:
    """Node coordinates, values with row 0 at the lowest y, and the layer's name."""
    try:
        with Image.open(io.BytesIO(content), formats=["TIFF"]) as image:
            columns, rows = image.size
            if columns * rows > _MAX_NODES or min(columns, rows) < 2:
                raise InputError("file", f"has {columns} x {rows} pixels; send 2 x 2 to {_MAX_NODES} in all")
            if image.mode not in {"F", "I", "L", "I;16", "I;16B"}:
                raise InputError("file", f"has pixels of mode {image.mode}; send one layer a file, float32")
            tags: dict[int, Any] = dict(image.tag_v2)  # type: ignore[attr-defined]
            pixels = np.asarray(image)
    except _DAMAGED as error:
        if isinstance(error, InputError):
            raise
        # Pillow tells a file that it does not know by the address of the buffer
        why = "" if isinstance(error, UnidentifiedImageError) else f" ({str(error)[:80]})"
        raise InputError("file", f"is no readable TIFF{why}; send GeoTIFF of float32") from error
    # float32 stays: a large raster is in memory more than once here
    values: NDArray[Any] = pixels if pixels.dtype == np.float32 else pixels.astype(np.float64)
    items = {name: unescape(text) for name, text in _OURS.findall(str(tags.get(_GDAL_METADATA, "")))}
    x0, top, cell = _place(tags, items, rows)
    no_data = _no_data(tags)
    if no_data is not None:
        values = np.where(values == values.dtype.type(no_data), values.dtype.type(np.nan), values)
    x, y = even_axis(x0, cell[0], columns), even_axis(top, -cell[1], rows)
    return x, y[::-1], values[::-1], items.get("layer", "value").lower()


def _place(tags: Mapping[int, Any], items: Mapping[str, str], rows: int) -> tuple[float, float, tuple[float, float]]:
    """Level coordinates of the first image row's first node, and the spacing along x and y."""
    if all(name in items for name in _PLACE):
        x0, y0, cell = (_float(items[name]) for name in _PLACE)
        return x0, y0 + (rows - 1) * cell, (cell, cell)
    if _MATRIX in tags:
        raise InputError("file", "is a turned raster; send it unturned, in metres of the level frame")
    scale, tie = _doubles(tags.get(_PIXEL_SCALE), 2), _doubles(tags.get(_TIE_POINT), 6)
    if not scale or not tie:
        raise InputError(
            "file", "does not say where it lies; send GeoTIFF with pixel scale and tie point, level metres"
        )
    # pixels that are areas have their tie point at a corner
    half = 0.0 if _is_point(tags.get(_KEYS)) else 0.5
    cell_x, cell_y = scale[:2]
    x0 = tie[3] + (half - tie[0]) * cell_x
    top = tie[4] - (half - tie[1]) * cell_y
    return x0, top, (cell_x, cell_y)


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError("file", f"gives {text[:20]!r} as a place in its metadata; correct it") from error


def _doubles(value: object, n: int) -> tuple[float, ...]:
    """The first ``n`` numbers of a tag; empty if it has not so many."""
    if not isinstance(value, tuple) or len(value) < n or not all(isinstance(one, int | float) for one in value[:n]):
        return ()
    return tuple(float(one) for one in value[:n])


def _is_point(keys: object) -> bool:
    if not isinstance(keys, tuple):
        return False
    entries = [keys[i : i + 4] for i in range(4, len(keys), 4)]
    return any(entry[0] == _RASTER_TYPE and entry[3] == _POINT for entry in entries if len(entry) == 4)


def _no_data(tags: Mapping[int, Any]) -> float | None:
    try:
        return float(str(tags[_GDAL_NO_DATA]).strip("\0 "))
    except (KeyError, ValueError):
        return None
