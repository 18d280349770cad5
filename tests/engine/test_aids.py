"""Radio scans and satellite fixes in the tracker and in a search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.localization import codec, create_tracker
from app.engine.localization.aids import (
    AidMemory,
    GnssSighting,
    RadioSighting,
    at_way,
    memory_from,
    memory_values,
    sighting_from,
    sighting_values,
    sightings,
)
from app.engine.types import Fix, GnssFixes, GridMap, Prior, RadioMap, RadioScans, Segment, Status
from tests.engine.conftest import OneMap
from tests.support.walks import SimulatedWalk, cut

TRANSMITTERS = {"00:00:00:00:00:10": (4.0, 4.0), "00:00:00:00:00:20": (36.0, 4.0), "00:00:00:00:00:30": (20.0, 18.0)}


def strength(at: np.ndarray, xy: tuple[float, float]) -> np.ndarray:
    return -40.0 - 25.0 * np.log10(np.maximum(np.hypot(at[..., 0] - xy[0], at[..., 1] - xy[1]), 1.0))


def radio_map() -> RadioMap:
    x, y = np.meshgrid(np.arange(0.0, 43.0, 3.0), np.arange(0.0, 23.0, 3.0))
    mean = np.stack([strength(np.stack([x, y], axis=-1), at) for at in TRANSMITTERS.values()])
    return RadioMap(
        x0=0.0, y0=0.0, cell_m=3.0, addresses=tuple(TRANSMITTERS), mean=mean.astype(np.int8),
        sd=np.full(mean.shape, 40, np.uint8), seen=np.full(mean.shape, 250, np.uint8),
    )  # fmt: skip


def scans(walk: SimulatedWalk, t: np.ndarray) -> RadioScans:
    """One scan at each time, with the strengths of the walker's place."""
    rows = [(at, name, float(strength(walk.at(at), xy))) for at in t for name, xy in TRANSMITTERS.items()]
    return RadioScans(np.array([r[0] for r in rows]), tuple(r[1] for r in rows), np.array([r[2] for r in rows]))


def run(walk: SimulatedWalk, grid_map: GridMap, prior: Prior, aid: str, *, shift: float = 0.0) -> list[Fix]:
    tracker = create_tracker("particle")
    state, fixes = tracker.start(prior, seed=1), []
    for samples in cut(walk.samples, seconds=5.0):
        t = np.arange(samples.t[0] + 0.5, samples.t[-1], 2.0)
        segment = Segment(samples)
        if aid == "wifi":
            segment = replace(segment, wifi=scans(walk, t))
        elif aid == "gnss":
            at = np.array([walk.at(v) for v in t]) + shift
            segment = replace(segment, gnss=GnssFixes(t, at[:, 0], at[:, 1], np.full(len(t), 2.0)))
        state, new = tracker.step(state, segment, OneMap(grid_map))
        fixes += new
    return fixes


def errors(fixes: list[Fix], walk: SimulatedWalk) -> np.ndarray:
    return np.array([np.hypot(*(walk.at(fix.t) - [fix.x, fix.y])) for fix in fixes])


@pytest.fixture(scope="module")
def blank(field_map: GridMap) -> GridMap:
    """A level whose field is unknown: what is learned of the place comes from the aids alone."""
    vague = np.full_like(field_map.mean, 30.0)
    return replace(field_map, sd=vague, support=vague[0], radio=radio_map())


@pytest.mark.parametrize("aid", ["wifi", "gnss"])
def test_an_aid_mends_a_wrong_start(walk: SimulatedWalk, blank: GridMap, aid: str) -> None:
    wrong = Prior("sim", *(walk.at(walk.samples.t[0]) + 5.0), 7.9, heading=0.0, heading_sd=0.1)
    without = errors(run(walk, blank, wrong, "none"), walk)
    aided = errors(run(walk, blank, wrong, aid), walk)
    assert np.median(aided[20:]) < 0.75 * np.median(without[20:])
    assert np.median(aided[20:]) < 4.0


