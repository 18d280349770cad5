"""Radio layers of a hall whose transmitters are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.radio import RadioSettings, build_radio_map, merge_readings
from app.engine.mapping.samples import PlacedSamples
from app.engine.mapping.transmitters import CellReadings, StrengthModel, fit_strength, fit_trend
from app.engine.types import RadioMap, RadioScans, SurveyWalk
from tests.support.radio import SCAN_S, Hall, lawn, nodes

Survey = list[tuple[SurveyWalk, PlacedSamples]]


def surveyed(hall: Hall, survey: Survey, rng: np.random.Generator) -> tuple[list[SurveyWalk], list[PlacedSamples]]:
    walks = []
    for walk, track in survey:
        t = np.arange(track.t[0], track.t[-1], SCAN_S)
        xy = np.stack([np.interp(t, track.t, track.xy[:, k]) for k in (0, 1)], axis=1)
        walks.append(replace(walk, wifi=hall.scans(t, xy, rng)))
    return walks, [track for _, track in survey]


@pytest.fixture(scope="module")
def hall() -> Hall:
    return Hall.random(np.random.default_rng(1))


@pytest.fixture(scope="module")
def radio(hall: Hall) -> RadioMap:
    built = build_radio_map(*surveyed(hall, lawn(), np.random.default_rng(2)))
    assert built is not None
    return built


def test_strengths_are_those_of_the_hall(hall: Hall, radio: RadioMap) -> None:
    assert radio.addresses == tuple(sorted(hall.address))
    at = nodes(radio)
    inside = (at >= 2.0).all(axis=1) & (at <= [58.0, 38.0]).all(axis=1)
    truth = hall.strength(at).T
    audible = inside & (truth > hall.least + 6.0)  # below, only lucky readings are reported, and the mean is higher
    error = radio.mean.reshape(truth.shape)[audible] - truth[audible]
    assert np.sqrt((error**2).mean()) < 2.5
    assert np.abs(error.mean()) < 0.7


def test_deviations_are_honest_on_new_readings(hall: Hall) -> None:
    """Readings of lines that the map never saw. Nothing but readings scatters here: no walls, no carriers."""
    strength = StrengthModel(field_var=2.0, walk_var=0.01, reading_var=hall.noise**2)
    survey = lawn()
    rng = np.random.default_rng(3)
    walks, placed = surveyed(hall, survey, rng)
    radio = build_radio_map(walks[::2] + walks[1::4], placed, RadioSettings(strength=strength))
    assert radio is not None
    at = nodes(radio)
    z2 = []
    for walk, track in zip(walks[3::4], placed[3::4], strict=True):
        assert walk.wifi is not None
        for t, address, rssi in zip(walk.wifi.t, walk.wifi.address, walk.wifi.rssi, strict=True):
            xy = [np.interp(t, track.t, track.xy[:, k]) for k in (0, 1)]
            node = int(np.hypot(*(at - xy).T).argmin())
            row = radio.addresses.index(address)
            if hall.strength(np.array([xy]))[0, hall.address.index(address)] > hall.least + 6.0:
                z2.append(((rssi - radio.mean[row].flat[node]) / (0.1 * radio.sd[row].flat[node])) ** 2)
    assert 0.7 < np.mean(z2) < 1.4


def test_far_from_the_survey_the_deviation_grows(hall: Hall) -> None:
    survey = [pair for pair in lawn() if pair[1].xy[:, 0].max() < 30.0 or pair[0].walk_id == "line-0"]
    radio = build_radio_map(*surveyed(hall, survey, np.random.default_rng(4)))
    assert radio is not None
    at = nodes(radio)
    sd = 0.1 * radio.sd.reshape(len(radio.addresses), -1)
    near = np.hypot(*(at - [18.0, 20.0]).T) < 6.0
    far = np.hypot(*(at - [50.0, 35.0]).T) < 6.0
    assert sd[:, far].mean() > 1.15 * sd[:, near].mean()


def test_being_reported_follows_the_scans(hall: Hall, radio: RadioMap) -> None:
    at = nodes(radio)
    truth = hall.strength(at).T
    seen = radio.seen.reshape(truth.shape) / 255.0
    inside = (at >= 2.0).all(axis=1) & (at <= [58.0, 38.0]).all(axis=1)
    assert seen[inside & (truth > hall.least + 10.0)].mean() > 0.9
    assert seen[inside & (truth < hall.least - 10.0)].mean() < 0.1


def test_the_trend_finds_the_transmitter(hall: Hall) -> None:
    rng = np.random.default_rng(5)
    xy = rng.uniform([0, 0], [60, 40], (1500, 2))
    transmitter = rng.integers(0, len(hall.address), 1500)
    rssi = hall.strength(xy)[np.arange(1500), transmitter] + rng.standard_normal(1500)
    model = StrengthModel(candidates_m=2.0)
    cells = CellReadings.of(xy, rssi, np.zeros(1500, dtype=np.int64), transmitter, model)
    trend = fit_trend(cells, model)
    assert np.median(np.hypot(*(trend.at - hall.at).T)) < 2.5
    assert np.median(np.abs(trend.decay - 3.0)) < 0.4


def test_the_field_is_the_gaussian_process() -> None:
    """Against the textbook solution of one transmitter, at a node of the coarse lattice."""
    rng = np.random.default_rng(6)
    xy = rng.uniform(0, 20, (40, 2))
    rssi = -60.0 + 5.0 * rng.standard_normal(40)
    model = StrengthModel(moves=np.inf)
    cells = CellReadings.of(xy, rssi, rng.integers(0, 4, 40), np.zeros(40, dtype=np.int64), model)
    x, y = np.arange(0.0, 21.0, 5.0), np.arange(0.0, 11.0, 5.0)
    fitted = fit_strength(cells, x, y, model)
    trend = fit_trend(cells, model)
    at = cells.xy[cells.cell]

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return model.field_var * np.exp(-np.linalg.norm(a[:, None] - b, axis=2) / model.length_m)

    node = np.array([[x[2], y[2]]])
    k = covariance(at, at) + np.diag(cells.noise)
    gain = np.linalg.solve(k, covariance(at, node))[:, 0]
    expected = trend.strength(0, node)[0] + gain @ (cells.mean - trend.strength(0, at))
    left = model.field_var - gain @ covariance(at, node)[:, 0]
    leave_out = np.linalg.inv(k)
    z = np.linalg.solve(k, cells.mean - trend.strength(0, at)) / np.sqrt(np.diag(leave_out))
    excess = max(1.0, float(np.minimum(z**2, 25.0).mean()))
    number = 2 * len(x) + 2
    assert fitted.mean[0, number] == pytest.approx(expected, abs=1e-3)
    assert fitted.sd[0, number] == pytest.approx(np.sqrt(excess * (left + model.noise)), abs=1e-3)


def test_a_transmitter_that_moves_is_dropped(hall: Hall) -> None:
    """Another place in every other walk, as somebody's phone would be."""
    rng = np.random.default_rng(7)
    walks, placed = surveyed(hall, lawn(), rng)
    moving = "0f:00:00:00:00:00"
    for i, (walk, track) in enumerate(zip(walks, placed, strict=True)):
        scans = walk.wifi
        assert scans is not None
        distance = np.abs(track.xy[:, 0] - (10.0 if i % 2 else 50.0)) + 2.0
        strength = np.interp(scans.t, track.t, -30.0 - 45.0 * np.log10(distance))
        once = np.arange(0, len(scans.t), 12)
        order = np.argsort(np.concatenate([scans.t, scans.t[once]]), kind="stable")
        address = np.array(scans.address + (moving,) * len(once))[order]
        rssi = np.concatenate([scans.rssi, strength[once]])[order]
        t = np.concatenate([scans.t, scans.t[once]])[order]
        walks[i] = replace(walk, wifi=RadioScans(t, tuple(str(a) for a in address), rssi))
    radio = build_radio_map(walks, placed)
    assert radio is not None
    assert moving not in radio.addresses
    assert set(radio.addresses) == set(hall.address)


