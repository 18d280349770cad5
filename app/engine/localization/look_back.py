"""Fixed-lag fixes: steps told once more, some seconds later, with the evidence that came after them.

Which of a step's particles were right is known better later, by which of them have descendants and how heavy these are.
The weighted mean and covariance over the particles of now, each where its line was at the step, is the fixed-lag
estimate (Kitagawa 1996, doi:10.2307/1390750: his smoother keeps the last steps of each particle and resamples them with
it). Lines merge going back, so the lag is short; a whole trip is smoothed with more particles
(:mod:`app.engine.localization.smoothing`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from app.engine.filtering import Advance, Cloud
from app.engine.localization.integrity import IntegrityPolicy, tell
from app.engine.localization.lines import OpenStep
from app.engine.localization.session import Track
from app.engine.types import Fix, FixKind

LAG_S = 5.0
"""Seconds that are waited for evidence about a step."""


class LookBack:
    """Keeps the lines of a track's particles while it goes on, and tells its steps once they are old enough.

    Each step is told at the first moment (a later step, or the end of a segment) that lies ``LAG_S`` or more after it,
    with what is known at that moment; so it does not matter much how a recording is cut into segments. Where particles
    are drawn anew (a gap, another level, a search) lines end, and nothing that comes later says anything of the steps
    before: those still open are told at once, with what was known until then. Steps of a search are not told, they have
    no lines; nor are the last ones of a session, which stay open.

    Attributes
    ----------
    steps : tuple of OpenStep
        Not told yet, oldest first.
    """

    def __init__(self, steps: Sequence[OpenStep], track: Track | None, policy: IntegrityPolicy) -> None:
        self.steps = tuple(steps)
        self._track, self._policy = track, policy

    def take(self, track: Track | None, fix: Fix, moved: Advance | None) -> tuple[Fix, ...]:
        """Go on by a fix and, if it is a step's, by what the filter did; what is now told of the steps before.

        ``track`` is the session's at that moment, None while it is searched.
        """
        ended: tuple[Fix, ...] = ()
        if track is not self._track:
            if self._track is not None:
                ended = self._tell(math.inf, self._track, self._track.cloud)
            self._track = track
        if track is None:
            return ended
        if moved is None:
            return ended + self._tell(fix.t - LAG_S, track, track.cloud)
        self.steps += (OpenStep.of(fix, track.integrity, moved.weighted),)
        told = self._tell(fix.t - LAG_S, track, moved.weighted)  # resampling adds nothing but noise: before it
        if moved.ancestors is not None:
            for step in self.steps:
                step.resample(moved.ancestors)
        return ended + told

    def _tell(self, until: float, track: Track, particles: Cloud) -> tuple[Fix, ...]:
        """Tell the steps up to the time ``until``, which are then no longer open."""
        n = sum(step.t <= until for step in self.steps)
        told, self.steps = self.steps[:n], self.steps[n:]
        return tuple(self._fix(step, track, particles) for step in told)

    def _fix(self, step: OpenStep, track: Track, particles: Cloud) -> Fix:
        # what lay about the step then; that the place was found, borne out or lost since counts for it
        now = track.integrity
        settled = step.integrity.settled or now.settled
        integrity = replace(step.integrity, settled=settled, doubted=now.doubted, borne_out=now.borne_out)
        estimate = step.estimate(particles.p[14])
        return tell(step.t, step.level_id, estimate, integrity, self._policy, kind=FixKind.FIXED_LAG)
