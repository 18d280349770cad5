"""The field along a track beside the map's: known rotations, known iron, known slopes."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.localization.field_profile import FieldReadings, corrected, field_profile, read_field
from app.engine.types import DeviceCalibration, FeatureSet, Fix, GridMap, ImuSamples, Status

LEVEL = "lvl_a"


def sloping_map(features: FeatureSet = FeatureSet.VECTOR, *, mapped: bool = True) -> GridMap:
    """Channels that grow with x and y: 20 + x, 2 y, -40 uT."""
    y, x = np.mgrid[0:6, 0:8].astype(np.float32)
    parts = {
        FeatureSet.VECTOR: [20.0 + x, 2.0 * y, np.full_like(x, -40.0)],
        FeatureSet.HV: [20.0 + x, np.full_like(x, -40.0)],
        FeatureSet.TOTAL: [20.0 + x],
    }[features]
    mean = np.stack(parts).astype(np.float32)
    support = np.full(x.shape, 0.5 if mapped else 9.0, dtype=np.float32)
    return GridMap(LEVEL, features, 0.0, 0.0, 1.0, mean, np.full_like(mean, 3.0), support, 1.5, (4.0,) * len(parts))


def fix(t: float, x: float, y: float, level_id: str = LEVEL) -> Fix:
    return Fix(t, level_id, x, y, 1.0, 0.0, 1.0, 0.0, Status.OK, 1.0, True)


def still(seconds: float, mag: tuple[float, float, float], *, up: tuple[float, float, float]) -> ImuSamples:
    """A device that lies still, its vertical along ``up`` of its own axes."""
    n = int(seconds * 50)
    rows = [np.tile(np.array(v, dtype=np.float64), (n, 1)) for v in (mag, 9.81 * np.array(up), (0.0, 0.0, 0.0))]
    return ImuSamples(1e9 + np.arange(n) / 50.0, *rows)


@pytest.mark.parametrize(("mag", "up"), [((3.0, 4.0, -12.0), (0.0, 0.0, 1.0)), ((-12.0, 3.0, 4.0), (1.0, 0.0, 0.0))])
def test_horizontal_and_vertical_do_not_depend_on_how_it_is_held(
    mag: tuple[float, float, float], up: tuple[float, float, float]
) -> None:
    readings, _ = read_field(still(4.0, mag, up=up), None)
    profile = field_profile(readings, [fix(1e9 + 2.0, 1.0, 1.0)], {})
    assert profile.measured[:, 0] == pytest.approx([13.0, 5.0, -12.0], abs=1e-3)


def test_segments_go_on_with_the_attitude_of_those_before() -> None:
    whole = still(6.0, (1.0, 2.0, -40.0), up=(0.1, 0.0, 0.995))
    half = len(whole.t) // 2
    parts = [
        ImuSamples(*(getattr(whole, name)[rows] for name in ("t", "mag", "acc", "gyro")))
        for rows in (slice(0, half), slice(half, None))
    ]
    together, _ = read_field(whole, None)
    first, attitude = read_field(parts[0], None)
    second, _ = read_field(parts[1], attitude)
    assert np.concatenate([first.field, second.field]) == pytest.approx(
        together.field[: len(first.t) + len(second.t)], abs=1e-3
    )


def test_the_map_is_read_between_its_nodes() -> None:
    readings = FieldReadings(np.array([1e9]), np.array([[30.0, 40.0, 0.0]]))
    profile = field_profile(
        readings, [fix(1e9, 2.5, 1.5), fix(1e9, 2.5, 99.0), fix(1e9, 1.0, 1.0, "lvl_b")], {LEVEL: sloping_map()}
    )
    h = np.hypot(22.5, 3.0)
    assert profile.mapped[:, 0] == pytest.approx([np.hypot(h, 40.0), h, -40.0], rel=1e-6)
    # map and reading together: 3 and 4
    assert profile.sd[2, 0] == pytest.approx(5.0)
    assert profile.measured[:, 0] == pytest.approx([50.0, 50.0, 0.0])
    assert np.isnan(profile.mapped[:, 1:]).all()


def test_what_is_not_mapped_or_not_measured_is_nan() -> None:
    readings = FieldReadings(np.array([1e9]), np.array([[30.0, 40.0, 0.0]]))
    profile = field_profile(readings, [fix(1e9 + 3.0, 2.5, 1.5)], {LEVEL: sloping_map(mapped=False)})
    assert np.isnan(profile.mapped).all()
    assert np.isnan(profile.measured).all()
    assert field_profile(readings, [], {}).measured.shape == (3, 0)


def test_a_map_of_intensity_has_no_components() -> None:
    readings = FieldReadings(np.array([1e9]), np.array([[30.0, 40.0, 0.0]]))
    profile = field_profile(readings, [fix(1e9, 3.0, 1.0)], {LEVEL: sloping_map(FeatureSet.TOTAL)})
    assert profile.mapped[0, 0] == pytest.approx(23.0)
    assert np.isnan(profile.mapped[1:, 0]).all()


def test_iron_is_taken_off() -> None:
    iron = (0.02, -0.03, 0.01, 0.015, -0.01, 0.02)
    matrix = np.eye(3) + np.array([[0.02, 0.015, -0.01], [0.015, -0.03, 0.02], [-0.01, 0.02, 0.01]])
    true = np.array([[20.0, -5.0, -40.0], [3.0, 18.0, -44.0]])
    read = true @ matrix.T + np.array([4.0, -7.0, 2.0])
    known = DeviceCalibration((4.0, -7.0, 2.0), (1.0,) * 3, 1.0, 0.1, iron)
    assert corrected(read, known) == pytest.approx(true)
    profile = field_profile(FieldReadings(np.array([1e9, 1e9 + 5.0]), read), [fix(1e9, 1.0, 1.0)], {}, known)
    assert profile.measured[0, 0] == pytest.approx(float(np.linalg.norm(true[0])))
