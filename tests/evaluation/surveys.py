"""Stand-ins of the ``aero`` folder: flight lines over a field that is smooth in the west and rough in the east."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from app.engine.geodesy import TangentPlane
from app.engine.types import Float64Array
from app.evaluation.papers.anomalies import AnomalySettings

PLANE = TangentPlane(-22.3, -42.5)
WIDTH_M, HEIGHT_M = 36_000.0, 18_000.0
SETTINGS = AnomalySettings(cell_m=400.0, side_m=17_600.0, inset_m=1500.0)


def anomaly_nt(x: Float64Array, y: Float64Array, *, seed: int = 5) -> Float64Array:
    """Field at points (m): waves of 6 to 20 km everywhere, of 3 km in the east."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(x)
    for length, share in ((20e3, 1.0), (12e3, 1.0), (6e3, 1.0), (3e3, 0.0), (3e3, 0.0), (3e3, 0.0)):
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        wave = np.sin(2.0 * np.pi / length * (np.cos(angle) * x + np.sin(angle) * y) + phase)
        total += 40.0 * wave * np.where(x > 0.0, 1.0, share)
    return total


def write_aero(folder: Path, *, spacing_m: float = 1000.0) -> Path:
    """Lines along y every ``spacing_m``, two ties along x; in the layout of numbered lines. Returns the file."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for number, x in enumerate(np.arange(-WIDTH_M / 2, WIDTH_M / 2 + 1.0, spacing_m)):
        y = np.arange(-HEIGHT_M / 2, HEIGHT_M / 2 + 1.0, 400.0)[:: 1 if number % 2 else -1]
        parts.append((np.full(len(y), x), y, "LINE", 1000 + 10 * number))
    for number, y in enumerate((-4000.0, 4000.0)):
        x = np.arange(-WIDTH_M / 2, WIDTH_M / 2 + 1.0, 400.0)
        parts.append((x, np.full(len(x), y), "TIE", 9000 + 10 * number))
    x, y = (np.concatenate([part[k] for part in parts]) for k in range(2))
    place = np.array([PLANE.to_wgs84(float(a), float(b)) for a, b in zip(x, y, strict=True)])
    kinds = [part[2] for part in parts for _ in part[0]]
    table = {
        "longitude": place[:, 0],
        "latitude": place[:, 1],
        "total_field_anomaly_nt": anomaly_nt(x, y).astype(np.float32),
        "altitude_m": np.full(len(x), 100.0, dtype=np.float32),
        "line_type": pa.array(kinds).dictionary_encode(),
        "line_number": np.concatenate([np.full(len(part[0]), part[3]) for part in parts]).astype(np.int32),
    }
    path = folder / "rio.parquet"
    pq.write_table(pa.table(table), path)
    return path
