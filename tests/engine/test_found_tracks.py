"""What a track claims whose place was found by a search: less than one that was told where it begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.filtering import Estimate
from app.engine.localization.integrity import Integrity, IntegrityPolicy, judge, tell
from app.engine.localization.lost import LostPolicy
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import SessionState
from app.engine.localization.smoothing import smooth_session
from app.engine.types import Fix, FixKind, GridMap, Prior, Segment, Status
from tests.engine.conftest import OneMap
from tests.support.walks import SimulatedWalk, cut

POLICY = IntegrityPolicy()
TOLD = Integrity(walked_m=40.0, settled=True, borne_out=True)
FOUND = replace(TOLD, found=True)


def at(sd: float) -> Estimate:
    """Particles about one place, as wide in all directions."""
    return Estimate(10.0, 10.0, sd**2, 0.0, sd**2, 0.0, 1.0)


@pytest.mark.parametrize("kind", FixKind)
def test_the_ellipse_of_a_found_track_is_wider(kind: FixKind) -> None:
    told, found = (tell(0.0, "sim", at(2.0), integrity, POLICY, kind=kind) for integrity in (TOLD, FOUND))
    floor = POLICY.covariance_floor
    assert found.cov_xx - floor == pytest.approx(POLICY.found_scale * (told.cov_xx - floor))
    assert found.quality < told.quality
    assert found.status is told.status is Status.OK


def test_sure_goes_by_the_width_that_is_claimed() -> None:
    widest = POLICY.sure_m / np.sqrt(POLICY.found_scale)
    assert judge(at(0.99 * widest), FOUND, POLICY).sure
    assert not judge(at(1.01 * widest), FOUND, POLICY).sure
    assert judge(at(0.99 * POLICY.sure_m), TOLD, POLICY).sure


def test_the_worse_it_fits_the_less_is_claimed() -> None:
    misfits = (-0.5, 0.0, POLICY.found_misfit, 2.0 * POLICY.found_misfit)
    wide = [tell(0.0, "sim", at(1.2), replace(FOUND, misfit=misfit), POLICY) for misfit in misfits]
    ratio = [(fix.cov_xx - POLICY.covariance_floor) / (wide[1].cov_xx - POLICY.covariance_floor) for fix in wide]
    assert ratio == pytest.approx([1.0, 1.0, 2.0, 5.0])
    assert [fix.sure for fix in wide] == [True, True, False, False]
    assert all(fix.status is Status.OK for fix in wide)
    told = tell(0.0, "sim", at(1.2), replace(TOLD, misfit=misfits[-1]), POLICY)
    assert told == tell(0.0, "sim", at(1.2), TOLD, POLICY)


def searched(walk: SimulatedWalk, grid_map: GridMap, n: int | None = None) -> tuple[list[Fix], SessionState]:
    """A walk from an unknown start on the level, or its first ``n`` segments."""
    tracker, session, fixes = ParticleTracker(), SessionState(Prior("sim"), 1), list[Fix]()
    for samples in cut(walk.samples, seconds=5.0)[:n]:
        fixes += [fix for fix, _ in tracker.walk(session, Segment(samples), OneMap(grid_map))]
    return fixes, session


def test_who_is_found_stays_found(walk: SimulatedWalk, field_map: GridMap) -> None:
    """Through the state, and whatever the track learns later."""
    fixes, session = searched(walk, field_map)
    assert session.track is not None
    assert session.track.integrity.found
    again = SessionState.decode(session.encode()).track
    assert again is not None
    assert again.integrity == session.track.integrity
    assert any(fix.sure for fix in fixes)


def test_a_track_that_was_told_its_start_is_not_found(walk: SimulatedWalk, field_map: GridMap) -> None:
    x, y = (float(v) for v in walk.at(float(walk.samples.t[0])))
    session = SessionState(Prior("sim", x, y, 3.0), 1)
    for _ in ParticleTracker().walk(session, Segment(cut(walk.samples, seconds=5.0)[0]), OneMap(field_map)):
        pass
    assert session.track is not None
    assert not session.track.integrity.found


def test_a_found_track_knows_how_well_its_newest_steps_fit(walk: SimulatedWalk, field_map: GridMap) -> None:
    """What the watch over lost tracks measures is what the next fix goes by: with another field the walk fits badly."""
    noisy = replace(
        field_map,
        mean=field_map.mean + np.float32(6.0) * np.sin(0.9 * np.arange(field_map.shape[1])).astype(np.float32),
    )
    misfits = []
    for grid_map in (field_map, noisy):
        tracker, (_, session) = ParticleTracker(lost=LostPolicy(lost=1e9, doubted=1e9)), searched(walk, field_map, 10)
        for samples in cut(walk.samples, seconds=5.0)[10:]:
            for _ in tracker.walk(session, Segment(samples), OneMap(grid_map)):
                pass
        assert session.track is not None
        assert session.track.integrity.misfit == session.track.trail.misfit
        misfits.append(session.track.integrity.misfit)
    assert misfits[1] > misfits[0] + 0.1


def test_smoothed_fixes_of_a_found_track_are_wider_too(walk: SimulatedWalk, field_map: GridMap) -> None:
    segments = [Segment(samples) for samples in cut(walk.samples, seconds=5.0)]
    wide, narrow = (
        smooth_session(ParticleTracker(policy=policy), Prior("sim"), segments, OneMap(field_map), seed=1)
        for policy in (POLICY, replace(POLICY, found_scale=1.0))
    )
    floor = POLICY.covariance_floor
    ratio = [(w.cov_xx - floor) / (n.cov_xx - floor) for w, n in zip(wide, narrow, strict=True)]
    np.testing.assert_allclose(ratio, POLICY.found_scale, rtol=1e-3)
