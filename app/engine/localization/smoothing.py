"""A session's trajectory after the fact, from all its segments at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.filtering import Advance
from app.engine.inertial import gap_before
from app.engine.localization.integrity import calibrate, judge
from app.engine.localization.particle import ParticleTracker, SessionState
from app.engine.types import Fix, Float32Array, Float64Array, MapSource, Prior, Segment

SMOOTHING_PARTICLES = 6000


@dataclass(frozen=True, slots=True)
class _Step:
    """One step of the forward pass: positions before resampling, and where the next step's particles came from."""

    fix: Fix
    x: Float32Array
    y: Float32Array
    ancestors: NDArray[np.int32] | None


def smooth_session(
    tracker: ParticleTracker, prior: Prior, segments: Sequence[Segment], map_source: MapSource, *, seed: int
) -> tuple[Fix, ...]:
    """Smoothed fixes, one per step: positions that use the samples on both sides of their time.

    The genealogy of the particles is followed back from the end (Kitagawa 1996, doi:10.2307/1390750). Lines merge going
    back, so more particles are used than for tracking. After a gap between segments the filter draws its particles
    anew, so nothing is followed across it: each stretch between gaps is smoothed for itself.
    """
    n = SMOOTHING_PARTICLES  # whatever tracking uses: half an hour of them takes 200 MB
    wide = ParticleTracker(
        replace(tracker.parameters, particles=n, cold_particles=n),  # one number throughout: lines must not break
        tracker.noise,
        tracker.spread,
        tracker.policy,
    )
    session = SessionState(prior, seed)
    fixes: list[Fix] = []
    steps: list[_Step] = []
    weights: Float64Array = np.empty(0)
    for segment in segments:
        if session.track is not None and gap_before(session.track.pedestrian, segment.samples) > 0.0:
            fixes += _trace_back(wide, steps, weights, session)
            steps = []
        for fix, moved in wide.walk(session, segment, map_source):
            if moved is None:
                continue
            steps.append(_record(fix, moved))
            weights = moved.weighted.p[14].astype(np.float64)
    return (*fixes, *_trace_back(wide, steps, weights, session))


def _record(fix: Fix, moved: Advance) -> _Step:
    p = moved.weighted.p
    # As small as they come: half an hour has thousands of steps.
    ancestors = None if moved.ancestors is None else moved.ancestors.astype(np.int32)
    return _Step(fix, p[0].copy(), p[1].copy(), ancestors)


def _trace_back(
    tracker: ParticleTracker, steps: Sequence[_Step], weights: Float64Array, session: SessionState
) -> tuple[Fix, ...]:
    if not steps or session.track is None:
        return ()
    policy = replace(tracker.policy, covariance_scale=tracker.policy.covariance_scale * tracker.policy.smoothed_scale)
    index = np.arange(weights.shape[0], dtype=np.int32)
    weights = weights / weights.sum()
    fixes: list[Fix] = []
    for k in range(len(steps) - 1, -1, -1):
        step = steps[k]
        if k < len(steps) - 1 and step.ancestors is not None:
            index = step.ancestors[index]
        x, y = step.x[index].astype(np.float64), step.y[index].astype(np.float64)
        mx, my = float(weights @ x), float(weights @ y)
        estimate = replace(
            session.track.estimate,
            x=mx,
            y=my,
            cov_xx=float(weights @ (x - mx) ** 2),
            cov_xy=float(weights @ ((x - mx) * (y - my))),
            cov_yy=float(weights @ (y - my) ** 2),
        )
        cov_xx, cov_xy, cov_yy = calibrate(estimate, session.track.integrity, policy)
        verdict = judge(estimate, session.track.integrity, tracker.policy)
        fixes.append(
            replace(
                step.fix,
                x=mx,
                y=my,
                cov_xx=cov_xx,
                cov_xy=cov_xy,
                cov_yy=cov_yy,
                status=verdict.status,
                quality=verdict.quality,
                sure=verdict.sure,
                walk_on_m=verdict.walk_on_m,
            )
        )
    return tuple(reversed(fixes))
