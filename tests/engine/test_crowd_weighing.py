"""What rows count for: the policy's table, agreement, physics, bounds."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.crowd import (
    TABLE,
    Action,
    CellState,
    Finding,
    Omission,
    Reason,
    ReductionPolicy,
    TrustPolicy,
    Weighed,
    reduce,
    weigh,
)
from app.engine.mapping.crowd.agreement import compare
from app.engine.mapping.crowd.passes import gather, witnesses
from app.engine.types import Evidence, EvidenceSource, FeatureSet, SourceKind
from tests.reference.crowd import naive_compare
from tests.support.crowd import DAY_S, Level, joined, tampered


def weights(weighed: Weighed, source_id: str) -> np.ndarray:
    """Weights of one source's rows."""
    evidence = weighed.evidence
    index = next(i for i, source in enumerate(evidence.sources) if source.id == source_id)
    return evidence.weight[evidence.source == index]


def test_the_table_knows_every_case_and_uses_every_action() -> None:
    assert set(TABLE) == set(itertools.product(CellState, Finding))
    assert set(TABLE.values()) == set(Action)


def test_the_documents_show_the_table() -> None:
    text = Path("docs/crowd.md").read_text()
    for (state, finding), action in TABLE.items():
        assert f"| {state.value} | {finding.value} | {action.value} |" in text
    for reason in Reason:
        assert f"`{reason.value}`" in text
    for omission in Omission:
        assert f"`{omission.value}`" in text


def test_an_honest_walk_over_mapped_ground_counts() -> None:
    level = Level.random(30)
    weighed = weigh(joined(level.survey(), level.session("s", "ann", DAY_S)), model=level.model)
    assert weighed.verdicts[0].action is Action.CONFIRM
    assert weights(weighed, "s").mean() > 0.7
    survey = np.array([s.kind is SourceKind.SURVEY for s in weighed.evidence.sources])[weighed.evidence.source]
    assert (weighed.evidence.weight[survey] == 1.0).all()


def test_unmapped_ground_waits_for_a_second_contributor() -> None:
    level = Level.random(31)
    way = level.lane(10.0)
    first, own = level.session("a1", "ann", DAY_S, way), level.session("a2", "ann", 2 * DAY_S, way)
    alone = weigh(joined(first, own), model=level.model)
    assert alone.evidence.weight.max() == 0.0
    assert {v.reason for v in alone.verdicts} == {Reason.ALONE}
    both = weigh(joined(first, own, level.session("b", "bob", 3 * DAY_S, way)), model=level.model)
    assert all(weights(both, name).mean() > 0.2 for name in ("a1", "a2", "b"))
    assert both.verdicts[2].action is Action.NEW


def test_walks_of_one_contributor_over_one_cell_count_as_one() -> None:
    level = Level.random(32)
    way = level.lane(10.5)  # in the middle of cells
    survey = level.survey()
    one = weigh(joined(survey, level.session("a0", "ann", DAY_S, way, 0.1)), model=level.model)
    many = [level.session(f"a{i}", "ann", DAY_S + i, way, 0.1) for i in range(6)]
    six = weigh(joined(survey, many), model=level.model)
    total = sum(weights(six, f"a{i}").sum() for i in range(6))
    assert total == pytest.approx(weights(one, "a0").sum(), rel=0.35)


def test_devices_and_nameless_sessions_are_one_witness() -> None:
    def source(name: str, who: str, device: str = "", kind: SourceKind = SourceKind.SESSION) -> EvidenceSource:
        return EvidenceSource(name, kind, who, device)

    index = witnesses(
        (
            source("1", "ann", "phone"), source("2", "bob", "phone"), source("3", "cid"), source("4", ""),
            source("5", ""), source("6", "", kind=SourceKind.SURVEY), source("7", "", kind=SourceKind.SURVEY),
        )
    )  # fmt: skip
    assert index[0] == index[1]
    assert index[3] == index[4]
    assert len(set(index.tolist())) == 5


