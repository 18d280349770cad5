"""Rasters of a map: channels and statistics as arrays, PNG images, raw float32, and run lengths."""

from __future__ import annotations

import io
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from PIL import Image

from app.api.colours import COLOURS, N_COLOURS
from app.api.errors import RejectedError
from app.api.validation import FieldError
from app.engine.mapping.components import magnitude
from app.engine.types import BoolArray, FeatureSet, Float32Array, GridMap


class Channel(StrEnum):
    """One component of the field, or what follows from several."""

    X = "x"
    Y = "y"
    Z = "z"
    H = "h"
    V = "v"
    TOTAL = "total"


class Statistic(StrEnum):
    """What of a channel is shown. ``support`` is the distance to the nearest survey sample, the same for all."""

    MEAN = "mean"
    SD = "sd"
    SUPPORT = "support"


CHANNELS: dict[FeatureSet, tuple[Channel, ...]] = {
    FeatureSet.VECTOR: tuple(Channel),
    FeatureSet.HV: (Channel.H, Channel.V, Channel.TOTAL),
    FeatureSet.TOTAL: (Channel.TOTAL,),
}
"""Channels a map of these features can show."""

_PARTS: dict[tuple[FeatureSet, Channel], tuple[int, ...]] = {
    (FeatureSet.VECTOR, Channel.X): (0,),
    (FeatureSet.VECTOR, Channel.Y): (1,),
    (FeatureSet.VECTOR, Channel.Z): (2,),
    (FeatureSet.VECTOR, Channel.H): (0, 1),
    (FeatureSet.VECTOR, Channel.V): (2,),
    (FeatureSet.VECTOR, Channel.TOTAL): (0, 1, 2),
    (FeatureSet.HV, Channel.H): (0,),
    (FeatureSet.HV, Channel.V): (1,),
    (FeatureSet.HV, Channel.TOTAL): (0, 1),
    (FeatureSet.TOTAL, Channel.TOTAL): (0,),
}
"""Stored channels a shown one is the norm of."""


@dataclass(frozen=True, slots=True)
class ColourRange:
    """Values shown in the first and the last colour."""

    low: float
    high: float


def field(grid: GridMap, channel: Channel, statistic: Statistic) -> Float32Array:
    """Raster of a channel, shape (rows, columns), NaN where the map is not mapped.

    ``support`` is finite everywhere: it says how far the map reaches. The standard deviation of a magnitude follows
    from those of its components to first order, taking them as independent.
    """
    if statistic is Statistic.SUPPORT:
        return np.array(grid.support, dtype=np.float32)
    parts = _PARTS.get((grid.features, channel))
    if parts is None:
        shown = ", ".join(CHANNELS[grid.features])
        raise RejectedError(
            [
                FieldError(
                    "channel", f"a map of features {grid.features!s} has no {channel!s}", f"choose one of: {shown}"
                )
            ]
        )
    values = magnitude(grid.mean[list(parts)], grid.sd[list(parts)])[0 if statistic is Statistic.MEAN else 1]
    shown_values: Float32Array = np.where(grid.mapped, values, np.float32(np.nan)).astype(np.float32)
    return shown_values


def colour_range(values: Float32Array, low: float | None, high: float | None) -> ColourRange:
    """Range of the colours: as asked for, else from the 1st to the 99th percentile of what is mapped."""
    finite = values[np.isfinite(values)]
    found = np.percentile(finite, (1, 99)) if finite.size else np.array([0.0, 1.0])
    first = float(found[0]) if low is None else low
    last = float(found[1]) if high is None else high
    return ColourRange(first, last if last > first else first + 1.0)


def png(values: Float32Array, shown: ColourRange) -> bytes:
    """Colour image, one pixel a node, row 0 at the bottom; NaN is transparent."""
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, shown.low) - shown.low) / (shown.high - shown.low), 0.0, 1.0)
    pixels = np.empty((*values.shape, 4), dtype=np.uint8)
    pixels[..., :3] = COLOURS[np.round(share * (N_COLOURS - 1)).astype(np.intp)]
    pixels[..., 3] = np.where(known, 255, 0)
    return _encode(np.ascontiguousarray(pixels[::-1]))


def place_headers(shape: tuple[int, int], x0: float, y0: float, cell_m: float) -> dict[str, str]:
    """Where a raster lies: headers beside its values."""
    return {
        "X-Isodyn-Rows": str(shape[0]),
        "X-Isodyn-Columns": str(shape[1]),
        "X-Isodyn-X0": repr(float(x0)),
        "X-Isodyn-Y0": repr(float(y0)),
        "X-Isodyn-Cell-M": repr(float(cell_m)),
    }


def legend(shown: ColourRange) -> dict[str, str]:
    """What the colours mean: headers beside an image."""
    return {"X-Isodyn-Low": f"{shown.low:.6g}", "X-Isodyn-High": f"{shown.high:.6g}"}


def coverage_png(mapped: BoolArray) -> bytes:
    """Opaque where mapped, transparent elsewhere, row 0 at the bottom."""
    pixels = np.zeros((*mapped.shape, 4), dtype=np.uint8)
    pixels[mapped] = (*COLOURS[N_COLOURS // 2], 255)
    return _encode(np.ascontiguousarray(pixels[::-1]))


def raw(values: Float32Array) -> bytes:
    """Little-endian float32, row by row from row 0 (the lowest y)."""
    return np.ascontiguousarray(values, dtype="<f4").tobytes()


def run_lengths(mapped: BoolArray) -> list[int]:
    """Lengths of alternating runs in row order, beginning with unmapped nodes (0 if the first is mapped)."""
    flat = mapped.ravel()
    if not flat.size:
        return [0]
    edges = np.flatnonzero(np.diff(flat)) + 1
    runs: list[int] = np.diff(np.concatenate(([0], edges, [flat.size]))).tolist()
    return [0, *runs] if flat[0] else runs


def png_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG image, None if it is none or damaged; pixels are not decoded."""
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            size = image.size
            image.verify()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None
    return size


def _encode(pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=6)
    return buffer.getvalue()
