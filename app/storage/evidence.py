"""The evidence of a map as compressed, content-hashed tiles.

A tile holds the rows of a square of 32 m whose corners are multiples of 32 m in the level frame, whatever the extent of
the map: versions that differ in one corner share all other tiles. It is a fixed header (magic, version, number of
sources, rows and channels, length of the sources' text) and one zlib stream: the sources as JSON, then the columns,
little-endian. The hash covers the uncompressed values.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from app.engine.errors import MapError
from app.engine.types import Evidence, EvidenceSource, FeatureSet, SourceKind
from app.services.ports import Box
from app.services.records import PackedTile

TILE_M = 32.0
_PREFIX = struct.Struct("<2sBBIII")
_MAGIC = b"IE"
_VERSION = 1
_LEVEL = 1


def pack_evidence(evidence: Evidence) -> tuple[PackedTile, ...]:
    """Cut evidence into compressed, hashed tiles, in order of row and column."""
    if not len(evidence):
        return ()
    place = np.floor(evidence.xy[:, ::-1] / TILE_M).astype(np.int64)
    tiles, member = np.unique(place, axis=0, return_inverse=True)
    order = np.argsort(member, kind="stable")
    bounds = np.searchsorted(member[order], np.arange(len(tiles) + 1))
    return tuple(
        _pack(evidence.subset(order[bounds[i] : bounds[i + 1]]), int(row), int(column))
        for i, (row, column) in enumerate(tiles)
    )


def unpack_evidence(features: FeatureSet, tiles: Iterable[bytes]) -> Evidence:
    """Inverse of :func:`pack_evidence`, rows tile by tile; MapError if a tile is damaged."""
    parts = [_unpack(features, data) for data in tiles]
    return Evidence.joined(parts) if parts else Evidence.empty(features)


def pack_rows(rows: Evidence) -> bytes:
    """Rows as one blob, wherever they lie."""
    return _pack(rows, 0, 0).data


def tiles_in(box: Box) -> tuple[range, range]:
    """Rows and columns of the tiles that a box touches."""
    first_column, first_row, last_column, last_row = (int(np.floor(v / TILE_M)) for v in box)
    return range(first_row, last_row + 1), range(first_column, last_column + 1)


def _pack(rows: Evidence, row: int, column: int) -> PackedTile:
    sources = json.dumps([_plain(source) for source in rows.sources], separators=(",", ":")).encode()
    values = sources + b"".join(np.ascontiguousarray(part).tobytes() for part in _columns(rows))
    head = _PREFIX.pack(
        _MAGIC, _VERSION, rows.values.shape[1], len(rows.sources), len(rows), len(sources)
    )  # fmt: skip
    return PackedTile(hashlib.sha256(head + values).hexdigest(), row, column, head + zlib.compress(values, _LEVEL))


def _columns(rows: Evidence) -> Iterator[np.ndarray[tuple[int, ...], np.dtype[np.generic]]]:
    yield rows.source.astype("<i4")
    for column in (rows.xy, rows.values, rows.spread, rows.weight):
        yield column.astype("<f4")


def _plain(source: EvidenceSource) -> Sequence[str | float]:
    return source.id, source.kind.value, source.contributor, source.device, source.t


def _unpack(features: FeatureSet, data: bytes) -> Evidence:
    if len(data) < _PREFIX.size:
        raise MapError("a tile of the map's evidence is shorter than its header")
    magic, version, channels, n_sources, n, text = _PREFIX.unpack_from(data)
    if (magic, version) != (_MAGIC, _VERSION) or channels != len(features.channels):
        raise MapError(f"evidence {magic!r} of version {version} with {channels} channels is not {_MAGIC!r} {_VERSION}")
    try:
        values = zlib.decompress(memoryview(data)[_PREFIX.size :])
    except zlib.error as error:
        raise MapError(f"damaged evidence of the map: {error}") from error
    widths = (1, 2, channels, 1, 1)
    if len(values) != text + 4 * n * sum(widths):
        raise MapError(f"{len(values)} bytes are not {n} rows of evidence from {n_sources} sources")
    sources = tuple(
        EvidenceSource(identity, SourceKind(kind), contributor, device, float(t))
        for identity, kind, contributor, device, t in json.loads(values[:text])
    )
    at = text + 4 * n * np.cumsum((0, *widths))
    source, xy, field, spread, weight = (
        np.frombuffer(values, "<i4" if i == 0 else "<f4", n * width, int(at[i])) for i, width in enumerate(widths)
    )
    return Evidence(
        features=features,
        sources=sources,
        source=source.astype(np.int32, copy=False),
        xy=xy.reshape(n, 2).astype(np.float32, copy=False),
        values=field.reshape(n, channels).astype(np.float32, copy=False),
        spread=spread.astype(np.float32, copy=False),
        weight=weight.astype(np.float32, copy=False),
    )
