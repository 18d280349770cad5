"""Maps as ESRI ASCII grids: one layer a file, in a zip archive with ``metadata.json``; rows run from north to south."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.types import Float64Array
from app.exchange.maps.archive import ArchiveWriter, is_zip, metadata_of, read_archive
from app.exchange.maps.document import Layer, MapDocument, Rasters, even_axis
from app.exchange.maps.text import exact, lines_of, number_at

SUFFIX = ".asc"
_NO_DATA = -9999.0
_NEEDED = ("ncols", "nrows", "cellsize")
_KEYS = frozenset({*_NEEDED, "xllcorner", "yllcorner", "xllcenter", "yllcenter", "nodata_value", "dx", "dy"})
_MAX_NODES = 16_000_000


def write_esri_ascii(document: MapDocument, target: BinaryIO) -> None:
    """Write an archive of one grid a layer."""
    with ArchiveWriter(target) as archive:
        units = {}
        for layer in document.layers():
            archive.add(layer.name + SUFFIX, grid_bytes(document, layer))
            units[layer.name] = layer.unit
        archive.add_metadata({**document.attributes(), "units": " ".join(f"{k}={v}" for k, v in units.items())})


def grid_bytes(document: MapDocument, layer: Layer) -> bytes:
    """One layer as an ESRI ASCII grid; nodes are cell centres."""
    rows, columns = layer.values.shape
    grid = document.grid
    out = io.StringIO()
    out.write(f"ncols {columns}\nnrows {rows}\nxllcenter {grid.x0!r}\nyllcenter {grid.y0!r}\n")
    out.write(f"cellsize {grid.cell_m!r}\nNODATA_value {exact(_NO_DATA)}\n")
    for row in layer.values[::-1]:
        out.write(" ".join([exact(value) for value in row.tolist()]) + "\n")
    return out.getvalue().encode()


def read_esri_ascii(content: bytes) -> Rasters:
    """Read an archive of grids of one lattice, or one grid (its layer is named ``value``).

    Raises
    ------
    InputError
        Names the file and line that cannot be read.
    """
    if not is_zip(content):
        x, y, values = _read_grid(content)
        return Rasters(x, y, {"value": values}, {}, {})
    files = read_archive(content)
    grids: dict[str, tuple[Float64Array, Float64Array, Float64Array]] = {}
    for name, part in files.items():
        if name.lower().endswith(SUFFIX):
            try:
                grids[name[: -len(SUFFIX)].lower()] = _read_grid(part)
            except InputError as error:
                raise InputError(f"{name}, {error.field}", error.message) from error
    return joined(grids, files)


def joined(grids: Mapping[str, tuple[Float64Array, Float64Array, Float64Array]], files: Mapping[str, bytes]) -> Rasters:
    """Layers of an archive as rasters of one lattice."""
    if not grids:
        raise InputError("file", "holds no grid; send an archive with one file a layer, such as mean_x and sd_x")
    x, y, _ = next(iter(grids.values()))
    for name, (own_x, own_y, _) in grids.items():
        if own_x.shape != x.shape or own_y.shape != y.shape or own_x[0] != x[0] or own_y[0] != y[0] or own_x[1] != x[1]:
            raise InputError(name, "lies on another lattice than the first layer; send layers of one lattice")
    attributes = metadata_of(files)
    text = attributes.pop("units", "")
    pairs = (part.partition("=") for part in text.split()) if isinstance(text, str) else ()
    units = {name.lower(): unit for name, equals, unit in pairs if equals and name.lower() in grids}
    return Rasters(x, y, {name: values for name, (_, _, values) in grids.items()}, units, attributes)


def _read_grid(content: bytes) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Node coordinates and values, shape (rows, columns), row 0 at the lowest y."""
    header: dict[str, float] = {}
    values: Float64Array | None = None
    filled = 0
    last = 0
    for number, line in lines_of(io.BytesIO(content)):
        last = number
        parts = line.split()
        if not parts:
            continue
        if values is None and parts[0].lower() in _KEYS:
            if len(parts) != 2:
                raise InputError(f"line {number}", f"should be {parts[0]} and one number")
            header[parts[0].lower()] = number_at(parts[1], number)
            continue
        if values is None:
            values = _empty(header, number, len(content))
        if filled + len(parts) > values.size:
            raise InputError(
                f"line {number}", f"brings more than ncols x nrows = {values.size} values; correct the header"
            )
        values.ravel()[filled : filled + len(parts)] = [number_at(part, number) for part in parts]
        filled += len(parts)
    if values is None or filled != values.size:
        raise InputError(f"line {last}", f"is the last, and only {filled} values came; send the whole grid")
    values = np.where(values == header.get("nodata_value", _NO_DATA), np.nan, values)
    rows, columns = values.shape
    return _axis(header, "x", columns), _axis(header, "y", rows), values[::-1]


def _empty(header: Mapping[str, float], number: int, n_bytes: int) -> Float64Array:
    missing = [name for name in _NEEDED if name not in header]
    if missing:
        raise InputError(
            f"line {number}", f"comes before {', '.join(missing)}; begin with the header of an ESRI ASCII grid"
        )
    shape = header["nrows"], header["ncols"]
    if not all(side.is_integer() and 2 <= side <= _MAX_NODES for side in shape) or shape[0] * shape[1] > _MAX_NODES:
        raise InputError("nrows", f"x ncols is {shape[0]:g} x {shape[1]:g}; send 2 x 2 to {_MAX_NODES} nodes in all")
    if 2 * shape[0] * shape[1] > n_bytes + 2:  # a value and what parts it from the next take two bytes
        raise InputError("nrows", f"x ncols is {shape[0]:g} x {shape[1]:g}, more than the file can hold; send it whole")
    return np.empty((int(shape[0]), int(shape[1])))


def _axis(header: Mapping[str, float], name: str, n: int) -> Float64Array:
    cell = header["cellsize"]
    if not cell > 0:
        raise InputError("cellsize", f"is {cell:g}; send a positive number of metres")
    centre, corner = header.get(f"{name}llcenter"), header.get(f"{name}llcorner")
    if centre is None and corner is None:
        raise InputError(f"{name}llcenter", "is missing; say where the lowest left cell lies")
    first = centre if centre is not None else (corner or 0.0) + 0.5 * cell
    return even_axis(first, cell, n)