@pytest.mark.parametrize("aid", ["wifi", "gnss"])
def test_an_aid_shortens_a_search(walk: SimulatedWalk, field_map: GridMap, aid: str) -> None:
    with_radio = replace(field_map, radio=radio_map())
    early = slice(0, 15)
    without = errors(run(walk, with_radio, Prior("sim"), "none")[early], walk)
    aided = errors(run(walk, with_radio, Prior("sim"), aid)[early], walk)
    assert np.median(aided) < max(0.5 * np.median(without), 4.0)


def test_reflected_satellite_fixes_do_not_carry_the_track_away(walk: SimulatedWalk, field_map: GridMap) -> None:
    start = Prior("sim", *walk.at(walk.samples.t[0]), 2.0)
    away = errors(run(walk, field_map, start, "gnss", shift=60.0), walk)
    assert np.median(away) < 2.0


def test_an_aid_beside_an_unknown_radio_map_changes_nothing(walk: SimulatedWalk, field_map: GridMap) -> None:
    start = Prior("sim", *walk.at(walk.samples.t[0]), 2.0)
    assert run(walk, field_map, start, "wifi") == run(walk, field_map, start, "none")


def test_nothing_is_seen_twice(walk: SimulatedWalk) -> None:
    samples = cut(walk.samples, seconds=5.0)[0]
    t = samples.t[0] + np.array([0.0, 2.5])
    segment = Segment(samples, wifi=scans(walk, t), gnss=GnssFixes(t, t * 0, t * 0, t * 0 + 3.0))
    memory, seen = sightings(segment, AidMemory(), 0.0)
    assert [type(s) for s in seen].count(RadioSighting) == 2
    assert [type(s) for s in seen].count(GnssSighting) == 2
    assert [s.t for s in seen] == sorted(s.t for s in seen)
    _, again = sightings(segment, memory, 0.0)
    assert again == ()


def test_satellite_fixes_that_follow_closely_count_less(walk: SimulatedWalk) -> None:
    samples = cut(walk.samples, seconds=5.0)[0]
    t = samples.t[0] + np.array([0.0, 1.0, 101.0])
    _, seen = sightings(Segment(samples, gnss=GnssFixes(t, t * 0, t * 0, t * 0 + 3.0)), AidMemory(), 0.0)
    shares = [s.share for s in seen if isinstance(s, GnssSighting)]
    assert shares == pytest.approx([1.0, 0.095, 1.0], abs=0.01)


def test_scans_know_the_way_walked(walk: SimulatedWalk) -> None:
    t0 = walk.samples.t[0]
    _, seen = sightings(Segment(walk.samples, wifi=scans(walk, t0 + np.array([1.0, 6.0]))), AidMemory(), 0.0)
    placed = at_way(seen, t0 + np.array([2.0, 4.0]), np.array([10.0, 10.7, 11.4]))
    assert [s.travelled_m for s in placed if isinstance(s, RadioSighting)] == [10.0, 11.4]


def test_sightings_survive_storage(walk: SimulatedWalk) -> None:
    samples = cut(walk.samples, seconds=5.0)[0]
    t = samples.t[0] + np.array([0.0, 2.5])
    segment = Segment(samples, wifi=scans(walk, t), gnss=GnssFixes(t, t * 0, t * 0, t * 0 + 3.0))
    memory, seen = sightings(segment, AidMemory(), 5.0)
    packed = codec.pack({"memory": memory_values(memory), "seen": [sighting_values(s) for s in seen]})
    values = codec.unpack(packed)
    assert memory_from(values["memory"]) == memory
    for ours, theirs in zip(seen, map(sighting_from, values["seen"]), strict=True):
        assert sighting_values(ours)[:3] == sighting_values(theirs)[:3]
        if isinstance(ours, RadioSighting) and isinstance(theirs, RadioSighting):
            assert ours.scan.name == theirs.scan.name
            np.testing.assert_array_equal(ours.scan.rssi, theirs.scan.rssi)


def test_a_found_start_is_still_claimed_with_aids(walk: SimulatedWalk, field_map: GridMap) -> None:
    fixes = run(walk, replace(field_map, radio=radio_map()), Prior("sim"), "wifi")
    assert fixes[-1].status is Status.OK
    assert errors(fixes, walk)[-1] < 3.0
