"""Maps as documents, and files of others."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np

from app.engine.geodesy import TangentPlane
from app.engine.types import FeatureSet, GridMap, RouteLines
from app.exchange.maps import ImportChoices, ImportedMap, MapDocument, MapFormat, read_map, write_map
from tests.support.builders import grid_map, radio_map

PLANE = TangentPlane(48.1507, 11.5691, 12.5, 515.0)


def document(
    features: FeatureSet = FeatureSet.VECTOR,
    *,
    plane: TangentPlane | None = PLANE,
    rows: int = 12,
    columns: int = 17,
    plan: bool = True,
    **changes: object,
) -> MapDocument:
    routes = RouteLines(np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), np.array([0], np.int32))
    grid = grid_map(features=features, rows=rows, columns=columns, plan=plan, radio=radio_map(), routes=routes)
    made = MapDocument(
        grid=grid,
        title="Magnetic map of the Grüner Hof, <F2> & more",
        history="2026-11-22T08:00:00Z built",
        licence="CC BY 4.0",
        attribution="those who walked",
        map_id="map_1",
        version=3,
        content_hash="5f0c" * 16,
        length_scale_m=3.4,
        field_sd=tuple(5.0 + i for i in range(len(features.channels))),
        software="isodyn 0.1",
        plane=plane,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def written(made: MapDocument, kind: MapFormat) -> bytes:
    target = io.BytesIO()
    write_map(made, kind, target)
    return target.getvalue()


def read(content: bytes, kind: MapFormat, **choices: object) -> ImportedMap:
    return read_map(content, kind, "lvl", ImportChoices(**choices))  # type: ignore[arg-type]


def same(one: GridMap, other: GridMap) -> bool:
    arrays = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("mean", "sd", "support"))
    places = (one.features, one.x0, one.y0, one.cell_m, one.mapped_m, one.noise_sd)
    return arrays and places == (other.features, other.x0, other.y0, other.cell_m, other.mapped_m, other.noise_sd)


def esri(values: np.ndarray, *, x: float = 0.0, y: float = 2.25, cell: float = 0.5, corner: bool = False) -> bytes:
    """A grid as another program writes it; row 0 of ``values`` is the northernmost."""
    word = "corner" if corner else "center"
    head = f"NCOLS {values.shape[1]}\nNROWS {values.shape[0]}\nXLL{word.upper()} {x}\nYLL{word.upper()} {y}\n"
    body = "\n".join(" ".join(f"{value:.6g}" for value in row) for row in values)
    return f"{head}CELLSIZE {cell}\nNODATA_VALUE -9999\n{body}\n".encode()
