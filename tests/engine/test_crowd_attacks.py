"""Hostile contributors beside honest traffic: the map stays, and without the defence it would not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping import krige
from app.engine.mapping.crowd import Reason, TrustPolicy, Weighed, weigh
from app.engine.mapping.model import field_samples
from app.engine.types import Evidence, Float64Array
from tests.support.crowd import DAY_S, Level, joined, tampered

HONEST, HOSTILE = 45, 5
NODES = np.stack(np.meshgrid(np.arange(1.0, 29.0, 1.5), np.arange(1.0, 19.0, 1.5)), axis=-1).reshape(-1, 2)
DEFENCELESS = TrustPolicy(agreement=False, physics=None, change=None)
"""All that comes is used."""


def field_of(weighed: Weighed, level: Level) -> Float64Array:
    """The map at ``NODES``."""
    model = level.model
    samples = field_samples(weighed.evidence, model)
    return krige(samples, model.level, model.covariance, NODES, neighbours=48)[0]


def moved(a: Float64Array, b: Float64Array) -> float:
    """Difference of two maps, rms of the vector, uT."""
    return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))


def every_few_hours(i: int) -> float:
    return DAY_S + 5400.0 * i


def constant_offset(level: Level) -> list[Evidence]:
    """One key, always the same offset."""
    return [
        tampered(level.session(f"x{i}", "mallory", every_few_hours(i)), lambda _xy, v: v + np.array([15.0, 0.0, 10.0]))
        for i in range(HOSTILE)
    ]


def copied_walk(level: Level) -> list[Evidence]:
    """Honest readings, told of another place; each from another key."""
    walks = []
    for i in range(HOSTILE):
        read, told = level.wander(), level.wander()
        n = min(len(read), len(told))
        walk = level.session(f"x{i}", f"mallory{i}", every_few_hours(i), read[:n])
        walks.append(replace(walk, xy=told[:n].astype(np.float32)))
    return walks


def slow_drift(level: Level) -> list[Evidence]:
    """One key, with each walk a little more of an offset: it tries to take the map along."""
    return [
        tampered(
            level.session(f"x{i}", "mallory", every_few_hours(i)), lambda _xy, v, i=i: v + np.array([0.0, 6.0 * i, 0.0])
        )
        for i in range(HOSTILE)
    ]


def sybils(level: Level) -> list[Evidence]:
    """As many keys as walks, all with one and the same invented anomaly, honest where there is none."""

    def with_anomaly(xy: Float64Array, values: Float64Array) -> Float64Array:
        bump = np.exp(-0.5 * ((xy - [15.0, 10.0]) ** 2).sum(axis=1) / 5.0**2)
        return values + 40.0 * bump[:, None] * np.array([1.0, 0.0, 0.0])

    return [tampered(level.session(f"x{i}", f"mallory{i}", every_few_hours(i)), with_anomaly) for i in range(HOSTILE)]


ATTACKS = [constant_offset, copied_walk, slow_drift, sybils]


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_tenth_of_hostile_walks_moves_the_map_by_less_than_a_microtesla(
    attack: Callable[[Level], list[Evidence]],
) -> None:
    level = Level.random(7)
    honest = joined(level.survey(3.0), level.traffic(HONEST))
    hostile = attack(level)
    clean = field_of(weigh(honest, model=level.model), level)
    defended = field_of(weigh(joined(honest, hostile), model=level.model), level)
    defenceless = field_of(weigh(joined(honest, hostile), DEFENCELESS, model=level.model), level)
    assert moved(defended, clean) < 1.0
    assert moved(defenceless, clean) > 1.0
    assert moved(defended, clean) < 0.5 * moved(defenceless, clean)


def test_no_honest_walk_is_turned_away_for_the_hostile_ones() -> None:
    level = Level.random(8)
    hostile = [walk for attack in (constant_offset, sybils) for walk in attack(level)[:3]]
    weighed = weigh(joined(level.survey(3.0), level.traffic(HONEST), _renamed(hostile)), model=level.model)
    honest = [verdict for verdict in weighed.verdicts if not verdict.source_id.startswith("h")]
    assert sum(verdict.reason is not None for verdict in honest) <= 1
    assert not weighed.changes


def _renamed(walks: list[Evidence]) -> list[Evidence]:
    return [replace(w, sources=(replace(w.sources[0], id=f"h{i}"),)) for i, w in enumerate(walks)]


def test_sybils_invent_no_change_while_honest_people_pass() -> None:
    level = Level.random(9)
    late = [replace(w, sources=(replace(w.sources[0], t=DAY_S + 20_000.0 + i),)) for i, w in enumerate(sybils(level))]
    weighed = weigh(joined(level.survey(3.0), level.traffic(HONEST), late), model=level.model)
    assert not weighed.changes


def test_verdicts_say_why() -> None:
    level = Level.random(7)
    honest = joined(level.survey(3.0), level.traffic(12))
    offset = constant_offset(level)[0]
    small = tampered(level.session("small", "trent", DAY_S), lambda _xy, v: v + np.array([6.0, 0.0, 0.0]))
    verdicts = {v.source_id: v for v in weigh(joined(honest, offset, small), model=level.model).verdicts}
    assert verdicts["x0"].reason is Reason.CONTRADICTED
    assert verdicts["small"].reason is Reason.BIASED
    assert verdicts["small"].bias[0] == pytest.approx(6.0, abs=2.0)
    assert Reason.BIASED.words


def test_taking_a_contributor_out_undoes_what_he_did() -> None:
    level = Level.random(10)
    honest = joined(level.survey(3.0), level.traffic(12))
    hostile = sybils(level)
    ids = [walk.sources[0].id for walk in hostile]
    without = weigh(joined(honest, hostile).without(ids), model=level.model)
    np.testing.assert_array_equal(without.evidence.weight, weigh(honest, model=level.model).evidence.weight)


def test_a_bad_name_is_enough() -> None:
    level = Level.random(11)
    evidence = joined(level.survey(3.0), level.traffic(6))
    known = weigh(evidence, model=level.model, reputation={"user3": 0.05})
    assert {v.contributor for v in known.verdicts if v.reason is Reason.REPUTATION} == {"user3"}
    assert known.reputation["user3"] < 0.5 < known.reputation["user1"] <= TrustPolicy().reputation_cap
