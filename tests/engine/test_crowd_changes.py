"""Changes of the field that stay: found, dated, and nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.crowd import TrustPolicy, Weighed, weigh
from app.engine.types import Float64Array, SourceKind
from tests.support.crowd import DAY_S, Level, joined

SEEDS = (20, 21, 22)
PASSES = 5
DELTA = np.array([12.0, -9.0, 0.0])
"""15 uT"""


def lanes(level: Level, n: int) -> list[Float64Array]:
    """Ways across the area that changes."""
    return [level.lane(level.rng.uniform(5.3, 9.7)) for _ in range(n)]


def with_change(seed: int, passes: int = PASSES) -> tuple[Level, Weighed]:
    """A level where 15 uT came to a 5 x 5 m area on the second day, and passes by independent walkers since."""
    level = Level.random(seed)
    before = joined(level.survey(), level.traffic(10))
    level.changed_t, level.change = 2 * DAY_S, DELTA
    after = [
        level.session(f"new{k}", f"walker{k}", 2 * DAY_S + 3600.0 * (k + 1), way)
        for k, way in enumerate(lanes(level, passes))
    ]
    return level, weigh(joined(before, after), model=level.model)


def beyond(level: Level, xy: Float64Array) -> Float64Array:
    """Distance of places from the area, m."""
    x0, y0, x1, y1 = level.area
    return np.maximum.reduce([x0 - xy[:, 0], xy[:, 0] - x1, y0 - xy[:, 1], xy[:, 1] - y1, np.zeros(len(xy))])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_change_is_found_after_five_passes_and_dated(seed: int) -> None:
    level, weighed = with_change(seed)
    assert len(weighed.changes) == 1
    event = weighed.changes[0]
    assert event.after_t <= 2 * DAY_S + 3600.0 * 2
    assert event.before_t >= 2 * DAY_S
    np.testing.assert_allclose(event.delta, DELTA, atol=4.0)
    assert 3 <= event.witnesses <= PASSES
    assert np.mean(level.inside(np.array(event.cells))) > 0.7


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_else_moves(seed: int) -> None:
    level, weighed = with_change(seed)
    cells = np.array([cell for event in weighed.changes for cell in event.cells])
    assert beyond(level, cells).max() <= 1.0  # a cell that straddles the edge, or a walk that was placed beside it
    evidence = weighed.evidence
    session = np.array([source.t >= DAY_S for source in evidence.sources])[evidence.source]
    gone = ~session & (evidence.weight == 0.0)
    assert gone.any()
    assert beyond(level, evidence.xy[gone].astype(float)).max() <= 1.5
    new = np.array([source.id.startswith("new") for source in evidence.sources])[evidence.source]
    assert evidence.weight[new & level.inside(evidence.xy.astype(float))].mean() > 0.5


def test_two_passes_are_not_enough() -> None:
    _, weighed = with_change(20, passes=2)
    assert not weighed.changes


def test_one_contributor_is_not_enough() -> None:
    level = Level.random(21)
    before = joined(level.survey(), level.traffic(10))
    level.changed_t, level.change = 2 * DAY_S, DELTA
    after = [
        level.session(f"new{k}", "one", 2 * DAY_S + 3600.0 * (k + 1), way) for k, way in enumerate(lanes(level, 8))
    ]
    weighed = weigh(joined(before, after), model=level.model)
    assert not weighed.changes
    assert all(weighed.evidence.weight[weighed.evidence.source < 10] == 1.0)  # the survey stands


def test_who_goes_on_reading_the_old_field_refutes_a_change() -> None:
    level = Level.random(22)
    before = joined(level.survey(), level.traffic(10))
    disagreeing, agreeing = [], []
    for k, way in enumerate(lanes(level, 5)):
        t = 2 * DAY_S + 3600.0 * (k + 1)
        level.changed_t, level.change = 2 * DAY_S, DELTA
        disagreeing.append(level.session(f"new{k}", f"walker{k}", t, way))
        level.changed_t = np.inf
        agreeing.append(level.session(f"old{k}", f"other{k}", t + 60.0, way))
    assert not weigh(joined(before, disagreeing, agreeing), model=level.model).changes
    assert weigh(joined(before, disagreeing), model=level.model).changes


def test_without_looking_for_changes_the_old_field_stays() -> None:
    level = Level.random(20)
    before = joined(level.survey(), level.traffic(10))
    level.changed_t, level.change = 2 * DAY_S, DELTA
    after = [level.session(f"new{k}", f"w{k}", 2 * DAY_S + 3600.0 * k, way) for k, way in enumerate(lanes(level, 5))]
    weighed = weigh(joined(before, after), TrustPolicy(change=None), model=level.model)
    assert not weighed.changes
    assert not (weighed.evidence.weight[weighed.evidence.source < 10] == 0.0).any()


def test_no_change_is_seen_where_there_is_none() -> None:
    for seed in range(40, 43):
        level = Level.random(seed)
        assert not weigh(joined(level.survey(3.0), level.traffic(24)), model=level.model).changes


def test_a_field_may_change_twice() -> None:
    level = Level.random(23)
    parts = [level.survey(), *level.traffic(10)]
    for day, change in ((2, DELTA), (4, -DELTA)):
        level.changed_t, level.change = day * DAY_S, change
        parts += [
            level.session(f"d{day}-{k}", f"w{day}-{k}", day * DAY_S + 3600.0 * (k + 1), way)
            for k, way in enumerate(lanes(level, 6))
        ]
    weighed = weigh(joined(parts), model=level.model)
    assert len(weighed.changes) >= 2
    newest = np.array([source.id.startswith("d4") for source in weighed.evidence.sources])[weighed.evidence.source]
    inside = level.inside(weighed.evidence.xy.astype(float))
    assert weighed.evidence.weight[newest & inside].mean() > 0.5
    assert weighed.evidence.weight[~newest & inside].mean() < 0.2


def test_surveys_alone_show_no_change() -> None:
    """Walks of a survey that contradict one another have wrong labels, as a rule."""
    level, weighed = with_change(SEEDS[0])
    assert weighed.changes
    sources = tuple(
        replace(s, kind=SourceKind.SURVEY) if s.id.startswith("new") else s for s in weighed.evidence.sources
    )
    surveyed = weigh(replace(weighed.evidence, sources=sources), model=level.model)
    assert surveyed.changes == ()
