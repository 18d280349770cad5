"""Maps as XYZ: one line a node, columns named in a header line, comments before it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from app.engine.errors import InputError
from app.engine.types import Float64Array, IntArray
from app.exchange.maps.document import MapDocument, Rasters, Value
from app.exchange.maps.text import attribute_of, comment_lines, exact, lines_of, number_at

_PLACES = ("longitude", "latitude")
_MAX_COLUMNS = 20
_MAX_NODES = 2_000_000
_SAME = 1e-4
"""Coordinates nearer than this share of the spacing are of one row or column of the lattice."""


def write_xyz(document: MapDocument, target: BinaryIO) -> None:
    """Write all nodes, row by row from the lowest y; ``support`` says which of them are mapped."""
    layers = list(document.layers())
    plane = document.plane
    header = ["x", "y", *(_PLACES if plane is not None else ()), *(layer.name for layer in layers)]
    units = " ".join(f"{layer.name}={layer.unit}" for layer in layers)
    head = (*comment_lines(document.attributes()), f"# units: {units}", " ".join(header), "")
    target.write("\n".join(head).encode())
    x, y = document.axes()
    for r, northing in enumerate(y):
        columns = [[exact_metres(one) for one in x], [exact_metres(northing)] * len(x)]
        if plane is not None:
            longitude, latitude = plane.arrays_to_wgs84(x, np.full(len(x), northing))
            columns += [[f"{one:.9f}" for one in longitude], [f"{one:.9f}" for one in latitude]]
        columns += [[exact(one) for one in layer.values[r].tolist()] for layer in layers]
        target.write("".join(" ".join(row) + "\n" for row in zip(*columns, strict=True)).encode())


def exact_metres(value: float) -> str:
    """Coordinate to the micrometre, without a tail of zeros."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


def read_xyz(content: bytes) -> Rasters:
    """Read nodes in any order; nodes of the lattice that are not there are NaN.

    Without a header line the columns are ``x``, ``y`` and one layer named ``value``.

    Raises
    ------
    InputError
        Names the line that cannot be read, or says why the nodes are no lattice.
    """
    attributes: dict[str, Value] = {}
    names: list[str] | None = None
    rows: list[list[float]] = []
    for number, line in lines_of(io.BytesIO(content), longest=100_000):
        text = line.strip()
        if text.startswith(("#", "/", "%")):
            if (found := attribute_of(text)) is not None:
                attributes[found[0]] = found[1]
        elif text:
            parts = text.replace(",", " ").replace(";", " ").split()
            if names is None:
                names = _header(parts, number)
                if not _is_number(parts[0]):
                    continue
            rows.append(_row(parts, len(names), number, len(rows)))
    if names is None or not rows:
        raise InputError("file", "has no nodes; send lines of x, y and values")
    return _rasters(names, np.array(rows), attributes)


def _header(parts: Sequence[str], number: int) -> list[str]:
    if len(parts) > _MAX_COLUMNS:
        raise InputError(f"line {number}", f"has {len(parts)} columns; send at most {_MAX_COLUMNS}")
    if _is_number(parts[0]):
        if len(parts) != 3:
            raise InputError(
                f"line {number}", f"has {len(parts)} columns without names; begin with a header line: x y ..."
            )
        return ["x", "y", "value"]
    # the first x and y are places; a component called x or y comes later, or as mean_x
    lower = [part.strip('"').lower() for part in parts]
    if lower[:2] != ["x", "y"] or len(lower) < 3 or len(set(lower)) != len(lower):
        raise InputError(
            f"line {number}", "should name the columns: x y, then layers of different names; places in level metres"
        )
    return lower


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _row(parts: Sequence[str], n: int, number: int, before: int) -> list[float]:
    if len(parts) != n:
        raise InputError(
            f"line {number}", f"has {len(parts)} values, the header {n} columns; complete or remove the line"
        )
    if before >= _MAX_NODES:
        raise InputError(f"line {number}", f"is beyond {_MAX_NODES} nodes; send netCDF, or a coarser grid")
    return [number_at(part, number) for part in parts]


def _rasters(names: Sequence[str], table: Float64Array, attributes: dict[str, Value]) -> Rasters:
    x, column = _lattice("x", table[:, 0])
    y, row = _lattice("y", table[:, 1])
    if len(x) * len(y) > _MAX_NODES:
        raise InputError("file", f"spans {len(x)} x {len(y)} nodes; are these points on a lattice? grid them first")
    places = row * len(x) + column
    if len(np.unique(places)) != len(places):
        raise InputError("file", "has a node twice; send each node once, on an even lattice")
    layers = {}
    for i, name in enumerate(names[2:], start=2):
        if name not in _PLACES:
            layers[name] = np.full((len(y), len(x)), np.nan)
            layers[name].ravel()[places] = table[:, i]
    units = _units(attributes.pop("units", ""))
    return Rasters(x, y, layers, {name: unit for name, unit in units.items() if name in layers}, attributes)


def _lattice(name: str, values: Float64Array) -> tuple[Float64Array, IntArray]:
    """Coordinates of the lattice along one axis, and each node's index into them."""
    if not np.isfinite(values).all():
        raise InputError(name, "is not a number everywhere; send coordinates in metres")
    different = np.unique(values)
    gaps = np.diff(different)
    if not len(gaps):
        raise InputError(name, "is the same everywhere; send a grid of at least 2 x 2 nodes")
    step = float(np.median(gaps[gaps > _SAME * gaps.max()]))
    span = float(different[-1] - different[0]) / step
    if not span < _MAX_NODES:
        raise InputError(name, "spans too much for its spacing; are these points on a lattice? grid them first")
    n = round(span) + 1
    axis = different[0] + (different[-1] - different[0]) * np.arange(n) / max(1, n - 1)
    index = np.rint((values - different[0]) / (axis[-1] - axis[0]) * (n - 1)).astype(np.int64)
    off = np.abs(axis[index] - values)
    if off.max() > 1e-3 * step:
        worst = float(values[int(off.argmax())])
        raise InputError(name, f"is not evenly spaced ({worst:g} is off the lattice); grid the points first")
    return axis, index


def _units(text: Value) -> dict[str, str]:
    pairs = (part.partition("=") for part in text.split()) if isinstance(text, str) else ()
    return {name: unit for name, equals, unit in pairs if equals}
