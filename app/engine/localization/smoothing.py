"""A session's trajectory after the fact, from all its segments at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.filtering import Advance
from app.engine.inertial import gap_before
from app.engine.localization.climbing import changes_level
from app.engine.localization.integrity import Integrity, tell
from app.engine.localization.particle import ParticleTracker
from app.engine.localization.session import SessionState, Track
from app.engine.types import Fix, FixKind, Float32Array, Float64Array, MapSource, Prior, Segment, Status

SMOOTHING_PARTICLES = 6000


@dataclass(frozen=True, slots=True)
class _Step:
    """One step of the forward pass: positions before resampling, and where the next step's particles came from."""

    fix: Fix
    integrity: Integrity
    x: Float32Array
    y: Float32Array
    ancestors: NDArray[np.int32] | None


def smooth_session(
    tracker: ParticleTracker, prior: Prior, segments: Sequence[Segment], map_source: MapSource, *, seed: int
) -> tuple[Fix, ...]:
    """Smoothed fixes, one per step: positions that use the samples on both sides of their time.

    The genealogy of the particles is followed back from the end (Kitagawa 1996, doi:10.2307/1390750). Lines merge going
    back, so more particles are used than for tracking. After a gap between segments the filter draws its particles
    anew, so nothing is followed across it: each stretch between gaps is smoothed for itself. So it is after a change of
    level, where the place is searched anew, and where a track was found lost; of a lost stretch nothing is claimed, as
    nobody knows since when it was. Steps of a search that did not lead back to where it began keep their ``filtered``
    fix.
    """
    n = SMOOTHING_PARTICLES  # whatever tracking uses: half an hour of them takes 200 MB
    wide = ParticleTracker(
        replace(tracker.parameters, particles=n),  # one number throughout: lines must not break
        tracker.noise,
        tracker.spread,
        tracker.policy,
        tracker.search,
    )
    session = SessionState(prior, seed)
    fixes: list[Fix] = []
    stretch = _Stretch()
    for segment in segments:
        if _interrupts(session, segment, map_source):
            fixes += stretch.smooth(wide)
            stretch = _Stretch()
        searching, losses = session.quest is not None or session.pedestrian is None, session.losses
        stretch.walk(wide, session, segment, map_source)
        if session.losses > losses:  # the segment's steps are of the lost track, its last fix is of the search
            fixes += stretch.smooth(wide)
            stretch = _Stretch()
        elif searching and session.beginning is not None:
            stretch = stretch.retrace(wide, session, map_source)
    return (*fixes, *stretch.smooth(wide))


def _interrupts(session: SessionState, segment: Segment, map_source: MapSource) -> bool:
    """Whether particles are drawn anew: after a gap, or on another level."""
    if session.pedestrian is None:
        return False
    return gap_before(session.pedestrian, segment.samples) > 0.0 or changes_level(session, segment, map_source)


class _Stretch:
    """What lies between two gaps or changes of level: fixes of a search, if there was one, then steps of the filter."""

    def __init__(self) -> None:
        self.segments: list[Segment] = []
        self.searched: list[Fix] = []
        self.steps: list[_Step] = []
        self.weights: Float64Array = np.empty(0)
        self.track: Track | None = None

    def walk(self, tracker: ParticleTracker, session: SessionState, segment: Segment, map_source: MapSource) -> None:
        """Go on by one segment."""
        self.segments.append(segment)
        told, losses, followed = list[Fix](), session.losses, session.track
        for fix, moved in tracker.walk(session, segment, map_source):
            if moved is None:
                told.append(fix)
                continue
            followed = session.track
            if followed is not None:
                self.steps.append(_record(fix, moved, followed.integrity))
            self.weights = moved.weighted.p[14].astype(np.float64)
        self.searched += told[:-1]  # the last belongs to no step
        self.track = followed if session.losses > losses else session.track

    def retrace(self, tracker: ParticleTracker, session: SessionState, map_source: MapSource) -> _Stretch:
        """The same stretch from its beginning, now that the search has told where that was.

        ``session`` is left as if it had been tracked all the way.
        """
        track = session.beginning
        if track is None:
            return self
        track.cloud = track.cloud.thin(tracker.parameters.particles, 0.5)
        session.pedestrian, session.track, session.beginning = None, track, None
        again = _Stretch()
        for segment in self.segments:
            again.walk(tracker, session, segment, map_source)
        return again

    def smooth(self, tracker: ParticleTracker) -> tuple[Fix, ...]:
        """Fixes of the stretch; a search that led to a track found wrong later found nothing."""
        doubted = self.track is not None and self.track.integrity.doubted
        searched = map(_unclaimed, self.searched) if doubted else self.searched
        return (*searched, *_trace_back(tracker, self.steps, self.weights, self.track))


def _unclaimed(fix: Fix) -> Fix:
    return replace(fix, status=Status.AMBIGUOUS, sure=False) if fix.status is Status.OK else fix


def _record(fix: Fix, moved: Advance, integrity: Integrity) -> _Step:
    p = moved.weighted.p
    # As small as they come: half an hour has thousands of steps.
    ancestors = None if moved.ancestors is None else moved.ancestors.astype(np.int32)
    return _Step(fix, integrity, p[0].copy(), p[1].copy(), ancestors)


def _trace_back(
    tracker: ParticleTracker, steps: Sequence[_Step], weights: Float64Array, track: Track | None
) -> tuple[Fix, ...]:
    if not steps or track is None:
        return ()
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
            track.estimate,
            x=mx,
            y=my,
            cov_xx=float(weights @ (x - mx) ** 2),
            cov_xy=float(weights @ ((x - mx) * (y - my))),
            cov_yy=float(weights @ (y - my) ** 2),
            heading=step.fix.heading,
        )
        # what lay about the step then; that the place was found later, or lost, counts for all of them
        now = track.integrity
        integrity = replace(step.integrity, settled=now.settled, doubted=now.doubted, borne_out=now.borne_out)
        then = step.fix
        fixes.append(tell(then.t, then.level_id, estimate, integrity, tracker.policy, kind=FixKind.SMOOTHED))
    return tuple(reversed(fixes))