def test_what_was_met_too_seldom_is_dropped(hall: Hall) -> None:
    walks, placed = surveyed(hall, lawn(), np.random.default_rng(8))
    only = walks[0].wifi
    assert only is not None
    stranger = RadioScans(only.t[:60], ("0e:00:00:00:00:00",) * 60, only.rssi[:60])
    walks[0] = replace(walks[0], wifi=None, ble=stranger)
    radio = build_radio_map(walks, placed)
    assert radio is not None
    assert not any(name.startswith("ble:") for name in radio.addresses)


def test_wifi_and_ble_with_one_address_are_two_transmitters(hall: Hall) -> None:
    walks, placed = surveyed(hall, lawn(), np.random.default_rng(9))
    both = [replace(walk, ble=walk.wifi) for walk in walks]
    radio = build_radio_map(both, placed)
    assert radio is not None
    assert radio.addresses == tuple(sorted([*hall.address, *("ble:" + a for a in hall.address)]))
    half = len(hall.address)
    np.testing.assert_array_equal(radio.mean[:half], radio.mean[half:])


def test_a_reading_reported_again_counts_once() -> None:
    scans = RadioScans(np.array([1.0, 3.0, 1.0, 1.0]), ("AA", "aa", "bb", "aa"), np.array([-50.0, -60.0, -70.0, -50.0]))
    merged = merge_readings(scans, None)
    assert merged.name == ("aa", "bb", "aa")
    np.testing.assert_array_equal(merged.t, [1.0, 1.0, 3.0])
    np.testing.assert_array_equal(merged.rssi, [-50.0, -70.0, -60.0])


def test_without_radio_there_is_no_layer() -> None:
    survey = lawn()
    assert build_radio_map([walk for walk, _ in survey], [track for _, track in survey]) is None
    assert build_radio_map([], []) is None


def test_a_large_level_gets_larger_cells(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    walks, placed = surveyed(hall, lawn(), np.random.default_rng(10))
    monkeypatch.setattr("app.engine.mapping.radio._MAX_VALUES", 5000)
    radio = build_radio_map(walks, placed)
    assert radio is not None
    assert radio.cell_m == 6.0
    assert radio.mean.size <= 5000
