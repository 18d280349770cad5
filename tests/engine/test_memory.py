"""What sessions teach about a device: nothing counts twice, old news fade, nobody is surer than sessions agree."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engine.calibration import (
    MemoryLaw,
    next_epoch,
    next_session,
    remember,
    remember_offsets,
    remember_strides,
    unknown_device,
)
from app.engine.inertial.stride import SPREAD
from app.engine.localization.initial import InitialSpread
from app.engine.types import DeviceCalibration

LAW = MemoryLaw()
values = st.floats(-40.0, 40.0)
spreads = st.floats(0.05, 5.5)
scales = st.floats(0.6, 1.4)
scale_spreads = st.floats(0.005, 0.13)


@st.composite
def calibrations(draw: st.DrawFn) -> DeviceCalibration:
    offset, sd = (draw(st.tuples(element, element, element)) for element in (values, spreads))
    return DeviceCalibration(offset, sd, draw(scales), draw(scale_spreads))


def known(offset: float, offset_sd: float, stride: float = 1.0, stride_sd: float = 0.05) -> DeviceCalibration:
    return DeviceCalibration((offset,) * 3, (offset_sd,) * 3, stride, stride_sd)


def session(before: DeviceCalibration, offset: float, offset_sd: float, stride: float, stride_sd: float):
    """What an honest filter ends with that begins with ``before`` and measures so: precisions add."""

    def update(value: float, sd: float, seen: float, seen_sd: float) -> tuple[float, float]:
        precision = sd**-2 + seen_sd**-2
        return (value * sd**-2 + seen * seen_sd**-2) / precision, precision**-0.5

    parts = [update(before.offset[i], before.offset_sd[i], offset, offset_sd) for i in range(3)]
    scale, scale_sd = update(before.stride_scale, before.stride_scale_sd, stride, stride_sd)
    values, sds = zip(*parts, strict=True)
    return DeviceCalibration(values, sds, scale, scale_sd)


def after(measured: list[float], *, sd: float = 2.0, memory: DeviceCalibration | None = None) -> DeviceCalibration:
    """The memory after sessions that measured these offsets, each starting from what was remembered."""
    for offset in measured:
        start = unknown_device() if memory is None else next_session(memory)
        memory = remember(start, None if memory is None else start, session(start, offset, sd, 1.1, 0.04))
    assert memory is not None
    return memory


def test_a_new_device_is_what_the_tracker_takes_it_for() -> None:
    spread = InitialSpread()
    start = unknown_device()
    assert start.offset_sd == (spread.offset_horizontal, spread.offset_horizontal, spread.offset_vertical)
    assert (start.offset, start.stride_scale, start.stride_scale_sd) == ((0.0, 0.0, 0.0), 1.0, SPREAD)


def test_an_honest_session_is_taken_as_it_is() -> None:
    """A filter that is not too sure has fused memory and evidence already; doing it again must change nothing."""
    start = next_session(known(3.0, 2.5, 1.05, 0.06))
    ended = session(start, 9.0, 3.0, 0.95, 0.07)
    fused = remember(start, start, ended)
    assert fused.offset == pytest.approx(ended.offset)
    assert fused.offset_sd == pytest.approx(ended.offset_sd)
    assert (fused.stride_scale, fused.stride_scale_sd) == pytest.approx((ended.stride_scale, ended.stride_scale_sd))


@given(memory=calibrations(), offset=values, offset_sd=st.floats(0.5, 50.0))
def test_overlapping_sessions_count_once_each_in_any_order(
    memory: DeviceCalibration, offset: float, offset_sd: float
) -> None:
    """Both began with the same memory; without drift and floors the outcome is that of one filter that saw both."""
    law = MemoryLaw(offset_drift=0.0, stride_drift=0.0, offset_floor=1e-9, stride_floor=1e-9)
    start = next_session(memory, law)
    one, other = session(start, offset, offset_sd, 1.0, 0.1), session(start, 4.0, 3.0, 1.1, 0.05)
    both = session(one, 4.0, 3.0, 1.1, 0.05)
    for first, second in ((one, other), (other, one)):
        fused = remember(next_session(remember(start, start, first, law), law), start, second, law)
        assert fused.offset == pytest.approx(both.offset, abs=1e-3)
        assert fused.offset_sd == pytest.approx(both.offset_sd, rel=1e-4)
        assert fused.stride_scale == pytest.approx(both.stride_scale, abs=1e-3)


@given(memory=calibrations(), learned=calibrations())
def test_nobody_is_surer_than_the_floors_nor_less_sure_than_before(
    memory: DeviceCalibration, learned: DeviceCalibration
) -> None:
    start = next_session(memory)
    fused = remember(start, start, learned)
    for i in range(3):
        assert LAW.offset_floor <= fused.offset_sd[i] <= max(start.offset_sd[i], LAW.offset_floor)
    assert LAW.stride_floor <= fused.stride_scale_sd <= max(start.stride_scale_sd, LAW.stride_floor)
    assert all(map(math.isfinite, (*fused.offset, fused.stride_scale)))


@given(memory=calibrations())
def test_a_session_that_learned_nothing_changes_nothing_but_the_drift(memory: DeviceCalibration) -> None:
    start = next_session(memory)
    fused = remember(start, start, start)
    assert fused.offset == start.offset
    assert fused.stride_scale == start.stride_scale
    assert fused.offset_sd == tuple(max(sd, LAW.offset_floor) for sd in start.offset_sd)


def test_a_first_session_sets_the_memory_within_its_own_error() -> None:
    memory = after([10.0], sd=0.5)
    # a claim of 0.5 uT counts as one of 2: 12 % of the way back to what devices have on average
    assert memory.offset == pytest.approx((8.9, 8.9, 8.9), abs=0.2)
    assert memory.offset_sd == (2.0, 2.0, 2.0)
    assert memory.stride_scale_sd == 0.04


def test_drift_adds_between_sessions_up_to_knowing_nothing() -> None:
    memory = known(5.0, 2.0, 1.1, 0.04)
    start = next_session(memory)
    assert start.offset == memory.offset
    assert start.offset_sd == pytest.approx((math.sqrt(8.0),) * 3)
    assert start.stride_scale_sd == pytest.approx(math.hypot(0.04, 0.02))
    for _ in range(100):
        start = next_session(start)
    assert start.offset_sd == (5.5, 5.5, 5.5)
    assert start.stride_scale_sd == 0.13


def test_the_memory_converges_and_averages_what_sessions_differ_by() -> None:
    rng = np.random.default_rng(5)
    truth, spread = 12.0, 2.0
    errors = [after(list(rng.normal(truth, spread, 12)), sd=0.3).offset[0] - truth for _ in range(200)]
    assert abs(np.mean(errors)) < 0.5
    # better than one session alone, and the claim covers it
    assert np.sqrt(np.mean(np.square(errors))) < spread
    claimed = after([truth] * 12, sd=0.3).offset_sd[0]
    assert claimed == 2.0
    assert np.mean(np.abs(errors) < 2.0 * claimed) > 0.93


def test_old_news_is_forgotten() -> None:
    memory = after([-10.0] * 8)
    assert memory.offset[0] == pytest.approx(-10.0, abs=0.2)
    followed = [after([8.0] * n, memory=memory).offset[0] for n in range(1, 6)]
    assert followed == sorted(followed)
    assert followed[0] > -1.0  # one session moves it more than half of the way
    assert followed[3] == pytest.approx(8.0, abs=0.5)


def test_another_epoch_knows_the_stride_only() -> None:
    start = next_epoch(known(9.0, 2.0, 1.15, 0.04))
    assert start.offset == (0.0, 0.0, 0.0)
    assert start.offset_sd == (5.5, 5.5, 5.5)
    assert (start.stride_scale, start.stride_scale_sd) == pytest.approx((1.15, math.hypot(0.04, 0.02)))


IRON = (0.08, -0.06, 0.0, 0.05, -0.03, 0.04)
IRON_SD = (0.015, 0.014, 0.036, 0.012, 0.015, 0.013)


def test_soft_iron_is_taken_over_with_its_uncertainty() -> None:
    learned = replace(known(3.0, 2.0), soft_iron=IRON, soft_iron_sd=IRON_SD)
    memory = remember(unknown_device(), None, learned)
    assert memory.soft_iron == pytest.approx(IRON)  # an honest session that began with nothing: taken as it is
    assert memory.soft_iron_sd == pytest.approx(IRON_SD)
    start = next_session(memory)
    assert start.soft_iron == memory.soft_iron
    assert start.soft_iron_sd == pytest.approx([math.hypot(sd, LAW.soft_iron_drift) for sd in IRON_SD])


def test_soft_iron_that_a_session_did_not_excite_stays_as_it_was() -> None:
    start = next_session(replace(known(3.0, 2.0), soft_iron=IRON, soft_iron_sd=IRON_SD))
    fused = remember(start, start, replace(start, offset=(4.0, 4.0, 4.0), offset_sd=(2.0, 2.0, 2.0)))
    assert (fused.soft_iron, fused.soft_iron_sd) == (start.soft_iron, start.soft_iron_sd)


def test_sessions_average_their_soft_iron_down_to_the_floor() -> None:
    """Each sees it to three percent; begun with the memory each, none counts twice."""
    rng, memory, errors = np.random.default_rng(3), unknown_device(), []
    for _ in range(40):
        start = next_session(memory)
        pairs = [
            ((value / sd**2 + seen / 0.03**2) / (sd**-2 + 0.03**-2), (sd**-2 + 0.03**-2) ** -0.5)
            for value, sd, seen in zip(
                start.soft_iron, start.soft_iron_sd, IRON + 0.03 * rng.normal(size=6), strict=True
            )
        ]
        values, sds = zip(*pairs, strict=True)
        memory = remember(start, start, replace(start, soft_iron=values, soft_iron_sd=sds))
        errors.append((np.array(memory.soft_iron) - IRON) / memory.soft_iron_sd)
    assert all(LAW.soft_iron_floor <= sd < 0.015 for sd in memory.soft_iron_sd)
    assert np.mean(np.square(errors[10:])) < 1.5


def test_soft_iron_is_of_its_epoch_and_surveys_leave_it_alone() -> None:
    memory = replace(known(9.0, 2.0), soft_iron=IRON, soft_iron_sd=IRON_SD)
    assert next_epoch(memory).soft_iron == unknown_device().soft_iron == (0.0,) * 6
    assert next_epoch(memory).soft_iron_sd == unknown_device().soft_iron_sd
    taught = remember_strides(memory, [1.1])
    assert (taught.soft_iron, taught.soft_iron_sd) == (IRON, IRON_SD)


def test_a_deleted_memory_does_not_come_back_through_a_session() -> None:
    """Begun with a wrong memory, ended after it was deleted: only what the session itself saw is remembered."""
    wrong = next_session(known(-20.0, 2.0))
    ended = session(wrong, 6.0, 2.0, 1.0, 0.05)
    assert ended.offset[0] < -2.0
    fused = remember(unknown_device(), wrong, ended)
    expected = remember(unknown_device(), None, session(unknown_device(), 6.0, 2.0, 1.0, 0.05))
    assert fused.offset == pytest.approx(expected.offset)
    assert fused.offset[0] > 4.0


def test_particles_that_all_agree_are_no_certainty() -> None:
    start = unknown_device()
    fused = remember(start, None, replace(known(7.0, 0.0), stride_scale=1.2, stride_scale_sd=0.0))
    assert fused.offset_sd == (2.0, 2.0, 2.0)
    assert 1.15 < fused.stride_scale < 1.2


@given(memory=calibrations(), seen=st.lists(st.floats(0.7, 1.5), min_size=1, max_size=30))
def test_a_survey_teaches_the_stride_alone(memory: DeviceCalibration, seen: list[float]) -> None:
    taught = remember_strides(memory, seen)
    assert (taught.offset, taught.offset_sd) == (memory.offset, memory.offset_sd)
    low, high = sorted((memory.stride_scale, float(np.median(seen))))
    assert low - 1e-9 <= taught.stride_scale <= high + 1e-9
    assert taught.stride_scale_sd <= max(memory.stride_scale_sd, LAW.stride_floor)
    assert taught.stride_scale_sd >= LAW.stride_floor


def test_more_survey_walks_count_for_more_up_to_the_floor() -> None:
    sds = [remember_strides(unknown_device(), [1.2] * n).stride_scale_sd for n in (1, 3, 100, 1000)]
    assert sds[0] > sds[1] > sds[2] == sds[3] == LAW.stride_floor
    assert remember_strides(unknown_device(), [1.2] * 100).stride_scale == pytest.approx(1.2, abs=0.03)


def test_one_wrong_label_does_not_carry_the_day() -> None:
    taught = remember_strides(unknown_device(), [1.1, 1.12, 1.08, 1.1, 1.9])
    assert taught.stride_scale == pytest.approx(1.1, abs=0.02)


def test_no_walk_teaches_nothing() -> None:
    assert remember_strides(known(1.0, 2.0), []) == known(1.0, 2.0)


def test_survey_walks_measure_the_offset() -> None:
    start = unknown_device()
    one = remember_offsets(start, [(8.0, -4.0, 6.0)])
    many = remember_offsets(start, [(8.0, -4.0, 6.0)] * 9 + [(60.0, 60.0, 60.0)])
    assert remember_offsets(start, []) == start
    for i in range(2):  # the vertical component has a floor of its own
        assert start.offset_sd[i] > one.offset_sd[i] > many.offset_sd[i] >= MemoryLaw().offset_floor
        assert abs(start.offset[i]) < abs(one.offset[i]) < abs(many.offset[i]) < abs((8.0, -4.0)[i])
    assert many.offset_sd[2] == pytest.approx(one.offset_sd[2])
    assert replace(many, offset=start.offset, offset_sd=start.offset_sd) == start


def test_walks_that_disagree_say_that_the_next_session_may_be_of_either_kind() -> None:
    agreed = remember_offsets(unknown_device(), [(6.0, 0.0, 0.0)] * 6)
    jumped = remember_offsets(unknown_device(), [(12.0, 0.0, 0.0)] * 3 + [(0.0, 0.0, 0.0)] * 3)
    assert jumped.offset_sd[0] > 1.5 * agreed.offset_sd[0]
    assert jumped.offset_sd[1] == agreed.offset_sd[1]
