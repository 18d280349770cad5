"""What a session contributes: where it was sure, corrected for its device, no surer than its fixes."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.inertial import detect_steps
from app.engine.mapping.crowd import ContributionPolicy, ContributionResult, Omission, contribute
from app.engine.types import (
    DeviceCalibration,
    EvidenceSource,
    FeatureSet,
    Fix,
    FixKind,
    Float64Array,
    GridMap,
    Segment,
    SourceKind,
    Status,
)
from tests.engine.conftest import CORNERS
from tests.support.walks import Field, SimulatedWalk, cut, true_map, walk_through

SOURCE = EvidenceSource("s", SourceKind.SESSION, "ann", t=1.0)
IRON = np.array([3.0, -2.0, 4.0])
"""Of the body: x right, y forward, z up."""


def fixes_of(walk: SimulatedWalk, *, spread: float = 0.7, shift: tuple[float, float] = (0.0, 0.0)) -> list[Fix]:
    """A sure fix at each step, at its true place but for ``shift``."""
    times = detect_steps(walk.samples)
    places = [walk.at(float(t)) + shift for t in times]
    return [
        Fix(
            float(t), "sim", float(x), float(y), spread**2, 0.0, spread**2, 0.0, Status.OK, 0.9, sure=True,
            kind=FixKind.SMOOTHED,
        )
        for t, (x, y) in zip(times, places, strict=True)
    ]  # fmt: skip


def segments_of(walk: SimulatedWalk) -> list[Segment]:
    return [Segment(part) for part in cut(walk.samples, seconds=5.0)]


@pytest.fixture(scope="module")
def held(field: Field) -> SimulatedWalk:
    """A walk whose phone has hard iron and is held askew."""
    return walk_through(CORNERS, field, np.random.default_rng(5), hard_iron=IRON, carry=0.15)


def error(result: ContributionResult, field: Field) -> Float64Array:
    """Root mean square per channel of the rows about the field, uT."""
    xy = result.evidence.xy.astype(float)
    return np.sqrt(((result.evidence.values - field.at(xy)) ** 2).mean(axis=0))


def test_rows_are_the_field_of_the_level(held: SimulatedWalk, field: Field, field_map: GridMap) -> None:
    fixes = fixes_of(held)
    result = contribute(SOURCE, fixes, segments_of(held), field_map)
    assert result.evidence.sources == (SOURCE,)
    assert result.kept == result.steps == len(fixes)
    assert len(result.evidence) == 2 * len(fixes) - 1  # steps and half steps
    assert error(result, field).max() < 1.2
    assert result.offsets[0].hard_iron == pytest.approx((-2.0, -3.0, 4.0), abs=1.0)
    assert result.offsets[0].carry == pytest.approx(0.15, abs=0.06)
    np.testing.assert_allclose(result.evidence.spread, 0.7, atol=1e-5)


def test_without_the_map_the_device_would_be_in_the_field(held: SimulatedWalk, field: Field) -> None:
    """A map that tells nothing leaves the hard iron in: that the test above can fail."""
    vague = true_map(field, (0.0, 0.0, 42.0, 22.0), sd=500.0, noise=500.0)
    policy = ContributionPolicy(adjust=False)
    assert error(contribute(SOURCE, fixes_of(held), segments_of(held), vague, policy=policy), field).max() > 2.5


def test_what_is_known_of_the_device_helps_where_the_map_is_vague(held: SimulatedWalk, field: Field) -> None:
    vague = true_map(field, (0.0, 0.0, 42.0, 22.0), sd=500.0, noise=500.0)
    known = DeviceCalibration((-2.0, -3.0, 4.0), (0.5,) * 3, 1.0, 0.05)
    policy = ContributionPolicy(adjust=False)
    with_it = contribute(SOURCE, fixes_of(held), segments_of(held), vague, calibration=known, policy=policy)
    without = contribute(SOURCE, fixes_of(held), segments_of(held), vague, policy=policy)
    assert error(with_it, field)[2] < 0.5 < error(without, field)[2]


def test_places_move_to_where_the_field_fits(held: SimulatedWalk, field_map: GridMap) -> None:
    fixes, segments = fixes_of(held, shift=(0.8, 0.4)), segments_of(held)
    truth = np.array([held.at(fix.t) for fix in fixes])

    def off(adjust: bool) -> float:
        rows = contribute(SOURCE, fixes, segments, field_map, policy=ContributionPolicy(adjust=adjust)).evidence
        return float(np.median(np.linalg.norm(rows.xy[::2] - truth, axis=1)))

    assert off(adjust=True) < 0.6 * off(adjust=False)


def test_steps_without_a_claim_are_left_out_with_those_about_them(held: SimulatedWalk, field_map: GridMap) -> None:
    fixes = fixes_of(held)
    middle = len(fixes) // 2
    fixes[middle] = replace(fixes[middle], status=Status.AMBIGUOUS, sure=False)
    fixes[3] = replace(fixes[3], cov_xx=9.0, cov_yy=9.0)
    fixes[-1] = replace(fixes[-1], level_id="other")
    fixes[-2] = replace(fixes[-2], sure=False)
    result = contribute(SOURCE, fixes, segments_of(held), field_map)
    omitted = dict(result.omitted)
    assert omitted[Omission.STATUS] == omitted[Omission.SPREAD] == 1
    assert omitted[Omission.OTHER_LEVEL] == omitted[Omission.NOT_SURE] == 1
    assert omitted[Omission.SHORT] == 3  # the three steps before the coarse one are too few by themselves
    assert 8 <= omitted[Omission.NEAR_LOST] <= 16  # 4 s on either side
    assert result.kept == len(fixes) - sum(omitted.values())
    assert len(result.reasons()) == len(omitted)
    lost = held.at(fixes[middle].t)
    assert np.linalg.norm(result.evidence.xy - lost, axis=1).min() > 3.0


def test_ground_without_a_map_gives_nothing_to_compare_with(held: SimulatedWalk, field_map: GridMap) -> None:
    unmapped = replace(field_map, support=np.full_like(field_map.support, 50.0))
    result = contribute(SOURCE, fixes_of(held), segments_of(held), unmapped)
    assert len(result.evidence) == 0
    assert dict(result.omitted) == {Omission.UNRELATED: result.steps}


def test_maps_without_direction_take_contributions_too(held: SimulatedWalk, field: Field, field_map: GridMap) -> None:
    mean = np.stack([np.hypot(field_map.mean[0], field_map.mean[1]), field_map.mean[2]])
    hv = replace(field_map, features=FeatureSet.HV, mean=mean, sd=field_map.sd[:2], noise_sd=(1.0, 1.0))
    known = DeviceCalibration((-2.0, -3.0, 4.0), (0.5,) * 3, 1.0, 0.05)
    rows = contribute(SOURCE, fixes_of(held), segments_of(held), hv, calibration=known).evidence
    assert rows.values.shape[1] == 2
    truth = field.at(rows.xy.astype(float))
    assert np.sqrt(np.mean((rows.values[:, 1] - truth[:, 2]) ** 2)) < 1.0


def test_no_session_no_rows(field_map: GridMap) -> None:
    result = contribute(SOURCE, [], [], field_map)
    assert len(result.evidence) == result.steps == 0
    with pytest.raises(InputError, match="session"):
        contribute(replace(SOURCE, kind=SourceKind.SURVEY), [], [], field_map)


def test_results_pickle(held: SimulatedWalk, field_map: GridMap) -> None:
    result = contribute(SOURCE, fixes_of(held), segments_of(held), field_map)
    assert len(pickle.dumps(result)) < 40 * len(result.evidence) + 4000
