"""Reader of aeromagnetic flight lines: ``aero/<survey>.parquet``, one row a reading.

Two layouts are known by their columns: ``line_type`` and ``line_number`` (Rio de Janeiro), ``survey_area`` and
``line_segment`` (Great Britain). A flight line may be recorded in several segments; whoever leaves lines out of a map
leaves out all segments of a line, for they run into one another.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from app.engine.types import Float64Array
from app.evaluation.datasets.columns import column, read_table
from app.evaluation.errors import DataSetError

_PLACE = ("longitude", "latitude", "altitude_m", "total_field_anomaly_nt")
_SEGMENTS_PER_LINE = 10
"""Numbers of Rio's lines: the last digit counts the segments of a line."""


@dataclass(frozen=True, slots=True)
class FlightSegment:
    """Readings of one segment of a flight line, in the order of the file.

    Attributes
    ----------
    name : str
    line : str
        Flight line that it belongs to.
    tie : bool
        Whether it crosses the survey's lines to tie them together.
    longitude, latitude : array, shape (n,), degrees
    altitude_m : array, shape (n,), m
    anomaly_nt : array, shape (n,), nT
        Total field less the reference field.
    """

    name: str
    line: str
    tie: bool
    longitude: Float64Array
    latitude: Float64Array
    altitude_m: Float64Array
    anomaly_nt: Float64Array

    def __len__(self) -> int:
        return int(self.longitude.shape[0])


@dataclass(frozen=True)
class AeroSurvey:
    """One survey; its file is read on first use and kept."""

    name: str
    path: Path = field(repr=False)

    @cached_property
    def segments(self) -> tuple[FlightSegment, ...]:
        """Segments in the order in which the file first names them; readings that are not finite are left out."""
        return _read_segments(self.path)


@dataclass(frozen=True)
class Aero:
    """The data set: a folder of surveys."""

    folder: Path
    _surveys: dict[str, AeroSurvey] = field(repr=False)

    def surveys(self) -> tuple[str, ...]:
        """Names of the surveys found, sorted."""
        return tuple(self._surveys)

    def survey(self, name: str) -> AeroSurvey:
        """One survey by name; raises :class:`DataSetError` if it is not there."""
        if name not in self._surveys:
            raise DataSetError(self.folder, f"has no survey {name!r}; found: {', '.join(self._surveys)}")
        return self._surveys[name]


def open_aero(data_dir: Path) -> Aero:
    """Open the data set below ``data_dir`` (the folder that holds ``aero/``, or that folder itself).

    Raises
    ------
    DataSetError
        No survey is found.
    """
    for folder in (data_dir / "aero", data_dir):
        found = {path.stem: AeroSurvey(path.stem, path) for path in sorted(folder.glob("*.parquet"))}
        if found:
            return Aero(folder, found)
    raise DataSetError(data_dir, "holds no aero/<survey>.parquet")


def _read_segments(path: Path) -> tuple[FlightSegment, ...]:
    try:
        names = pq.read_schema(path).names
    except (OSError, pa.ArrowInvalid) as error:
        raise DataSetError(path, f"cannot be read ({error})") from error
    numbered = "line_number" in names
    table = read_table(
        path, (*_PLACE, *(("line_type", "line_number") if numbered else ("survey_area", "line_segment")))
    )
    longitude, latitude, altitude, anomaly = (column(table, name) for name in _PLACE)
    keys = _numbered(table) if numbered else _named(table)
    rows: dict[tuple[str, str, bool], list[int]] = {}
    usable = np.isfinite(longitude) & np.isfinite(latitude) & np.isfinite(anomaly)
    for row in np.flatnonzero(usable).tolist():
        rows.setdefault(keys[row], []).append(row)
    return tuple(
        FlightSegment(name, line, tie, longitude[own], latitude[own], altitude[own], anomaly[own])
        for (name, line, tie), own in rows.items()
    )


def _numbered(table: pa.Table) -> list[tuple[str, str, bool]]:
    kinds, numbers = table["line_type"].to_pylist(), table["line_number"].to_pylist()
    return [
        (f"{kind}-{number}", f"{kind}-{int(number) // _SEGMENTS_PER_LINE}", kind == "TIE")
        for kind, number in zip(kinds, numbers, strict=True)
    ]


def _named(table: pa.Table) -> list[tuple[str, str, bool]]:
    """``FL-39-5`` of an area is segment 5 of its flight line 39; what does not begin with F is a tie line."""
    areas, segments = table["survey_area"].to_pylist(), table["line_segment"].to_pylist()
    return [
        (f"{area}-{segment}", f"{area}-{segment.rpartition('-')[0] or segment}", not segment.startswith("F"))
        for area, segment in zip(areas, segments, strict=True)
    ]
