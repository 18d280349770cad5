"""Suggested lines go where they teach most, and say why."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from app.engine.mapping import Covariance, FieldLevel, FieldSamples, krige
from app.engine.mapping.quality import ConflictView
from app.engine.mapping.suggestions import (
    NEEDS,
    OLD_S,
    Reason,
    Suggestion,
    correlation,
    one_direction,
    suggest_lines,
)
from app.engine.types import Evidence, EvidenceSource, Float64Array, GridMap, RouteLines, SourceKind
from tests.support.fields import field_map

FIELD_SD = (6.0, 6.0, 6.0)
SHAPE = (80, 120)  # 40 m by 60 m from (-10, -20) on


def level(sd: Float64Array | float, **changes: object) -> GridMap:
    grid = field_map(np.random.default_rng(1), shape=SHAPE)
    relative = np.broadcast_to(np.asarray(sd, np.float32), SHAPE)
    support = np.where(relative > 0.9, 8.0, 0.5).astype(np.float32)
    known: dict[str, object] = {"sd": np.stack([6.0 * relative] * 3).astype(np.float32), "support": support}
    return replace(grid, noise_sd=(3.0,) * 3, **{**known, **changes})


def on(grid: GridMap, mask: np.ndarray, one: Suggestion) -> float:
    """Share of a line on nodes of a mask."""
    t = np.linspace(0, 1, 50)[:, None]
    xy = np.array(one.start) + t * (np.array(one.end) - np.array(one.start))
    at = np.rint((xy - [grid.x0, grid.y0]) / grid.cell_m).astype(int)
    return float(mask[at[:, 1], at[:, 0]].mean())


def test_lines_go_where_nobody_walked() -> None:
    sd = np.full(SHAPE, 0.4)
    sd[:, 60:80] = 1.0
    grid = level(sd, obstacle=np.zeros(SHAPE, np.float32))
    plan = suggest_lines(grid, count=4, field_sd=FIELD_SD)
    assert len(plan.suggestions) == 4
    assert all(on(grid, sd > 0.9, one) > 0.7 for one in plan.suggestions[:3])
    assert plan.suggestions[0].reasons == (Reason.UNMAPPED,)
    assert plan.suggestions[0].words == NEEDS[Reason.UNMAPPED].words
    assert plan.after < plan.before


def test_walls_and_closed_rooms_are_left_alone() -> None:
    sd = np.full(SHAPE, 1.0)
    sd[30:40, :40] = 0.4
    obstacle = np.full(SHAPE, 3.0, np.float32)
    obstacle[30:40] = 0.0  # a corridor 5 m wide, its east not mapped
    obstacle[60:75, 60:100] = 0.0  # a room that nothing leads to
    grid = level(sd, obstacle=obstacle)
    plan = suggest_lines(grid, count=5, field_sd=FIELD_SD)
    assert plan.suggestions
    corridor = np.zeros(SHAPE, bool)
    corridor[30:40] = True
    assert all(on(grid, corridor, one) == 1.0 for one in plan.suggestions)


def test_chosen_lines_are_counted_in() -> None:
    grid = level(1.0, support=np.full(SHAPE, 0.5, np.float32))
    plan = suggest_lines(grid, count=6, field_sd=FIELD_SD)
    middles = np.array([np.add(one.start, one.end) / 2 for one in plan.suggestions])
    apart = np.hypot(*(middles[:, None] - middles[None]).T) + 100 * np.eye(len(middles))
    assert apart.min() > 3.0
    per_metre = [one.gain_m2 / (one.length_m + 10.0) for one in plan.suggestions]
    assert all(a >= b - 1e-9 for a, b in pairwise(per_metre))
    fewer = suggest_lines(grid, count=3, field_sd=FIELD_SD)
    assert fewer.suggestions == plan.suggestions[:3]


def test_a_map_without_doubt_needs_nothing() -> None:
    assert suggest_lines(level(0.0), field_sd=FIELD_SD).suggestions == ()


def test_the_promised_fall_of_variance_is_that_of_kriging() -> None:
    """A line on unknown ground, as promised and as kriging with readings along it finds."""
    covariance = Covariance()
    grid = level(1.0, support=np.full(SHAPE, 0.5, np.float32))
    plan = suggest_lines(grid, count=1, field_sd=FIELD_SD, covariance=covariance)
    (one,) = plan.suggestions
    t = np.linspace(0.0, 1.0, max(int(one.length_m / 0.35), 2))[:, None]
    xy = np.array(one.start) + t * (np.array(one.end) - np.array(one.start))
    samples = FieldSamples(xy, np.zeros(len(xy), int), np.zeros((len(xy), 1)))
    x, y = np.meshgrid(grid.x0 + np.arange(0, 60), grid.y0 + np.arange(0, 40))
    nodes = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    _, sd = krige(samples, FieldLevel(np.zeros(1), np.ones(1)), covariance, nodes, neighbours=48)
    fallen = float((1.0 - sd**2).sum())
    # one reading of the line stands for all: less than kriging gets from the many, but not by much
    assert one.gain_m2 == pytest.approx(fallen, rel=0.45)
    assert correlation(covariance, np.array([0.0]))[0] == 1.0


def evidence_of(*walks: tuple[Float64Array, float]) -> Evidence:
    grid = level(0.4)
    return Evidence.joined(
        [
            Evidence.of(grid.features, EvidenceSource(f"w{k}", SourceKind.SURVEY, t=t), xy, np.zeros((len(xy), 3)))
            for k, (xy, t) in enumerate(walks)
        ]
    )


def along(y: float, *, back: bool = False) -> Float64Array:
    x = np.arange(-9.0, 45.0, 0.35)
    return np.stack([x[::-1] if back else x, np.full(len(x), y)], axis=1)


def test_one_direction_only() -> None:
    grid = level(0.4)
    there, both = along(-10.0), along(5.0)
    alone = one_direction(grid, evidence_of((there, 0.0), (both, 0.0), (along(5.0, back=True), 0.0)))
    row = {y: round((y - grid.y0) / grid.cell_m) for y in (-10.0, 5.0, 15.0)}
    assert alone[row[-10.0], 10:100].all()
    assert not alone[row[5.0], 10:100].any()
    assert not alone[row[15.0]].any()


def test_directions_of_the_lines_kept_with_the_map() -> None:
    walks = [along(-10.0), along(5.0), along(5.0, back=True)]
    first = np.cumsum([0, *(len(w) for w in walks[:-1])]).astype(np.int32)
    grid = level(0.4, routes=RouteLines(np.concatenate(walks).astype(np.float32), first))
    expected = one_direction(grid, evidence_of(*((w, 0.0) for w in walks)))
    np.testing.assert_array_equal(one_direction(grid, None), expected)
    assert not one_direction(level(0.4), None).any()


@pytest.mark.parametrize("reason", [Reason.OLD, Reason.CONFLICT, Reason.ONE_DIRECTION])
def test_reasons(reason: Reason) -> None:
    """Two strips alike but for one reason: the first line goes there and names it."""
    sd = np.full(SHAPE, 0.6)
    obstacle = np.full(SHAPE, 3.0, np.float32)
    obstacle[17:24] = obstacle[47:54] = obstacle[:, :4] = 0.0
    grid = level(sd, obstacle=obstacle)
    now = 2e9
    t = now - 2 * OLD_S if reason is Reason.OLD else now
    walks = [(along(-10.0), t), (along(5.0), now), (along(5.0, back=True), now)]
    walks += [] if reason is Reason.ONE_DIRECTION else [(along(-10.0, back=True), t)]
    ratio = np.zeros((40, 60), np.float32)
    ratio[8:12] = 9.0 if reason is Reason.CONFLICT else 0.0
    view = ConflictView(-10.25, -20.25, 1.0, np.ones((40, 60), np.int32), ratio, np.full((40, 60), 3.0, np.float32))
    plan = suggest_lines(grid, count=1, field_sd=FIELD_SD, evidence=evidence_of(*walks), conflict=view, now=now)
    (one,) = plan.suggestions
    assert one.start[1] == pytest.approx(-10.0, abs=3.0)
    assert one.end[1] == pytest.approx(-10.0, abs=3.0)
    assert reason in one.reasons
