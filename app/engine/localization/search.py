"""Where in a level or a building a walk took place: all of its steps against all of the maps.

One reading says nothing, the shape of 20-40 m says much. The search therefore keeps the walk's steps, not particles,
and goes through them anew with each segment: particles start everywhere, in all directions, and are thinned as the
walk rules places out, coarse to fine. What is left are places with weights, on one level or several; a level's weight
is the likelihood of the whole walk on it.

The likelihood is sharper than the tracker's. A tracker that knows where it is must not be thrown off by a disturbance;
a search has every other place of the building to tell from the right one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.calibration import without_soft_iron
from app.engine.filtering import Cloud, Estimate, FilterGrid, Mode, ParticleNoise, find_modes, whole
from app.engine.inertial import StepEvents
from app.engine.localization.aids import Evidence, top, weigh_cloud
from app.engine.localization.initial import InitialSpread, initial_cloud
from app.engine.localization.motion import take_step
from app.engine.types import Float64Array, Prior

STANDS_OUT = 4.0
"""Log odds at which one place stands out."""


@dataclass(frozen=True, slots=True)
class SearchPolicy:
    """How a search goes about it, fitted on survey walks against maps that do not hold them.

    Attributes
    ----------
    noise : ParticleNoise
    thinning : tuple of (steps, share)
        After so many steps, this share of the first particles goes on.
    window : int
        Steps looked back on.
    least : int
        Particles a level begins with, however many levels share the number.
    merge_m : float
        Particles this near to each other are one place.
    """

    noise: ParticleNoise = field(default_factory=lambda: ParticleNoise(field=1.3, position=0.3))
    thinning: tuple[tuple[int, float], ...] = ((10, 0.5), (20, 0.25), (40, 0.12))
    window: int = 120
    least: int = 20_000
    merge_m: float = 6.0


@dataclass(frozen=True, slots=True)
class Place:
    """One place that fits: level, mode of the particles there (its weight is of all levels together)."""

    level_id: str
    mode: Mode


@dataclass(frozen=True, slots=True)
class Belief:
    """What a search thinks after one step.

    Attributes
    ----------
    places : tuple of Place
        Heaviest first.
    estimate : Estimate
        Of the heaviest level's particles.
    walk_on_m : float
        About how far to walk on until one place should stand out, from what the map tells per metre.
    start : Mode or None
        All of where the walk may have begun on that level, before any step; None where more than the field was heard.
    level_open : bool
        Whether several levels were searched by the field alone.
    """

    places: tuple[Place, ...]
    estimate: Estimate
    walk_on_m: float = 0.0
    start: Mode | None = None
    level_open: bool = False


@dataclass(frozen=True, slots=True)
class Found:
    """Outcome of a search.

    Attributes
    ----------
    beliefs : tuple of Belief
        One for each of the last steps that were asked for.
    level_id : str
        Level that weighs most.
    cloud : Cloud
        Its particles.
    start : Cloud
        Where these particles stood before the first step.
    log_likelihood : float
        Of the whole walk, over a start anywhere that the prior allows, all levels alike: comparable between searches of
        the same steps and evidence.
    """

    beliefs: tuple[Belief, ...]
    level_id: str
    cloud: Cloud
    start: Cloud
    log_likelihood: float


@dataclass(frozen=True, slots=True)
class _LevelRun:
    """A walk tried on one level: log likelihood, modes and estimate at each asked step, particles at the end and where
    these began, and where all began."""

    log_likelihood: Float64Array
    modes: tuple[tuple[Mode, ...], ...]
    estimates: tuple[Estimate, ...]
    cloud: Cloud
    start: Cloud
    began: Mode


def search(
    events: StepEvents,
    grids: Mapping[str, FilterGrid],
    prior: Prior,
    evidence: Sequence[Evidence] = (),
    *,
    particles: int,
    report: int,
    spread: InitialSpread,
    policy: SearchPolicy,
    rng: np.random.Generator,
) -> Found:
    """Search a walk on these levels.

    Parameters
    ----------
    events : StepEvents
        The walk, at least one step.
    grids : mapping from level id to FilterGrid
        At least one.
    prior : Prior
        Its disc and heading, if it has any, and the device's calibration.
    evidence : sequence of Evidence
        Beside the field, in time order.
    particles : int
        Number to begin with, over all levels.
    report : int
        Beliefs are given after each of the last ``report`` steps, at least one; fewer if the walk has fewer.
    """
    events = replace(events, mag=without_soft_iron(events.mag, prior.calibration))
    each = max(particles // len(grids), min(policy.least, particles))
    asked = max(len(events) - report, 0)
    level_ids = list(grids)
    aids = _Aids(evidence, events.t, level_ids)
    runs = {
        level_id: _run(events, level_id, grid, prior, aids, each, asked, spread, policy, rng)
        for level_id, grid in grids.items()
    }
    log_likelihood = np.stack([runs[level_id].log_likelihood for level_id in level_ids])
    shares = np.exp(log_likelihood - log_likelihood.max(axis=0))
    whole = float(log_likelihood[:, -1].max() + np.log(shares[:, -1].mean())) + aids.log_unit
    shares /= shares.sum(axis=0)
    rate = min(information_per_m(grid, policy.noise) for grid in grids.values())
    tried = [runs[level_id] for level_id in level_ids]
    beliefs = tuple(
        _belief(level_ids, tried, shares[:, k], k, rate, alone=not evidence) for k in range(shares.shape[1])
    )
    best = level_ids[int(shares[:, -1].argmax())]
    return Found(beliefs, best, runs[best].cloud, runs[best].start, whole)


class _Aids:
    """Evidence by the step before which it was seen, in the unit of the most it gives any place.

    ``log_unit`` is the product of all units that count.
    """

    def __init__(self, evidence: Sequence[Evidence], t: Float64Array, level_ids: Sequence[str]) -> None:
        self._at: dict[int, list[tuple[Evidence, float]]] = {}
        self.log_unit = 0.0
        for piece in evidence:
            step, unit = int(np.searchsorted(t, piece.t)), top(piece, level_ids)
            self._at.setdefault(step, []).append((piece, unit))
            self.log_unit += unit if step < len(t) else 0.0

    def weigh(self, cloud: Cloud, level_id: str, step: int) -> None:
        """Weigh particles on a level with what was seen since the step before."""
        for piece, log_unit in self._at.get(step, ()):
            weigh_cloud(cloud, piece, level_id, log_unit=log_unit)


def _run(
    events: StepEvents,
    level_id: str,
    grid: FilterGrid,
    prior: Prior,
    aids: _Aids,
    n: int,
    asked: int,
    spread: InitialSpread,
    policy: SearchPolicy,
    rng: np.random.Generator,
) -> _LevelRun:
    cloud = initial_cloud(prior, grid, events.mag[0], n, spread, rng)
    start, origin = Cloud(cloud.p.copy()), np.arange(cloud.n)
    began = whole(cloud)
    thinning = dict(policy.thinning)
    heading = float(events.heading[0])
    total, log_likelihood, modes, estimates = 0.0, [], [], []
    for i in range(len(events)):
        if i in thinning:
            index = cloud.draw(max(int(thinning[i] * n), 100), float(rng.random()))
            cloud, origin = cloud.take(index), origin[index]
        aids.weigh(cloud, level_id, i)
        moved = take_step(cloud, grid, policy.noise, spread, events, i, heading, rng)
        cloud, heading = moved.cloud, float(events.heading[i])
        origin = origin if moved.ancestors is None else origin[moved.ancestors]
        total += float(np.log(max(moved.estimate.likelihood, 1e-300)))
        if i >= asked:
            log_likelihood.append(total)
            modes.append(find_modes(moved.weighted, radius_m=policy.merge_m))
            estimates.append(moved.estimate)
    return _LevelRun(np.array(log_likelihood), tuple(modes), tuple(estimates), cloud, start.take(origin), began)


def _belief(
    level_ids: list[str], runs: list[_LevelRun], shares: Float64Array, k: int, rate: float, *, alone: bool
) -> Belief:
    places = [
        Place(level_id, mode.weighted(share))
        for level_id, run, share in zip(level_ids, runs, shares.tolist(), strict=True)
        for mode in run.modes[k]
    ]
    places.sort(key=lambda place: -place.mode.weight)
    first = min(max(places[0].mode.weight, 1e-4), 1.0 - 1e-4)
    missing = STANDS_OUT - float(np.log(first / (1.0 - first)))
    best = runs[int(shares.argmax())]
    return Belief(
        tuple(places),
        best.estimates[k],
        max(missing, 0.0) / rate,
        start=best.began if alone else None,
        level_open=alone and len(level_ids) > 1,
    )


def information_per_m(grid: FilterGrid, noise: ParticleNoise) -> float:
    """What a metre of walk tells about the place, nats: half the log of signal over noise, per independent reading.

    Signal is the map's own variation over surveyed ground, noise what a reading differs from the map by; readings count
    as independent every two correlation lengths.
    """
    mapped = grid.nodes[..., 5] > 0.5
    nodes = grid.nodes[mapped] if mapped.any() else grid.nodes.reshape(-1, grid.nodes.shape[-1])
    nats = 0.0
    for channel, variance in ((0, 3), (1, 3), (2, 4)):
        sd = grid.noise_sd[0 if channel < 2 else 1]
        signal = float(nodes[:, channel].var(dtype=np.float64))
        nats += 0.5 * float(np.log1p(signal / ((noise.field * sd) ** 2 + float(nodes[:, variance].mean()))))
    return max(nats / (2.0 * noise.correlation_m), 0.01)
