"""The reader of flight lines, in both layouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from app.evaluation.datasets.aero import open_aero
from app.evaluation.errors import DataSetError
from tests.evaluation.surveys import write_aero

PLACE = {
    "longitude": [1.0, 1.1, 1.2, 1.3], "latitude": [50.0, 50.0, 50.1, 50.1], "altitude_m": [300.0] * 4,
    "total_field_anomaly_nt": [10.0, float("nan"), 30.0, 40.0],
}  # fmt: skip


def write(path: Path, **columns: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(PLACE | columns), path)


def test_numbered_lines(tmp_path: Path) -> None:
    write(
        tmp_path / "aero" / "rio.parquet",
        line_type=["LINE", "LINE", "LINE", "TIE"],
        line_number=[1680, 1680, 1681, 9580],
    )
    segments = open_aero(tmp_path).survey("rio").segments
    assert [(s.name, s.line, s.tie, len(s)) for s in segments] == [
        ("LINE-1680", "LINE-168", False, 1),  # its other reading is not a number
        ("LINE-1681", "LINE-168", False, 1),
        ("TIE-9580", "TIE-958", True, 1),
    ]
    assert segments[1].anomaly_nt.tolist() == [30.0]


def test_named_segments(tmp_path: Path) -> None:
    write(
        tmp_path / "aero" / "britain.parquet",
        survey_area=["CA63"] * 4,
        line_segment=["FL-2-1", "FL-2-1", "FL-2-2", "TL-3-1"],
    )
    segments = open_aero(tmp_path / "aero").survey("britain").segments
    assert [(s.line, s.tie) for s in segments] == [("CA63-FL-2", False), ("CA63-FL-2", False), ("CA63-TL-3", True)]


def test_a_line_that_comes_in_pieces_is_one_segment(tmp_path: Path) -> None:
    write(tmp_path / "aero" / "rio.parquet", line_type=["LINE"] * 4, line_number=[10, 20, 10, 20])
    segments = open_aero(tmp_path).survey("rio").segments
    assert [s.longitude.tolist() for s in segments] == [[1.0, 1.2], [1.3]]


def test_what_is_not_there_or_not_a_survey_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataSetError, match="holds no aero"):
        open_aero(tmp_path)
    path = write_aero(tmp_path / "aero")
    with pytest.raises(DataSetError, match="found: rio"):
        open_aero(tmp_path).survey("mars")
    pq.write_table(pq.read_table(path).drop_columns("altitude_m"), path)
    with pytest.raises(DataSetError, match="lacks the columns altitude_m"):
        _ = open_aero(tmp_path).survey("rio").segments
    path.write_bytes(b"no parquet")
    with pytest.raises(DataSetError, match="cannot be read"):
        _ = open_aero(tmp_path).survey("rio").segments


def test_all_readings_are_read(tmp_path: Path) -> None:
    write_aero(tmp_path / "aero")
    segments = open_aero(tmp_path).survey("rio").segments
    assert sum(segment.tie for segment in segments) == 2
    assert np.isfinite(np.concatenate([segment.anomaly_nt for segment in segments])).all()
