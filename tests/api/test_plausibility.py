"""The checks of samples against an obviously right twin, and at their limits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from app.api.errors import RejectedError
from app.api.plausibility import SEGMENT_LIMITS, SENSORS, check_samples
from app.api.schemas.samples import SamplesIn
from tests.api.harness import columns, plain
from tests.support.builders import START, samples

FIELDS = [f"{name}.{axis}" for name in SENSORS for axis in "xyz"]


def build(**changes: Iterable[float]) -> SamplesIn:
    """Good samples, with columns replaced: ``mag_x=[..]``."""
    body = plain(columns(samples(40)))
    for name, value in changes.items():
        sensor, _, axis = name.partition("_")
        target, key = (body, name) if sensor == "t" else (body[sensor], axis)
        target[key] = [float(item) for item in value]
    return SamplesIn.model_validate(body)


def fields_at_fault(upload: SamplesIn) -> set[str]:
    try:
        check_samples(upload, SEGMENT_LIMITS, START)
    except RejectedError as error:
        return {finding.field for finding in error.errors}
    return set()


def test_good_samples_pass() -> None:
    assert fields_at_fault(build()) == set()


@settings(max_examples=80, deadline=None)
@given(
    readings=npst.arrays(
        np.float64, (9, 40), elements=st.sampled_from([0.0, 1.0, 9.8, -40.0, 1999.0, 199.0, 49.0, np.nan, np.inf])
    )
)
def test_exactly_the_columns_with_bad_values_are_named(readings: np.ndarray) -> None:
    """Twin: a loop over values."""
    upload = build(**{name.replace(".", "_"): row for name, row in zip(FIELDS, readings, strict=True)})
    bad = {f"samples.{name}" for name, row in zip(FIELDS, readings, strict=True) if not all(map(np.isfinite, row))}
    found = fields_at_fault(upload)
    assert found == bad if bad else all(field.count(".") == 1 for field in found)


@settings(max_examples=80, deadline=None)
@given(steps=st.lists(st.sampled_from([-5.0, 0.0, 20.0, 999.0, 1000.0, 1000.5]), min_size=39, max_size=39))
def test_time_is_judged_step_by_step(steps: list[float]) -> None:
    """Twin: the worst step decides, and the median: steps beyond a second or not forward are refused, the rest not."""
    t_ms = np.concatenate(([1.79e12], 1.79e12 + np.cumsum(steps)))
    refused = any(step <= 0 or step > 1000.0 for step in steps) or sum(steps) > 60_000.0
    refused = refused or sorted(steps)[len(steps) // 2] > 125.0
    assert bool(fields_at_fault(build(t_ms=t_ms))) == refused


@pytest.mark.parametrize(
    ("name", "sensor", "inside", "outside"),
    [("mag_x", "mag", 1990.0, 2010.0), ("acc_y", "acc", 199.0, 200.5), ("gyro_z", "gyro", 49.9, 50.1)],
)
def test_limits_hold_for_single_samples(name: str, sensor: str, inside: float, outside: float) -> None:
    quiet = [0.0] * 40
    assert fields_at_fault(build(**{name: [*quiet[1:], inside]})) == set()
    assert fields_at_fault(build(**{name: [*quiet[1:], outside]})) == {f"samples.{sensor}"}


def test_a_few_strange_samples_are_no_wrong_unit() -> None:
    nineteen_of_forty = [300.0] * 19 + [0.0] * 21
    with pytest.raises(RejectedError, match="sample"):
        check_samples(build(acc_x=nineteen_of_forty), SEGMENT_LIMITS, START)
    with pytest.raises(RejectedError, match="looks like"):
        check_samples(build(acc_x=[300.0] * 40), SEGMENT_LIMITS, START)


def test_one_sample_is_a_segment() -> None:
    body = {
        name: value[:1] if name == "t_ms" else {a: c[:1] for a, c in value.items()}
        for name, value in columns(samples(2)).items()
    }
    assert fields_at_fault(SamplesIn.model_validate(plain(body))) == set()


NOW_MS = START.timestamp() * 1000
DAY_MS = 86_400_000.0


@pytest.mark.parametrize(
    ("start", "word"),
    [
        (0.0, "before the year 2000"),
        (-1e17, "before the year 2000"),
        (86_400_000.0, "before the year 2000"),
        (946_684_799_990.0, "before the year 2000"),
        (946_684_800_000.0, None),
        (1.56e12, None),
        (NOW_MS, None),
        (NOW_MS + DAY_MS - 1000.0, None),
        (NOW_MS + DAY_MS + 1.0, "a day ahead"),
        (9.66e13, "a day ahead"),
    ],
)
def test_time_lies_between_2000_and_tomorrow(start: float, word: str | None) -> None:
    upload = build(t_ms=start + np.arange(40) * max(20.0, abs(start) * 1e-15))
    assert fields_at_fault(upload) == ({"samples.t_ms"} if word else set())
    if word:
        with pytest.raises(RejectedError, match=word) as caught:
            check_samples(upload, SEGMENT_LIMITS, START)
        assert "Unix milliseconds" in caught.value.errors[0].remedy


@pytest.mark.parametrize(("step_ms", "accepted"), [(100.0, True), (125.0, True), (126.0, False), (999.0, False)])
def test_the_rate_has_a_floor(step_ms: float, accepted: bool) -> None:
    upload = build(t_ms=1.79e12 + np.arange(40) * step_ms)
    assert fields_at_fault(upload) == (set() if accepted else {"samples.t_ms"})


@pytest.mark.parametrize(("step_ms", "accepted"), [(51.0, True), (52.0, False)])
def test_a_gyroscope_may_be_silent_for_a_moment_only(step_ms: float, accepted: bool) -> None:
    zeros = dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), [0.0] * 40)
    t_ms = 1.79e12 + np.arange(40) * step_ms
    assert fields_at_fault(build(t_ms=t_ms, **zeros)) == (set() if accepted else {"samples.gyro"})
    assert fields_at_fault(build(t_ms=t_ms, **{**zeros, "gyro_y": [0.0] * 39 + [1e-4]})) == set()


def test_a_silent_magnetometer_is_no_wrong_unit() -> None:
    upload = build(**dict.fromkeys(("mag_x", "mag_y", "mag_z"), [0.0] * 40))
    with pytest.raises(RejectedError, match="no reading") as caught:
        check_samples(upload, SEGMENT_LIMITS, START)
    assert [error.field for error in caught.value.errors] == ["samples.mag"]
