"""Whether a session that is tracked is where it is tracked.

A prior may name the wrong door, particles may slip into the corridor beside, and a tracker keeps what it has: none of
its particles is where the walker is. So the newest steps are kept (:mod:`app.engine.localization.trail`), and a running
measure tells how badly the tracked particles explain the field. Where it is bad, two explanations of the kept steps are
weighed against each other with the search's likelihood: that the walk began where it was tracked then *and* ended where
it is tracked now, or that it took place elsewhere. The second one has the whole map to begin on, and so pays for each
place it does not end at: a good fit by chance somewhere is expected among so many places, and does not count as more
(the Bayes factor's own Occam factor; Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, section 3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.engine.filtering import Estimate, FilterGrid, ParticleNoise
from app.engine.inertial import StepEvents
from app.engine.localization.aids import Evidence, Sighting
from app.engine.localization.initial import InitialSpread
from app.engine.localization.integrity import spread
from app.engine.localization.search import Found, SearchPolicy, search
from app.engine.localization.session import Quest, SessionState, Track
from app.engine.localization.trail import Trail
from app.engine.types import DeviceCalibration, FeatureSet, Prior

_NONE = 1e-12
_CHANNELS = {FeatureSet.VECTOR: (2, 1), FeatureSet.HV: (1, 1), FeatureSet.TOTAL: (0, 1)}
"""How many channels have the horizontal variance, how many the vertical one."""


@dataclass(frozen=True, slots=True)
class LostPolicy:
    """When a track is checked and when it is lost; fitted on survey walks with true and with wrong priors.

    Attributes
    ----------
    memory_m : float, m
        Over which the misfit is smoothed.
    misfit : float, nats per step
        From here on the track is checked.
    radio : float
        What a scan (or a satellite fix) adds to the misfit, per nat by which the particles explain it worse than the
        best place.
    least : int
        Steps that a check needs.
    pause : int
        Steps between two checks, doubled by each one that finds nothing, up to four times.
    particles, first_particles, cold_particles : int
        Particles on the tracked place, and on all there is: at first, and where these leave it open. The first are too
        few to find every place with; a place that they miss leaves the track as it is.
    open : float, nats
        Log odds of elsewhere, beyond the slack, from which on it is open.
    start_m : float, m
        The walk began within this radius and two spreads of where it was tracked.
    near_m : float, m
        It ended there if it ended within this radius and two spreads.
    slack : float, nats per step
        By which elsewhere may fit better all the same: what the map errs by, and the walker, is alike along a walk,
        so that likelihoods differ by more than the search's noise says.
    borne_out : float, nats
        Log odds of elsewhere, beyond the slack, up to which a check bears the track out.
    doubted : float, nats
        Log odds of elsewhere, beyond the slack, from which on nothing is claimed.
    lost : float, nats
        Log odds of elsewhere, beyond the slack, from which on the track is given up.
    seen : float
        Share of mapped ground under the kept steps from which on a track is checked.
    known : float
        Share of mapped ground below which a track is only given up by greater odds: how well unmapped ground explains
        a reading rests on the variogram alone.
    unknown : float, nats
        By how much greater, per share of mapped ground that is missing.
    """

    memory_m: float = 10.0
    misfit: float = 0.3
    radio: float = 0.1
    least: int = 16
    pause: int = 15
    particles: int = 3000
    first_particles: int = 20_000
    cold_particles: int = 80_000
    open: float = -3.0
    start_m: float = 3.0
    near_m: float = 5.0
    slack: float = 0.1
    borne_out: float = -1.0
    doubted: float = 1.5
    lost: float = 7.0
    seen: float = 0.35
    known: float = 0.7
    unknown: float = 50.0


class Watch:
    """Watches a track through the steps of a segment."""

    def __init__(self, track: Track, grid: FilterGrid, noise: ParticleNoise, policy: LostPolicy) -> None:
        self._grid, self._noise, self._policy = grid, noise, policy
        self._misfit = track.trail.misfit
        self._places: list[tuple[float, float, float, float]] = []

    @property
    def misfit(self) -> float:
        """By how much readings are less likely than a good fit makes them, smoothed, nats per step."""
        return self._misfit

    def before(self, estimate: Estimate) -> None:
        """Take the estimate from which a step is about to be made."""
        self._places.append((estimate.x, estimate.y, spread(estimate), estimate.mapped))

    def after(self, estimate: Estimate, events: StepEvents, i: int) -> None:
        """Take the estimate that step ``i`` has led to."""
        if events.disturbed[i] or estimate.mapped < 0.5:
            return
        stride = float(events.stride[i])
        keep = math.exp(-stride / self._policy.memory_m)
        self._misfit = keep * self._misfit + (1.0 - keep) * misfit(estimate, self._grid, self._noise, stride)

    def heard(self, lack: float | None) -> bool:
        """Take by how much a sighting is explained worse than at the best place, if it tells anything; whether so."""
        self._misfit += 0.0 if lack is None else self._policy.radio * lack
        return lack is not None

    def keep(self, track: Track, events: StepEvents, seen: Sequence[Sighting], *, away: bool) -> None:
        """Leave the segment's steps and sightings with the track; on another level they are no evidence, nor is what
        came before."""
        kept = track.trail.walked(events, self._places, self._misfit).heard(seen)
        track.trail = Trail() if away else kept


def misfit(estimate: Estimate, grid: FilterGrid, noise: ParticleNoise, stride: float) -> float:
    """What a step's likelihood lacks of that of a reading right on the map, nats.

    The likelihood of a reading depends on how well the ground is surveyed: its logarithm is compared with that of the
    density's peak, from the variance of the whitened residual at the estimate (see the kernel's ``whitening``).
    """
    rows, columns, _ = grid.nodes.shape
    row = min(max(round((estimate.y - grid.y0) / grid.cell_m), 0), rows - 1)
    column = min(max(round((estimate.x - grid.x0) / grid.cell_m), 0), columns - 1)
    rho_map, rho_noise = (math.exp(-max(stride, 0.01) / m) for m in (noise.map_correlation_m, noise.correlation_m))
    log_peak = 0.0
    for layer, sd, channels in zip((3, 4), grid.noise_sd, _CHANNELS[grid.features], strict=True):
        variance, noise_var = float(grid.nodes[row, column, layer]), (noise.field * sd) ** 2
        total = variance + noise_var
        rho = (variance * rho_map + noise_var * rho_noise) / total
        log_peak -= 0.5 * channels * math.log(total * (1.0 - rho * rho))
    return log_peak - math.log(max(estimate.likelihood, 1e-30))


def suspected(track: Track, policy: LostPolicy) -> bool:
    """Whether the track is to be checked now: it explains the field badly, or has not been borne out yet."""
    trail = track.trail
    ready = len(trail.events) >= policy.least and trail.waiting == 0 and trail.mapped >= policy.seen
    return ready and (trail.misfit > policy.misfit or track.integrity.doubted or not track.integrity.borne_out)


@dataclass(frozen=True, slots=True)
class Check:
    """How a track's place is weighed against all others on ``grids``."""

    grids: Mapping[str, FilterGrid]
    evidence: Sequence[Evidence]
    spread: InitialSpread
    search: SearchPolicy
    policy: LostPolicy

    def log_odds(self, track: Track, calibration: DeviceCalibration | None, rng: np.random.Generator) -> float:
        """Log odds that the kept steps took place elsewhere, before what is thought of it beforehand.

        ``calibration`` is what was known of the device before the track: what a lost track has learned is wrong.
        """
        x, y, sd, _ = track.trail.places[0].tolist()
        begin = Prior(track.level_id, x, y, self.policy.start_m + 2.0 * sd, calibration=calibration)
        here = self._search(track, {track.level_id: self.grids[track.level_id]}, begin, self.policy.particles, rng)
        still = self._near(track, here)
        as_tracked = here.log_likelihood + math.log(max(still, _NONE))
        odds = here.log_likelihood + math.log(max(1.0 - still, _NONE)) - as_tracked  # of having slipped
        anywhere = Prior(None, calibration=calibration)
        for particles in (self.policy.first_particles, self.policy.cold_particles):
            there = self._search(track, self.grids, anywhere, particles, rng)
            elsewhere = there.log_likelihood + math.log(max(1.0 - self._near(track, there), _NONE))
            odds = max(odds, elsewhere - as_tracked)
            if not self.policy.open < beyond(odds, track, self.policy) < self.policy.lost:
                break
        return odds

    def _search(
        self, track: Track, grids: Mapping[str, FilterGrid], prior: Prior, particles: int, rng: np.random.Generator
    ) -> Found:
        return search(
            track.trail.events,
            grids,
            prior,
            self.evidence,
            particles=particles,
            report=1,
            spread=self.spread,
            policy=self.search,
            rng=rng,
        )

    def _near(self, track: Track, found: Found) -> float:
        """Share of a search's particles that end where the track is now."""
        if found.level_id != track.level_id:
            return 0.0
        p, e = found.cloud.p, track.estimate
        near = np.hypot(p[0] - e.x, p[1] - e.y) <= self.policy.near_m + 2.0 * spread(e)
        return float(p[14][near].sum(dtype=np.float64) / p[14].sum(dtype=np.float64))


