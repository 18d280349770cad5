"""Compressed columns give back every bit of what the API accepts."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from app.engine.types import ImuSamples, PressureReadings, RadioScans, SpeedReadings, StepCounts, Waypoints
from app.services.aids import NO_AIDS, Aids, GnssReadings
from app.storage import columns
from tests.support.builders import all_aids, samples, scans

COUNTS = st.integers(0, 40)
ANY_FLOAT64 = st.floats(width=64, allow_nan=True, allow_infinity=True)
ANY_FLOAT32 = st.floats(width=32, allow_nan=True, allow_infinity=True)


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)


def _float64(n: int) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, n, elements=ANY_FLOAT64)


@st.composite
def any_samples(draw: st.DrawFn) -> ImuSamples:
    n = draw(COUNTS)
    sensors = [draw(hnp.arrays(np.float32, (n, 3), elements=ANY_FLOAT32)).astype(np.float64) for _ in range(3)]
    return ImuSamples(draw(_float64(n)), *sensors)


@st.composite
def any_scans(draw: st.DrawFn) -> RadioScans:
    n = draw(COUNTS)
    names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
    address = draw(st.lists(names, min_size=n, max_size=n))
    return RadioScans(draw(_float64(n)), tuple(address), draw(_float64(n)))


@st.composite
def any_waypoints(draw: st.DrawFn) -> Waypoints:
    n = draw(COUNTS)
    return Waypoints(draw(_float64(n)), draw(_float64(n)), draw(_float64(n)))


@settings(deadline=None)
@given(any_samples())
def test_samples_round_trip_to_the_bit(given_samples: ImuSamples) -> None:
    back = columns.decode_samples(columns.encode_samples(given_samples))
    for name in ("t", "mag", "acc", "gyro"):
        before, after = getattr(given_samples, name), getattr(back, name)
        assert after.dtype == np.float64
        assert after.shape == before.shape
        np.testing.assert_array_equal(_bits(after), _bits(before), err_msg=name)


@settings(deadline=None)
@given(any_scans())
def test_scans_round_trip_to_the_bit(given_scans: RadioScans) -> None:
    back = columns.decode_scans(columns.encode_scans(given_scans))
    assert back.address == given_scans.address
    np.testing.assert_array_equal(_bits(back.t), _bits(given_scans.t))
    np.testing.assert_array_equal(_bits(back.rssi), _bits(given_scans.rssi))


@settings(deadline=None)
@given(any_waypoints())
def test_waypoints_round_trip_to_the_bit(waypoints: Waypoints) -> None:
    back = columns.decode_waypoints(columns.encode_waypoints(waypoints))
    for name in ("t", "x", "y"):
        np.testing.assert_array_equal(_bits(getattr(back, name)), _bits(getattr(waypoints, name)), err_msg=name)


AIDS = {
    "gnss": (GnssReadings, 4),
    "pressure": (PressureReadings, 2),
    "speed": (SpeedReadings, 2),
    "steps": (StepCounts, 2),
}


@settings(deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(AIDS)), n=COUNTS)
def test_aids_round_trip_to_the_bit(data: st.DataObject, name: str, n: int) -> None:
    kind, k = AIDS[name]
    given_aid = kind(*(data.draw(_float64(n)) for _ in range(k)))
    blobs = columns.encode_aids(Aids(**{name: given_aid}))
    assert [key for key, blob in blobs.items() if blob is not None] == [name]
    back = getattr(columns.decode_aids(blobs), name)
    for column in fields(kind):
        after = getattr(back, column.name)
        assert after.dtype == np.float64
        np.testing.assert_array_equal(_bits(after), _bits(getattr(given_aid, column.name)), err_msg=column.name)


def test_every_aid_has_a_column() -> None:
    assert tuple(column.name for column in fields(Aids)) == columns.AID_COLUMNS
    assert None not in columns.encode_aids(all_aids()).values()
    assert columns.decode_aids(columns.encode_aids(NO_AIDS)) == NO_AIDS


def test_aids_of_one_kind_are_not_taken_for_another() -> None:
    blobs = columns.encode_aids(all_aids())
    with pytest.raises(columns.ColumnsError, match="kind"):
        columns.decode_aids({**blobs, "speed": blobs["pressure"]})


def test_more_digits_than_float32_are_rounded_to_the_nearest() -> None:
    chunk = samples(4)
    chunk.mag[:] = 0.1
    back = columns.decode_samples(columns.encode_samples(chunk))
    assert (back.mag == float(np.float32(0.1))).all()


def test_encoding_does_not_touch_its_input() -> None:
    chunk = samples(20)
    before = [array.copy() for array in (chunk.t, chunk.mag, chunk.acc, chunk.gyro)]
    columns.encode_samples(chunk)
    for array, copy in zip((chunk.t, chunk.mag, chunk.acc, chunk.gyro), before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_an_even_clock_takes_almost_no_room() -> None:
    chunk = samples(250)
    still = ImuSamples(chunk.t, *(np.zeros((250, 3)) for _ in range(3)))
    assert len(columns.encode_samples(still)) < 400


def test_a_segment_takes_less_than_its_float32_values() -> None:
    assert len(columns.encode_samples(samples(250))) < 250 * 9 * 4


@pytest.mark.parametrize("cut", [0, 3, 8, 100])
def test_a_blob_cut_short_is_refused(cut: int) -> None:
    with pytest.raises(columns.ColumnsError):
        columns.decode_samples(columns.encode_samples(samples(50))[:cut])


def test_a_blob_of_another_kind_or_version_is_refused() -> None:
    blob = columns.encode_scans(scans())
    with pytest.raises(columns.ColumnsError, match="kind"):
        columns.decode_samples(blob)
    newer = columns.encode_samples(samples(5))
    newer = newer[:2] + bytes([newer[2] + 1]) + newer[3:]
    with pytest.raises(columns.ColumnsError, match="version"):
        columns.decode_samples(newer)


def test_a_header_that_claims_other_rows_is_refused() -> None:
    blob = columns.encode_samples(samples(5))
    for decode, data in ((columns.decode_samples, blob), (columns.decode_scans, columns.encode_scans(scans()))):
        with pytest.raises(columns.ColumnsError):
            decode(data[:4] + (77).to_bytes(4, "little") + data[8:])