def test_order_does_not_matter() -> None:
    level = Level.random(33)
    evidence = joined(level.survey(3.0), level.traffic(12))
    order = np.argsort(-evidence.source, kind="stable")  # sources the other way round, rows of each in their order
    straight = weigh(evidence, model=level.model).evidence.weight
    turned = weigh(evidence.subset(order), model=level.model).evidence.weight
    np.testing.assert_allclose(turned, straight[order], atol=1e-5)


def test_comparison_is_that_of_its_slow_twin() -> None:
    level = Level.random(34)
    evidence = joined(level.survey(4.0), level.traffic(5, each=2))
    passes = gather(evidence, level.model, 1.0)
    credit = level.rng.uniform(0.0, 1.0, len(passes)) * (level.rng.uniform(size=len(passes)) > 0.2)
    fast = compare(passes, level.model.covariance, credit)
    rows = level.rng.choice(len(passes), 60, replace=False)
    for row in rows:
        residual, variance = naive_compare(passes, level.model.covariance, credit, int(row))
        np.testing.assert_allclose(fast.residual[row], residual, atol=1e-4)
        assert fast.variance[row] == pytest.approx(variance, abs=1e-4)


def test_the_misfit_of_honest_walks_is_one_or_less() -> None:
    misfit = []
    for seed in range(35, 37):
        level = Level.random(seed)
        passes = gather(joined(level.survey(2.0), level.traffic(10)), level.model, 1.0)
        found = compare(passes, level.model.covariance, np.ones(len(passes)))
        misfit.append(found.misfit[~passes.survey & (found.explained > 0.3)])
    assert 0.5 < np.concatenate(misfit).mean() < 1.2


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        (Reason.AMPLITUDE, lambda xy, v: v * 8.0),
        (Reason.ROUGH, lambda xy, v: v + 25.0 * np.resize([1.0, -1.0], len(v))[:, None] * [0.0, 1.0, 0.0]),
        (Reason.SMOOTH, lambda xy, v: np.tile(v.mean(axis=0), (len(v), 1))),
    ],
)
def test_what_is_no_field_is_blocked(reason: Reason, change: object) -> None:
    level = Level.random(36)
    fake = tampered(level.session("fake", "eve", DAY_S), change)  # type: ignore[arg-type]
    weighed = weigh(joined(level.survey(), fake), model=level.model)
    assert weighed.verdicts[0].reason is reason
    assert weighed.verdicts[0].action is Action.BLOCK
    assert weights(weighed, "fake").max() == 0.0
    off = weigh(joined(level.survey(), fake), TrustPolicy(physics=None, agreement=False), model=level.model)
    assert weights(off, "fake").min() > 0.0


def test_jumps_between_neighbours_are_blocked() -> None:
    level = Level.random(36)
    way = np.repeat(level.lane(7.0), 2, axis=0) + np.tile([[0.0, 0.0], [0.3, 0.0]], (50, 1))
    fake = tampered(
        level.session("fake", "eve", DAY_S, way), lambda _xy, v: v + 35.0 * (np.arange(len(v)) % 2)[:, None]
    )
    assert weigh(joined(level.survey(), fake), model=level.model).verdicts[0].reason is Reason.JUMP


def test_a_magnet_carried_round_a_closed_way_shows() -> None:
    """Its field turns with the walker: the line integral round the way is not nought, whoever else was there."""
    level = Level.random(37)
    angle = np.linspace(0.0, 2.0 * np.pi, 90)
    ring = np.array([15.0, 10.0]) + 8.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    honest = level.session("honest", "ann", DAY_S, ring, 0.1)
    tangent = 12.0 * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    magnet = tampered(level.session("magnet", "bob", 2 * DAY_S, ring, 0.1), lambda _xy, v: v + tangent)
    verdicts = {v.source_id: v.reason for v in weigh(joined(honest, magnet), model=level.model).verdicts}
    assert verdicts["magnet"] is Reason.CURL
    assert verdicts["honest"] is not Reason.CURL


def test_nothing_comes_of_nothing() -> None:
    level = Level.random(38)
    empty = weigh(Evidence.empty(FeatureSet.VECTOR), model=level.model)
    assert len(empty.evidence) == 0
    one = level.session("s", "ann", DAY_S).subset(np.array([0]))
    assert weigh(one, model=level.model).evidence.weight.tolist() == [0.0]