def beyond(log_odds: float, track: Track, policy: LostPolicy) -> float:
    """Log odds beyond the slack of the kept steps."""
    return log_odds - policy.slack * len(track.trail.events)


def convict(track: Track, log_odds: float, policy: LostPolicy) -> bool:
    """What follows from the odds of a check: whether the track is lost, else what it may claim and when to check it
    again. Odds that leave it open change nothing for a track that was borne out, and do not clear one of a doubt."""
    odds = beyond(log_odds, track, policy)
    if odds > policy.lost + policy.unknown * max(policy.known - track.trail.mapped, 0.0):
        return True
    doubted = odds > policy.doubted
    pause = policy.pause if doubted else min(max(2 * track.trail.pause, policy.pause), 4 * policy.pause)
    track.trail = replace(track.trail, waiting=pause, pause=pause)
    borne_out = not doubted and (track.integrity.borne_out or odds < policy.borne_out)
    track.integrity = replace(track.integrity, doubted=doubted, borne_out=borne_out)
    return False


def give_up(session: SessionState, track: Track) -> Quest:
    """From a lost track to a quest that knows its newest steps, and of the device what was known before.

    The track is left doubted: what is told of its steps later on claims nothing.
    """
    track.integrity = replace(track.integrity, doubted=True)
    prior = Prior(session.prior.level_id, calibration=session.prior.calibration)
    quest = Quest(prior, track.trail.events, whole=False, sightings=track.trail.sightings)
    session.track, session.quest, session.losses = None, quest, session.losses + 1
    return quest
