"""The tasks on the real engine, with a small simulated level."""

import pickle
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.errors import InputError, MapError
from app.engine.geodesy import TangentPlane
from app.engine.localization.registry import create_tracker
from app.engine.mapping import NewWalk, build_map
from app.engine.types import DeviceCalibration, FixKind, GridMap, ImuSamples, MapBuildSettings, Prior, Segment
from app.services.aids import Recording
from app.services.tasks import BuildSpec, LocateSpec, MapRef, SmoothSpec
from app.storage.map_cache import open_map
from app.workers.bootstrap import warm_up
from app.workers.processes import ProcessExecutor
from app.workers.tasks import BuildMap, LocateSegment, OpenMaps, SmoothSession, SpecMaps
from tests.e2e.synthetic import EXTENT, survey_walks, trip
from tests.support.builders import all_aids, samples
from tests.workers.conftest import type_makes
from tests.workers.sample_tasks import echo

LEVEL = "lvl_1"


def no_progress(fraction: float, text: str) -> None:
    pass


@pytest.fixture(scope="module")
def grid_map() -> GridMap:
    walks = [walk.survey(f"wlk_{i}") for i, walk in enumerate(survey_walks())]
    return build_map(LEVEL, walks, MapBuildSettings(extent=EXTENT)).grid_map


@dataclass(frozen=True)
class Shelf:
    """Opens "files": a map by its path, and writes down how often."""

    maps: dict[Path, GridMap]
    opened: list[Path]

    def open(self, path: Path) -> GridMap:
        self.opened.append(path)
        return self.maps[path]


def ref(number: int, level_id: str = LEVEL) -> MapRef:
    return MapRef(level_id, f"hash-{number}", Path(f"/maps/{number}"))


def specs(seconds: float = 5.0, n: int = 4) -> list[LocateSpec]:
    """Specs of the first segments of a walk; every state but the first is still missing."""
    walk = trip(3, t0=1.75e9)
    prior = Prior(LEVEL, float(walk.x[0]), float(walk.y[0]))
    rows = int(seconds * 50)
    chunks = [slice(i * rows, (i + 1) * rows) for i in range(n)]
    s = walk.samples
    parts = [ImuSamples(s.t[c], s.mag[c], s.acc[c], s.gyro[c]) for c in chunks]
    return [LocateSpec("particle", {}, prior, 42, None, Segment(part), (ref(0),)) for part in parts]


def test_segments_in_turn_follow_the_walk(grid_map: GridMap) -> None:
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    walk, state, errors = trip(3, t0=1.75e9), None, []
    for spec in specs():
        result = task(replace(spec, state=state), no_progress)
        state = result.state
        assert result.cpu_s > 0
        for fix in result.fixes:
            at = np.searchsorted(walk.samples.t, fix.t)
            errors.append(np.hypot(fix.x - walk.x[at], fix.y - walk.y[at]))
    assert len(errors) > 20
    assert np.median(errors) < 1.0


def test_earlier_steps_are_told_once_more(grid_map: GridMap) -> None:
    task, state, told, later = LocateSegment(Shelf({ref(0).path: grid_map}, []).open), None, [], []
    for spec in specs():
        result = task(replace(spec, state=state), no_progress)
        state = result.state
        told += [fix.t for fix in result.fixes]
        later += result.lagged
    assert len(later) > 10
    assert {fix.kind for fix in later} == {FixKind.FIXED_LAG}
    assert {fix.t for fix in later} < set(told)


def test_what_was_learned_comes_with_the_result(grid_map: GridMap) -> None:
    """Not while the place is unknown; once it is, what the tracker says of the very state that is handed back."""
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    first, *rest = specs(n=6)
    cold = task(replace(first, prior=Prior(LEVEL)), no_progress)
    assert cold.calibration is None
    state = None
    for spec in (first, *rest):
        result = task(replace(spec, state=state), no_progress)
        state = result.state
    assert result.calibration is not None
    assert result.calibration == create_tracker("particle").learned(state)
    assert result.calibration.stride_scale == pytest.approx(1.0, abs=0.3)


def test_what_is_known_of_the_device_starts_the_session(grid_map: GridMap) -> None:
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    (spec,) = specs(n=1)
    known = DeviceCalibration((9.0, 0.0, 0.0), (2.0, 2.0, 2.0), 1.2, 0.04)
    told = replace(spec, prior=replace(spec.prior, calibration=known))
    assert task(told, no_progress).state != task(spec, no_progress).state


def test_the_same_spec_gives_the_same_result(grid_map: GridMap) -> None:
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    first, second = (task(spec, no_progress) for spec in specs(n=1) * 2)
    assert (first.state, first.fixes) == (second.state, second.fixes)


def test_an_unknown_method_is_an_input_error(grid_map: GridMap) -> None:
    task = LocateSegment(Shelf({ref(0).path: grid_map}, []).open)
    with pytest.raises(InputError, match="method"):
        task(replace(specs(n=1)[0], method="guess"), no_progress)


def smooth_spec() -> SmoothSpec:
    first, *rest = specs()
    segments = tuple(spec.segment for spec in (first, *rest))
    return SmoothSpec("particle", {}, first.prior, 42, segments, first.maps)


