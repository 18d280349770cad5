"""Maps as content-hashed tiles.

A tile is 64 x 64 cells (less at the far edges) of all layers (means, standard deviations, support and, with a floor
plan, depth in obstacles), little-endian float32, stored as zlib-compressed byte planes. Hashes cover the
*uncompressed* values, so equal content has one hash whatever zlib packed it; a tile that two map versions have in
common is stored once. A map's hash covers its header, its tiles' hashes and, if it has them, those of its radio layer
(:mod:`app.storage.radio`) and of its lines (:mod:`app.storage.routes`).
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.errors import MapError
from app.engine.types import FeatureSet, Float32Array, GridMap, RadioMap, RouteLines
from app.services.records import PackedMap, PackedTile
from app.storage.radio import pack_radio, unpack_radio
from app.storage.routes import pack_routes, unpack_routes

TILE = 64
_LEVEL = 1  # level 6 saves 3 % of real maps and takes four times as long


@dataclass(frozen=True, slots=True)
class MapHeader:
    """What of a :class:`GridMap` is not its arrays."""

    level_id: str
    features: FeatureSet
    x0: float
    y0: float
    cell_m: float
    rows: int
    columns: int
    mapped_m: float
    noise_sd: tuple[float, ...]
    has_obstacle: bool

    @property
    def n_layers(self) -> int:
        """Mean and sd of each channel, support, and obstacle if there is one."""
        return 2 * len(self.features.channels) + 1 + self.has_obstacle

    def to_json(self) -> str:
        """Stable text: equal headers give equal text."""
        return json.dumps(self.values(), sort_keys=True)

    def values(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {name: getattr(self, name) for name in self.__slots__}

    @classmethod
    def from_json(cls, text: str) -> MapHeader:
        """Inverse of :meth:`to_json`."""
        return cls.from_values(json.loads(text))

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> MapHeader:
        """Inverse of :meth:`values`, also after JSON, where tuples come back as lists."""
        features, noise_sd = FeatureSet(values["features"]), tuple(values["noise_sd"])
        return cls(**{**values, "features": features, "noise_sd": noise_sd})


def header_of(grid_map: GridMap) -> MapHeader:
    """Header of a map."""
    rows, columns = grid_map.shape
    return MapHeader(
        level_id=grid_map.level_id,
        features=grid_map.features,
        x0=float(grid_map.x0),
        y0=float(grid_map.y0),
        cell_m=float(grid_map.cell_m),
        rows=rows,
        columns=columns,
        mapped_m=float(grid_map.mapped_m),
        noise_sd=tuple(float(sd) for sd in grid_map.noise_sd),
        has_obstacle=grid_map.obstacle is not None,
    )


def stack_layers(grid_map: GridMap) -> Float32Array:
    """Means, standard deviations, support and obstacle, if any, as one array, shape (layers, rows, columns)."""
    single = [grid_map.support] if grid_map.obstacle is None else [grid_map.support, grid_map.obstacle]
    return np.concatenate([grid_map.mean, grid_map.sd, np.stack(single)]).astype("<f4", copy=False)


def split_layers(
    header: MapHeader, layers: Float32Array, radio: RadioMap | None = None, routes: RouteLines | None = None
) -> GridMap:
    """Inverse of :func:`stack_layers`; the arrays are views."""
    channels = len(header.features.channels)
    if layers.shape != (header.n_layers, header.rows, header.columns):
        raise MapError(f"layers of shape {layers.shape} do not fit the header {header}")
    return GridMap(
        level_id=header.level_id,
        features=header.features,
        x0=header.x0,
        y0=header.y0,
        cell_m=header.cell_m,
        mean=layers[:channels],
        sd=layers[channels : 2 * channels],
        support=layers[2 * channels],
        mapped_m=header.mapped_m,
        noise_sd=header.noise_sd,
        obstacle=layers[2 * channels + 1] if header.has_obstacle else None,
        radio=radio,
        routes=routes,
    )


def pack_map(grid_map: GridMap) -> PackedMap:
    """Cut a map into compressed, hashed tiles, its radio layer and its lines into a blob each."""
    header = header_of(grid_map)
    layers = stack_layers(grid_map)
    tiles = tuple(_pack_tile(layers, row, column) for row, column in _places(header.rows, header.columns))
    digest = hashlib.sha256(header.to_json().encode())
    for tile in tiles:
        digest.update(f"\n{tile.row} {tile.column} {tile.hash}".encode())
    radio = None if grid_map.radio is None else pack_radio(grid_map.radio)
    if radio is not None:
        digest.update(f"\nradio {radio.hash}".encode())
    routes = None if grid_map.routes is None else pack_routes(grid_map.routes)
    if routes is not None:
        digest.update(f"\nroutes {routes.hash}".encode())
    return PackedMap(digest.hexdigest(), tiles, radio, routes)


def unpack_map(
    header: MapHeader,
    tiles: Iterable[tuple[int, int, bytes]],
    radio: bytes | None = None,
    routes: bytes | None = None,
) -> GridMap:
    """Assemble a map from ``(row, column, data)`` of all its tiles and the blobs of its radio layer and its lines.

    Raises
    ------
    MapError
        A tile is missing, or something is damaged.
    """
    layers = np.empty((header.n_layers, header.rows, header.columns), dtype=np.float32)
    missing = set(_places(header.rows, header.columns))
    for row, column, data in tiles:
        if (row, column) not in missing:
            raise MapError(f"tile ({row}, {column}) is outside the map or comes twice")
        missing.discard((row, column))
        target = layers[:, row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE]
        target[:] = _unpack_tile(data, target.shape)
    if missing:
        raise MapError(f"{len(missing)} tiles are missing, the first is {min(missing)}")
    return split_layers(
        header,
        layers,
        None if radio is None else unpack_radio(radio),
        None if routes is None else unpack_routes(routes),
    )


def header_from(values: Mapping[str, object]) -> MapHeader:
    """Header from a mapping that has its fields among others."""
    return MapHeader(**{name: values[name] for name in MapHeader.__slots__})  # type: ignore[arg-type]


def _places(rows: int, columns: int) -> Iterator[tuple[int, int]]:
    for row in range(-(-rows // TILE)):
        for column in range(-(-columns // TILE)):
            yield row, column


def _pack_tile(layers: Float32Array, row: int, column: int) -> PackedTile:
    values = layers[:, row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE].astype("<f4")
    raw = np.ascontiguousarray(values)
    planes = raw.view(np.uint8).reshape(raw.shape[0], -1, 4).transpose(0, 2, 1)
    return PackedTile(
        hash=hashlib.sha256(raw.data).hexdigest(), row=row, column=column, data=zlib.compress(planes.tobytes(), _LEVEL)
    )


def _unpack_tile(data: bytes, shape: tuple[int, ...]) -> Float32Array:
    try:
        planes = np.frombuffer(zlib.decompress(data), dtype=np.uint8)
    except zlib.error as error:
        raise MapError(f"damaged tile: {error}") from error
    if planes.size != 4 * int(np.prod(shape)):
        raise MapError(f"a tile of {planes.size} bytes does not have the shape {shape}")
    values = np.ascontiguousarray(planes.reshape(shape[0], 4, -1).transpose(0, 2, 1))
    return values.view("<f4").reshape(shape).astype(np.float32, copy=False)
