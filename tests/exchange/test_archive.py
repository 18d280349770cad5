"""Survey archives: what goes out comes in; damaged ones are refused in words."""

from __future__ import annotations

import contextlib
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.engine.errors import InputError
from app.exchange.surveys import read_survey, read_walk, survey_archive, walk_body
from tests.exchange.recordings import SENSORS, WALK
from tests.support.builders import scans

WITH_RADIO = replace(WALK, wifi=scans(), ble=scans(3))


def written(path: Path, *, radio: bool = True) -> Path:
    with path.open("wb") as file:
        for piece in survey_archive({"survey": "spring"}, [("one", WITH_RADIO), ("zwei", WALK)], radio=radio):
            file.write(piece)
    return path


@pytest.mark.parametrize("folder", [False, True])
def test_what_goes_out_comes_in(tmp_path: Path, folder: bool) -> None:
    path = written(tmp_path / "survey.zip")
    if folder:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(tmp_path / "survey")
        path = tmp_path / "survey"
    (name, one), (second, two) = read_survey(path)
    assert (name, second) == ("one", "zwei")
    for walk in (one, two):
        assert walk.samples.t == pytest.approx(WALK.samples.t, abs=1e-6)
        for sensor in SENSORS:
            assert np.array_equal(getattr(walk.samples, sensor), getattr(WALK.samples, sensor).astype(np.float32))
        assert np.array_equal(walk.waypoints.x, WALK.waypoints.x)
    assert one.wifi is not None
    assert WITH_RADIO.wifi is not None
    assert one.wifi.address == WITH_RADIO.wifi.address
    assert (two.wifi, two.ble) == (None, None)


def test_radio_stays_behind_unless_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path / "survey.zip", radio=False)
    assert all((walk.wifi, walk.ble) == (None, None) for _, walk in read_survey(path))
    with zipfile.ZipFile(path) as archive:
        everything = b"".join(archive.read(name) for name in archive.namelist())
    assert scans().address[0].encode() not in everything


def test_other_files_are_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    cases = {"survey.json": empty}
    text = tmp_path / "text.zip"
    text.write_text("no archive")
    foreign = tmp_path / "foreign.zip"
    with zipfile.ZipFile(foreign, "w") as archive:
        archive.writestr("survey.json", json.dumps({"format": "other"}))
    for words, path in {**cases, "no readable zip": text, "does not say format": foreign}.items():
        with pytest.raises(InputError, match=words):
            list(read_survey(path))
    truncated = tmp_path / "cut.zip"
    truncated.write_bytes(written(tmp_path / "survey.zip").read_bytes()[:-200])
    with pytest.raises(InputError):
        list(read_survey(truncated))


BODY = walk_body("walk", replace(WITH_RADIO, samples=replace(WALK.samples, **{
    name: getattr(WALK.samples, name)[:5] for name in ("t", *SENSORS)
})), radio=True)  # fmt: skip


@pytest.mark.parametrize("field", ["samples", "waypoints"])
def test_what_is_missing_is_named(field: str) -> None:
    body = msgpack.unpackb(BODY)
    del body[field]
    with pytest.raises(InputError, match=field):
        read_walk(msgpack.packb(body), "walks/0001.msgpack")


@settings(max_examples=80, deadline=None)
@given(st.integers(0, len(BODY)), st.binary(max_size=20), st.integers(0, 20))
def test_nothing_crashes_the_reader(at: int, junk: bytes, cut: int) -> None:
    with contextlib.suppress(InputError):
        _, walk = read_walk(BODY[:at] + junk + BODY[at + cut :], "walk")
        assert np.isfinite(walk.samples.mag).all()