def test_rows_that_are_no_numbers_do_no_harm() -> None:
    level = Level.random(38)
    good = joined(level.survey(4.0), level.traffic(3))
    broken = tampered(level.session("broken", "eve", DAY_S), lambda _xy, v: np.full_like(v, np.nan))
    weighed = weigh(joined(good, broken), model=level.model)
    assert weights(weighed, "broken").max() == 0.0
    expected = weigh(good, model=level.model).evidence.weight
    np.testing.assert_array_equal(weighed.evidence.weight[: len(good)], expected)


def test_weighing_does_not_touch_its_input() -> None:
    level = Level.random(38)
    evidence = joined(level.survey(4.0), level.traffic(3))
    before = evidence.weight.copy()
    first = weigh(evidence, model=level.model)
    np.testing.assert_array_equal(evidence.weight, before)
    again = weigh(first.evidence, model=level.model)  # weights from before do not matter
    np.testing.assert_array_equal(again.evidence.weight, first.evidence.weight)


@pytest.mark.timing
def test_a_walk_is_weighed_in_milliseconds() -> None:
    level = Level.random(39)
    evidence = joined(level.survey(), level.traffic(40))
    weigh(evidence, model=level.model)
    began = time.process_time()
    weigh(evidence, model=level.model)
    assert (time.process_time() - began) / 40 < 0.05


def test_reduction_bounds_a_cell_and_keeps_the_newest() -> None:
    level = Level.random(41)
    way = level.lane(10.0)
    sessions = [level.session(f"s{i}", f"user{i}", DAY_S * (i + 1), way, 0.01) for i in range(12)]
    evidence = joined(level.survey(4.0), sessions)
    policy = ReductionPolicy(sources=5)
    reduced = reduce(evidence, policy)
    kinds = [source.kind for source in reduced.sources]
    assert kinds.count(SourceKind.SURVEY) == 5
    kept = {source.id for source in reduced.sources if source.kind is SourceKind.SESSION}
    assert {f"s{i}" for i in range(7, 12)} <= kept
    cell = np.floor(reduced.xy / policy.cell_m).astype(int)
    session = np.array([kind is SourceKind.SESSION for kind in kinds])[reduced.source]
    _, count = np.unique(cell[session], axis=0, return_counts=True)
    assert count.max() <= 5
    again = reduce(reduced, policy)
    assert len(again) == len(reduced)


def test_reduction_does_not_grow_with_traffic() -> None:
    level = Level.random(42)
    policy = ReductionPolicy(sources=4)
    sizes = [len(reduce(joined(level.traffic(n)), policy)) for n in (40, 80, 160)]
    columns, rows = (np.ceil((side + 2.0) / policy.cell_m) for side in level.size)  # some are placed outside
    assert sizes[2] <= 4 * columns * rows
    assert sizes[2] - sizes[1] < sizes[1] - sizes[0]


def test_nobody_pushes_the_others_out() -> None:
    level = Level.random(43)
    way = level.lane(10.0)
    others = [level.session(f"o{i}", f"user{i}", DAY_S * (i + 1), way, 0.01) for i in range(4)]
    flood = [level.session(f"f{i}", "eve", DAY_S * (i + 50), way, 0.01) for i in range(40)]
    reduced = reduce(joined(others, flood), ReductionPolicy(sources=6, per_contributor=2))
    rows = {source.id: int((reduced.source == i).sum()) for i, source in enumerate(reduced.sources)}
    assert sum(rows[f"o{i}"] for i in range(4)) > sum(n for name, n in rows.items() if name.startswith("f"))


def test_merged_rows_are_means() -> None:
    level = Level.random(44)
    way = np.array([[1.1, 1.1], [1.2, 1.2], [5.1, 1.1]])
    session = level.session("s", "ann", DAY_S, way, 0.0)
    merged = reduce(session)
    assert len(merged) == 2
    np.testing.assert_allclose(merged.values[0], session.values[:2].mean(axis=0), rtol=1e-5)
    assert merged.sources == session.sources
