"""Models of devices: what is planted is found, intervals hold what they promise, one device alone tells little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.calibration import (
    FleetLaw,
    MemoryLaw,
    estimate_model,
    next_session,
    own_evidence,
    remember,
    unknown_device,
    with_model,
)
from app.engine.types import DeviceCalibration, Float64Array

WIDE = MemoryLaw().offset_wide
NOISE = 2.5


def memory_of(offset: Float64Array, noise: float = NOISE, stride: float | None = None) -> DeviceCalibration:
    """The memory of a new device after one session that measured this offset."""
    learned = replace(unknown_device(), offset=tuple(offset), offset_sd=(noise,) * 3)
    if stride is not None:
        learned = replace(learned, stride_scale=stride, stride_scale_sd=0.05)
    # as a tracker ends: what it measured, weighed with what it began with
    blank, information = WIDE**-2, noise**-2
    told = offset * information / (blank + information)
    learned = replace(learned, offset=tuple(told), offset_sd=((blank + information) ** -0.5,) * 3)
    return remember(unknown_device(), None, learned)


def fleet(
    rng: np.random.Generator, n: int, mean: Float64Array, spread: float, noise: float = NOISE
) -> list[DeviceCalibration]:
    devices = mean + spread * rng.standard_normal((n, 3))
    return [memory_of(device + noise * rng.standard_normal(3), noise) for device in devices]


def test_evidence_is_what_was_measured() -> None:
    value, information = own_evidence(memory_of(np.array([6.0, -3.0, 1.0])))
    np.testing.assert_allclose(value[:3], [6.0, -3.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(information[:3], NOISE**-2)
    assert not information[4:].any()
    value, information = own_evidence(unknown_device())
    assert not information.any()
    np.testing.assert_array_equal(value, [0, 0, 0, 1, 0, 0, 0, 0, 0, 0])


def test_a_model_nobody_has_seen_is_any_device() -> None:
    for memories in ([], [unknown_device()] * 3):
        estimate = estimate_model(memories)
        assert estimate.n_devices == 0
        np.testing.assert_allclose(estimate.start.offset, 0.0, atol=1e-12)
        np.testing.assert_allclose(estimate.start.offset_sd, WIDE)
        assert estimate.start.stride_scale == pytest.approx(1.0)
        np.testing.assert_allclose(estimate.start.soft_iron_sd, unknown_device().soft_iron_sd)


@pytest.mark.parametrize("spread", [1.0, 3.0])
def test_planted_means_and_spreads_are_recovered(spread: float) -> None:
    mean = np.array([5.0, -4.0, 2.0])
    estimate = estimate_model(fleet(np.random.default_rng(3), 50, mean, spread))
    assert estimate.n_devices == 50
    np.testing.assert_allclose(estimate.typical.offset, mean, atol=1.5)
    np.testing.assert_allclose(estimate.spread.offset_sd, spread, rtol=0.5)
    assert max(estimate.typical.offset_sd) < 0.8
    odd = FleetLaw().odd_share * (FleetLaw().odd_sd * WIDE) ** 2
    np.testing.assert_allclose(estimate.start.offset_sd, np.sqrt(spread**2 + odd), rtol=0.15)


def test_intervals_hold_what_they_promise() -> None:
    """Over fleets drawn from what is believed of fleets: of the mean, and of one more device of the model."""
    rng, law = np.random.default_rng(8), FleetLaw()
    of_mean, of_next = [], []
    for _ in range(150):
        mean = WIDE * np.sqrt(law.model_share) * rng.standard_normal(3)
        spread = WIDE * np.sqrt(1 - law.model_share) * abs(rng.standard_normal())
        estimate = estimate_model(fleet(rng, 6, mean, spread))
        of_mean.append((mean - estimate.typical.offset) / estimate.typical.offset_sd)
        odd = law.odd_sd * WIDE if rng.uniform() < law.odd_share else 0.0
        another = mean + np.hypot(spread, odd) * rng.standard_normal(3)
        of_next.append((another - estimate.start.offset) / estimate.start.offset_sd)
    for normalized in (np.array(of_mean), np.array(of_next)):
        assert 0.9 < (np.abs(normalized) < 1.96).mean() <= 1.0
    assert 0.85 < np.array(of_mean).std() < 1.2


def test_one_device_alone_tells_little() -> None:
    estimate = estimate_model([memory_of(np.array([10.0, 0.0, 0.0]))])
    assert 2.0 < estimate.typical.offset[0] < 6.0
    assert min(estimate.start.offset_sd) > 0.9 * WIDE
    assert estimate.spread.offset_sd[0] > 0.4 * WIDE


def test_a_wild_device_does_not_move_its_siblings() -> None:
    siblings = fleet(np.random.default_rng(4), 12, np.array([4.0, 4.0, 4.0]), 1.0)
    without = estimate_model(siblings)
    wild = estimate_model([*siblings, memory_of(np.array([60.0, 60.0, 60.0]))])
    np.testing.assert_allclose(wild.typical.offset, without.typical.offset, atol=0.5)
    np.testing.assert_allclose(wild.spread.offset_sd, without.spread.offset_sd, atol=0.5)


def test_stride_and_soft_iron_are_estimated_like_offsets() -> None:
    iron = (0.05, -0.04, 0.0, 0.03, 0.0, 0.0)
    memories = [
        replace(memory_of(np.zeros(3), stride=1.2), soft_iron=iron, soft_iron_sd=(0.012,) * 6) for _ in range(10)
    ]
    estimate = estimate_model(memories)
    np.testing.assert_allclose(estimate.typical.soft_iron, iron, atol=0.012)
    assert estimate.typical.stride_scale == pytest.approx(1.2, abs=0.05)


def test_a_device_is_drawn_to_its_model_as_far_as_it_is_unknown() -> None:
    start = replace(unknown_device(), offset=(8.0, 0.0, 0.0), offset_sd=(4.0,) * 3)
    assert with_model(unknown_device(), start).offset == pytest.approx(start.offset)
    assert with_model(unknown_device(), start).offset_sd == pytest.approx(start.offset_sd)
    known = memory_of(np.array([-2.0, 0.0, 0.0]), noise=3.0)
    both = with_model(known, start)
    assert both.offset[0] == pytest.approx((8.0 / 16 - 2.0 / 9) / (1 / 16 + 1 / 9))
    assert both.offset_sd[0] == pytest.approx((1 / 16 + 1 / 9) ** -0.5)
    assert with_model(memory_of(np.zeros(3), noise=0.1), start).offset_sd[0] >= MemoryLaw().offset_floor
    old = known
    for _ in range(40):
        old = next_session(old)
    assert with_model(old, start).offset == pytest.approx(start.offset, abs=0.3)


def test_the_order_of_devices_does_not_matter() -> None:
    memories = fleet(np.random.default_rng(5), 7, np.array([1.0, 2.0, 3.0]), 2.0)
    one, other = estimate_model(memories), estimate_model(memories[::-1])
    np.testing.assert_allclose(one.start.offset, other.start.offset)
    np.testing.assert_allclose(one.spread.offset_sd, other.spread.offset_sd)