def test_a_session_is_smoothed_from_all_its_segments(grid_map: GridMap) -> None:
    task, walk = SmoothSession(Shelf({ref(0).path: grid_map}, []).open), trip(3, t0=1.75e9)
    result = task(smooth_spec(), no_progress)
    assert result.cpu_s > 0
    at = np.searchsorted(walk.samples.t, [fix.t for fix in result.fixes])
    errors = [np.hypot(fix.x - walk.x[i], fix.y - walk.y[i]) for fix, i in zip(result.fixes, at, strict=True)]
    assert len(errors) > 20
    assert np.median(errors) < 1.0
    assert task(smooth_spec(), no_progress).fixes == result.fixes


def test_a_method_without_a_smoother_is_an_input_error(grid_map: GridMap) -> None:
    task = SmoothSession(Shelf({ref(0).path: grid_map}, []).open)
    with pytest.raises(InputError, match="method"):
        task(replace(smooth_spec(), method="dead_reckoning"), no_progress)


@pytest.mark.parametrize("kind", [LocateSegment, SmoothSession])
def test_the_task_crosses_a_process_boundary(kind: type[LocateSegment] | type[SmoothSession]) -> None:
    task = kind(open_map, keep_maps=3)
    assert pickle.loads(pickle.dumps(task)) == task


def test_a_worker_process_gives_the_same_fixes_as_this_one(
    grid_map: GridMap, tmp_path: Path, make_processes: type_makes
) -> None:
    file = tmp_path / "map.pickle"
    file.write_bytes(pickle.dumps(grid_map))
    spec = replace(specs(n=1)[0], maps=(MapRef(LEVEL, "hash-of-file", file),))
    pool: ProcessExecutor = make_processes(1)
    there = pool.submit(LocateSegment(read_pickled_map), spec, affinity="hash-of-file").result(120)
    here = LocateSegment(read_pickled_map)(spec, no_progress)
    assert (there.state, there.fixes) == (here.state, here.fixes)
    whole = replace(smooth_spec(), maps=spec.maps)
    smoothed = pool.submit(SmoothSession(read_pickled_map), whole, affinity="hash-of-file").result(120)
    assert smoothed.fixes == SmoothSession(read_pickled_map)(whole, no_progress).fixes


def test_aids_reach_a_worker_process_to_the_bit(make_processes: type_makes) -> None:
    sent = Recording(samples(), all_aids()).segment(TangentPlane(48.1507, 11.5691, 12.5))
    spec = replace(specs(n=1)[0], segment=sent)
    pool: ProcessExecutor = make_processes(1)
    there = pool.submit(echo, spec).result(120)
    for aid in ("wifi", "ble", "gnss", "pressure", "speed", "steps"):
        given, taken = getattr(sent, aid), getattr(there.segment, aid)
        assert type(given) is type(taken)
        for column in fields(given):
            a, b = getattr(given, column.name), getattr(taken, column.name)
            assert a == b if isinstance(a, tuple) else a.tobytes() == b.tobytes(), (aid, column.name)


def read_pickled_map(path: Path) -> GridMap:
    loaded = pickle.loads(path.read_bytes())
    assert isinstance(loaded, GridMap)
    return loaded


def test_a_map_is_opened_once(grid_map: GridMap) -> None:
    shelf, maps = Shelf({ref(0).path: grid_map}, []), OpenMaps()
    assert all(maps.get(ref(0), shelf.open, 2) is grid_map for _ in range(5))
    assert shelf.opened == [ref(0).path]


def test_the_map_unused_for_longest_goes_first(grid_map: GridMap) -> None:
    shelf, maps = Shelf({ref(i).path: grid_map for i in range(3)}, []), OpenMaps()
    for number in (0, 1, 0, 2, 0, 1):
        maps.get(ref(number), shelf.open, 2)
    assert shelf.opened == [ref(i).path for i in (0, 1, 2, 1)]
    assert len(maps) == 2


def test_the_spec_names_the_maps_a_tracker_may_use(grid_map: GridMap) -> None:
    shelf = Shelf({ref(i).path: grid_map for i in range(10, 12)}, [])
    source = SpecMaps((ref(10, "lvl_a"), ref(11, "lvl_b")), shelf.open, keep=1)
    assert source.level_ids() == ("lvl_a", "lvl_b")
    assert source.grid_map("lvl_b") is grid_map
    source.grid_map("lvl_a")
    source.grid_map("lvl_b")
    assert len(shelf.opened) == 2, "keep must not be less than what one task needs"
    with pytest.raises(MapError, match="lvl_c"):
        source.grid_map("lvl_c")


def test_building_reports_progress_and_time() -> None:
    walks = tuple(NewWalk(walk.survey(f"wlk_{i}"), device=f"dev_{i}") for i, walk in enumerate(survey_walks()))
    seen: list[float] = []
    spec = BuildSpec(LEVEL, walks, MapBuildSettings(extent=EXTENT))
    result = BuildMap(Shelf({}, []).open)(spec, lambda fraction, text: seen.append(fraction))
    assert result.cpu_s > 0
    assert result.build.grid_map.level_id == LEVEL
    assert seen
    assert seen == sorted(seen)
    assert 0 <= seen[0] <= seen[-1] <= 1


def test_warming_up_twice_is_fine() -> None:
    warm_up()
    warm_up()
