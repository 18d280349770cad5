"""Scans of a known hall as evidence about position and level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.localization.radio import (
    KindModel,
    RadioAid,
    RadioField,
    RadioMemory,
    RadioModel,
    RadioScan,
    group_scans,
    level_evidence,
    log_likelihood,
    sample_positions,
    weights_at,
)
from app.engine.mapping.radio import build_radio_map
from app.engine.types import RadioMap, RadioScans
from tests.support.radio import Hall, lawn, nodes

PLACES = np.random.default_rng(20).uniform([4.0, 4.0], [56.0, 36.0], (60, 2))


def radio_of(hall: Hall, seed: int) -> RadioMap:
    rng = np.random.default_rng(seed)
    walks, placed = [], []
    for walk, track in lawn():
        t = np.arange(track.t[0], track.t[-1], 2.0)
        xy = np.stack([np.interp(t, track.t, track.xy[:, k]) for k in (0, 1)], axis=1)
        walks.append(replace(walk, wifi=hall.scans(t, xy, rng)))
        placed.append(track)
    radio = build_radio_map(walks, placed)
    assert radio is not None
    return radio


def scans_of(hall: Hall, places: np.ndarray, seed: int, gain: float = 0.0) -> list[RadioScan]:
    rng = np.random.default_rng(seed)
    return [group_scans(hall.scans(np.array([0.0]), xy[None], rng, gain=gain), None)[0] for xy in places]


@pytest.fixture(scope="module")
def hall() -> Hall:
    return Hall.random(np.random.default_rng(21))


@pytest.fixture(scope="module")
def radio(hall: Hall) -> RadioMap:
    return radio_of(hall, 22)


def errors(radio: RadioMap, scans: list[RadioScan], model: RadioModel | None = None) -> np.ndarray:
    at = nodes(radio)
    peaks = [at[log_likelihood(radio, scan, model).argmax()] for scan in scans]
    return np.hypot(*(np.array(peaks) - PLACES).T)


def test_the_likelihood_peaks_near_the_truth(hall: Hall, radio: RadioMap) -> None:
    found = errors(radio, scans_of(hall, PLACES, 23))
    assert np.median(found) < 3.0
    assert np.quantile(found, 0.9) < 6.0


def test_the_claimed_region_holds_the_truth(hall: Hall, radio: RadioMap) -> None:
    at = nodes(radio)
    inside = []
    for xy, scan in zip(PLACES, scans_of(hall, PLACES, 24), strict=True):
        share = np.exp(log_likelihood(radio, scan).ravel().astype(float))
        share /= share.sum()
        here = int(np.hypot(*(at - xy).T).argmin())
        inside.append(share[share > share[here]].sum() < 0.95)
    assert np.mean(inside) > 0.93


@pytest.mark.parametrize("gain", [-8.0, 8.0])
def test_a_device_of_another_gain_is_found_as_well(hall: Hall, radio: RadioMap, gain: float) -> None:
    assert np.median(errors(radio, scans_of(hall, PLACES, 25, gain=gain))) < 3.5


def test_with_an_unknown_gain_an_offset_changes_nothing(hall: Hall, radio: RadioMap) -> None:
    model = RadioModel(wifi=KindModel(offset_sd=1e4))
    for scan in scans_of(hall, PLACES[:5], 26):
        shifted = replace(scan, rssi=scan.rssi - 6.0)
        np.testing.assert_allclose(log_likelihood(radio, scan, model), log_likelihood(radio, shifted, model), atol=2e-3)


def test_radios_of_one_access_point_count_about_once(hall: Hall, radio: RadioMap) -> None:
    """Four addresses that differ in the last digit, all heard alike, against one."""
    rows = np.repeat(np.arange(len(radio.addresses)), 4)
    names = tuple(f"{radio.addresses[row][:-1]}{k}" for row in range(len(radio.addresses)) for k in range(4))
    many = replace(radio, addresses=names, mean=radio.mean[rows], sd=radio.sd[rows], seen=radio.seen[rows])
    scan = scans_of(hall, PLACES[:1], 27)[0]
    repeated = replace(
        scan, name=tuple(f"{name[:-1]}{k}" for name in scan.name for k in range(4)), rssi=np.repeat(scan.rssi, 4)
    )

    def contrast(grid: np.ndarray) -> float:
        return float(grid.max() - grid.mean())

    once = contrast(log_likelihood(radio, scan))
    model = RadioModel(wifi=KindModel(sibling=0.0))
    assert contrast(log_likelihood(many, repeated, model)) == pytest.approx(once, rel=0.05)
    assert contrast(log_likelihood(many, repeated)) < 4.0**0.75 * once


def test_the_wrong_level_loses(hall: Hall, radio: RadioMap) -> None:
    """The storey above hears the same access points 18 dB weaker, and has its own."""
    above = replace(hall, power=hall.power - 18.0)
    own = Hall.random(np.random.default_rng(28), storey=1)
    both = Hall(np.vstack([above.at, own.at]), np.concatenate([above.power, own.power]), above.address + own.address)
    below = Hall(both.at, np.concatenate([hall.power, own.power - 18.0]), both.address)
    aid = RadioAid({"below": radio_of(below, 29), "above": radio_of(both, 30)})
    for place, name in ((below, "below"), (both, "above")):
        right = 0
        for scan in scans_of(place, PLACES, 31):
            _, field = aid.field(RadioMemory(), scan, 0.0)
            assert field is not None
            evidence = field.level_evidence()
            right += max(evidence, key=lambda level: evidence[level]) == name
        assert right >= 0.97 * len(PLACES)


def test_strangers_tell_nothing_on_a_single_level(hall: Hall, radio: RadioMap) -> None:
    scan = scans_of(hall, PLACES[:1], 32)[0]
    more = replace(scan, name=(*scan.name, "ff:00:00:00:00:00"), rssi=np.append(scan.rssi, -40.0))
    np.testing.assert_array_equal(log_likelihood(radio, more), log_likelihood(radio, scan))


def test_the_order_of_readings_does_not_matter(hall: Hall, radio: RadioMap) -> None:
    scan = scans_of(hall, PLACES[:1], 33)[0]
    order = np.random.default_rng(34).permutation(len(scan.name))
    mixed = replace(scan, name=tuple(scan.name[i] for i in order), rssi=scan.rssi[order])
    np.testing.assert_allclose(log_likelihood(radio, mixed), log_likelihood(radio, scan), rtol=1e-4, atol=1e-3)


def test_look_ups_are_bilinear_and_end_at_the_edge(radio: RadioMap) -> None:
    rows, columns = radio.mean.shape[1:]
    at = nodes(radio)
    grid = (2.0 * at[:, 0] - 3.0 * at[:, 1]).reshape(rows, columns).astype(np.float32)
    x, y = np.random.default_rng(35).uniform([0, 0], [50, 30], (100, 2)).T
    np.testing.assert_allclose(weights_at(grid, radio, x, y), 2.0 * x - 3.0 * y, atol=1e-3)
    outside = weights_at(grid, radio, np.array([-1e6, 1e6]), np.array([-1e6, 1e6]))
    np.testing.assert_allclose(outside, [grid[0, 0], grid[-1, -1]])


def test_draws_follow_the_weights(radio: RadioMap) -> None:
    grid = np.full(radio.mean.shape[1:], -np.inf, np.float32)
    grid[2, 3], grid[5, 1] = 0.0, np.log(3.0)
    x, y = sample_positions(grid, radio, 4000, np.random.default_rng(36))
    first = np.hypot(x - (radio.x0 + 3 * radio.cell_m), y - (radio.y0 + 2 * radio.cell_m)) < 0.8 * radio.cell_m
    second = np.hypot(x - (radio.x0 + 1 * radio.cell_m), y - (radio.y0 + 5 * radio.cell_m)) < 0.8 * radio.cell_m
    assert first.sum() == pytest.approx(1000, abs=2)
    assert second.sum() == pytest.approx(3000, abs=2)


def test_draws_choose_the_level_by_its_evidence(radio: RadioMap) -> None:
    flat = np.zeros(radio.mean.shape[1:], np.float32)
    field = RadioField(0.0, {"a": flat, "b": flat + np.float32(np.log(4.0))}, {"a": radio, "b": radio})
    levels, level, x, y = field.sample(1000, np.random.default_rng(37))
    assert levels == ("a", "b")
    np.testing.assert_allclose(np.bincount(level), [200, 800], atol=1)
    assert x.shape == y.shape == (1000,)
    assert level_evidence(flat) == pytest.approx(0.0)
    np.testing.assert_allclose(field.log_weights("c", x[:3], y[:3]), np.log(2.5), atol=1e-6)


def test_scans_are_moments_and_none_is_used_twice() -> None:
    t = np.array([0.0, 0.3, 0.9, 2.1, 2.2, 9.0])
    wifi = RadioScans(t, tuple("abcdef"), np.full(6, -60.0))
    scans = group_scans(wifi, None)
    assert [scan.name for scan in scans] == [("a", "b", "c"), ("d", "e"), ("f",)]
    assert scans[0].t == pytest.approx(0.4)
    assert scans[0].newest_t == 0.9
    assert [scan.name for scan in group_scans(wifi, None, after=scans[0].newest_t)] == [("d", "e"), ("f",)]
    assert group_scans(None, None) == ()


def test_kinds_are_scans_of_their_own_oldest_first() -> None:
    wifi = RadioScans(np.array([1.0, 4.0]), ("a", "b"), np.full(2, -60.0))
    ble = RadioScans(np.array([0.5, 2.2, 3.0]), ("a", "c", "a"), np.full(3, -80.0))
    scans = group_scans(wifi, ble)
    assert [scan.name for scan in scans] == [("a",), ("ble:a", "ble:c"), ("ble:a",), ("b",)]
    assert [scan.is_ble for scan in scans] == [False, True, True, False]


def test_beacons_count_less_in_the_company_of_wifi(hall: Hall, radio: RadioMap) -> None:
    names = tuple(sorted([*radio.addresses, *("ble:" + name for name in radio.addresses)]))
    layers = (np.concatenate([layer, layer]) for layer in (radio.mean, radio.sd, radio.seen))
    mean, sd, seen = layers
    aid = RadioAid({"hall": replace(radio, addresses=names, mean=mean, sd=sd, seen=seen)})
    wifi = scans_of(hall, PLACES[:1], 39)[0]
    ble = replace(wifi, name=tuple("ble:" + name for name in wifi.name))
    _, alone = aid.field(RadioMemory(), ble, 0.0)
    memory, _ = aid.field(RadioMemory(), wifi, 0.0)
    memory, beside = aid.field(memory, ble, 0.0)
    assert alone is not None
    assert beside is not None
    np.testing.assert_allclose(beside.log["hall"], aid.model.company * alone.log["hall"], rtol=1e-5)
    _, again = aid.field(memory, wifi, 1e3)
    assert again is not None
    np.testing.assert_allclose(again.log["hall"], aid.field(RadioMemory(), wifi, 0.0)[1].log["hall"], rtol=1e-5)  # type: ignore[union-attr]


def test_standing_still_teaches_little(hall: Hall, radio: RadioMap) -> None:
    aid = RadioAid({"hall": radio})
    first, second = scans_of(hall, PLACES[:1].repeat(2, axis=0), 38)
    memory, field = aid.field(RadioMemory(), first, 10.0)
    assert field is not None
    np.testing.assert_allclose(field.log["hall"], log_likelihood(radio, first), rtol=1e-6)
    for walked, share in ((0.0, aid.model.least_renewal), (1e3, 1.0)):
        _, later = aid.field(memory, second, 10.0 + walked)
        assert later is not None
        np.testing.assert_allclose(later.log["hall"], share * log_likelihood(radio, second), rtol=1e-5)


def test_a_scan_of_strangers_is_no_evidence(radio: RadioMap) -> None:
    aid = RadioAid({"hall": radio})
    scan = RadioScan(5.0, 5.0, ("ff:00:00:00:00:00",), np.array([-50.0]))
    memory, field = aid.field(RadioMemory(1.0, 3.0), scan, 7.0)
    assert field is None
    assert memory == RadioMemory(5.0, 3.0)  # the way of the last useful scan stays


def test_a_field_is_the_same_remembered_or_not(hall: Hall, radio: RadioMap) -> None:
    """Bit by bit: the next segment may go to a worker that has not seen the scan."""
    scan = scans_of(hall, PLACES[:1], 23)[0]
    first = log_likelihood(radio, scan)
    assert log_likelihood(radio, scan) is first
    np.testing.assert_array_equal(log_likelihood(replace(radio), scan), first)
    louder = replace(scan, rssi=scan.rssi + 1.0)
    assert not np.array_equal(log_likelihood(radio, louder), first)
    assert not np.array_equal(log_likelihood(radio, scan, RadioModel(wifi=KindModel(temper=0.5))), first)
    fewer = log_likelihood(radio, scan, vocabulary=scan.name[:3])
    assert not np.array_equal(fewer, first)
