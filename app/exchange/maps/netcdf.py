"""Maps as netCDF classic files that follow CF-1.11 (cfconventions.org).

Layers are float32 exactly as the service keeps them. There is no CF standard name for magnetic flux density, so layers
have long names only; where the venue is anchored, every node also has its longitude and latitude (auxiliary
coordinates, which hold for any bearing of the level frame) on the WGS 84 ellipsoid that the grid mapping describes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from app.engine.errors import InputError
from app.engine.geodesy import TangentPlane
from app.engine.types import Float64Array
from app.exchange.maps.classic import Attribute, Dataset, Variable, read_classic
from app.exchange.maps.document import MapDocument, Rasters, Value

CONVENTIONS = "CF-1.11"
_ROWS_AT_ONCE = 256
_CRS, _LONGITUDE, _LATITUDE = "crs", "longitude", "latitude"
_WGS84: Mapping[str, Value] = {
    "grid_mapping_name": "latitude_longitude",
    "long_name": "WGS 84",
    "semi_major_axis": 6378137.0,
    "inverse_flattening": 298.257223563,
    "longitude_of_prime_meridian": 0.0,
}


def write_netcdf(document: MapDocument, target: BinaryIO) -> None:
    """Write a map; equal maps with equal texts give equal bytes."""
    buffer = io.BytesIO()
    file = netcdf_file(buffer, "w")
    _describe(file, {"Conventions": CONVENTIONS, **document.attributes()})
    x, y = document.axes()
    _axis(file, "x", x)
    _axis(file, "y", y)
    shared: dict[str, Value] = {}
    if document.plane is not None:
        _places(file, document.plane, x, y)
        shared = {"coordinates": f"{_LATITUDE} {_LONGITUDE}", "grid_mapping": _CRS}
    for layer in document.layers():
        variable = file.createVariable(layer.name, "f4", ("y", "x"))
        variable[:] = layer.values
        _describe(variable, {"long_name": layer.words, "units": layer.unit, **shared})
    file.flush()
    target.write(buffer.getbuffer())


def _describe(thing: Any, attributes: Mapping[str, Value]) -> None:
    """Set attributes; numbers as doubles (plain Python floats would be stored as float32)."""
    for name, value in attributes.items():
        setattr(thing, name, value.encode() if isinstance(value, str) else np.atleast_1d(np.asarray(value, ">f8")))


def _axis(file: Any, name: str, values: Float64Array) -> None:
    file.createDimension(name, len(values))
    variable = file.createVariable(name, "f8", (name,))
    variable[:] = values
    words = f"{name} of the level frame"
    _describe(variable, {"long_name": words, "units": "m", "axis": name.upper()})


def _places(file: Any, plane: TangentPlane, x: Float64Array, y: Float64Array) -> None:
    crs = file.createVariable(_CRS, "i4", ())
    _describe(crs, _WGS84)
    longitude = file.createVariable(_LONGITUDE, "f8", ("y", "x"))
    latitude = file.createVariable(_LATITUDE, "f8", ("y", "x"))
    _describe(longitude, {"standard_name": _LONGITUDE, "units": "degrees_east"})
    _describe(latitude, {"standard_name": _LATITUDE, "units": "degrees_north"})
    for start in range(0, len(y), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        longitude[rows], latitude[rows] = plane.arrays_to_wgs84(*np.meshgrid(x, y[rows]))


def read_netcdf(content: bytes) -> Rasters:
    """Read the two-dimensional variables of a file that lie on one lattice.

    Raises
    ------
    InputError
        No netCDF classic file, no such variables, or a lattice in degrees.
    """
    dataset = read_classic(content)
    planes = {
        name: one
        for name, one in dataset.variables.items()
        if len(one.dimensions) == 2 and one.values.dtype.kind in "fi" and name not in {_LONGITUDE, _LATITUDE}
    }
    if not planes:
        raise InputError("file", "has no variable of two dimensions; send a grid with dimensions (y, x)")
    dimensions = next(iter(planes.values())).dimensions
    y_name, x_name = _ordered(dataset, dimensions)
    x, y = _coordinate(dataset, x_name), _coordinate(dataset, y_name)
    layers = {}
    for name, one in planes.items():
        if set(one.dimensions) != set(dimensions):
            raise InputError(name, f"lies on {one.dimensions}, others on {dimensions}; send variables of one lattice")
        values = _values(one)
        layers[name] = values if one.dimensions == (y_name, x_name) else values.T
    x, across = _ascending(x)
    y, up = _ascending(y)
    layers = {name: values[::up, ::across] for name, values in layers.items()}
    units = {name: unit for name, one in planes.items() if isinstance(unit := one.attributes.get("units"), str)}
    attributes = {name: _plain(value) for name, value in dataset.attributes.items()}
    return Rasters(x, y, layers, units, attributes)


def _ordered(dataset: Dataset, dimensions: tuple[str, ...]) -> tuple[str, str]:
    """Names of the dimensions along y and along x: by their ``axis`` attribute, else by name, else in CF's order."""
    for first, second in (dimensions, dimensions[::-1]):
        variable = dataset.variables.get(second)
        axis = variable.attributes.get("axis") if variable is not None else None
        if axis == "X" or (axis is None and second.lower() in {"x", "easting", "east"}):
            return first, second
    return dimensions[0], dimensions[1]


def _coordinate(dataset: Dataset, name: str) -> Float64Array:
    variable = dataset.variables.get(name)
    if variable is None or variable.dimensions != (name,) or variable.values.dtype.kind not in "fi":
        raise InputError(name, "is a dimension without coordinates; add a variable of that name with metres")
    unit = str(variable.attributes.get("units", "m")).strip().lower()
    if unit.startswith("degree"):
        raise InputError(name, "is in degrees; send a grid in metres of the level frame")
    scale = {"km": 1000.0, "kilometre": 1000.0, "kilometer": 1000.0, "cm": 0.01, "mm": 0.001}.get(unit, 1.0)
    return variable.values.astype(np.float64) * scale


def _ascending(axis: Float64Array) -> tuple[Float64Array, int]:
    """An axis from its low end on, and the step that brings layers into that order."""
    step = -1 if len(axis) > 1 and axis[0] > axis[-1] else 1
    return axis[::step], step


def _values(variable: Variable) -> Float64Array:
    """Values as numbers: packed ones unpacked (CF 8.1), missing ones NaN; float32 stays float32."""
    raw = variable.values
    values: NDArray[Any] = raw.astype(np.float32 if raw.dtype.str == ">f4" else np.float64)
    for name in ("_FillValue", "missing_value"):
        missing = variable.attributes.get(name)
        if isinstance(missing, tuple) and missing:
            values = np.where(values == np.asarray(missing[0], values.dtype), np.asarray(np.nan, values.dtype), values)
    scale, offset = (variable.attributes.get(name) for name in ("scale_factor", "add_offset"))
    if isinstance(scale, tuple) or isinstance(offset, tuple):
        values = values.astype(np.float64) * _number(scale, 1.0) + _number(offset, 0.0)
    unpacked: Float64Array = values
    return unpacked


def _number(attribute: Attribute | None, default: float) -> float:
    return attribute[0] if isinstance(attribute, tuple) and attribute else default


def _plain(value: Attribute) -> Value:
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
