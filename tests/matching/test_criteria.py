"""Criteria by their formulas, and what they forgive."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.errors import InputError
from app.engine.matching.criteria import CRITERIA, Criterion, Moments, as_cost, centred, evaluate, evaluate_moments

SECOND_ORDER = [c for c in Criterion if c not in (Criterion.MAD, Criterion.AD, Criterion.HAUSDORFF)]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def by_formula(criterion: Criterion, m: np.ndarray, s: np.ndarray) -> float:
    """Of single sequences (n, channels), as the formulas are printed."""
    n, channels = m.shape
    if criterion is Criterion.HAUSDORFF:
        d = [[float(np.linalg.norm(a - b)) for b in s] for a in m]
        return max(max(min(row) for row in d), max(min(column) for column in zip(*d, strict=True)))
    if criterion is Criterion.CC:
        m, s = m - m.mean(axis=0), s - s.mean(axis=0)
    pairs = [(float(s[k, c]), float(m[k, c])) for k in range(n) for c in range(channels)]
    cosine = sum(a * b for a, b in pairs) / np.sqrt(sum(a * a for a, _ in pairs) * sum(b * b for _, b in pairs))
    return {
        Criterion.MAD: sum(abs(a - b) for a, b in pairs) / len(pairs),
        Criterion.MSD: sum((a - b) ** 2 for a, b in pairs) / len(pairs),
        Criterion.AD: sum(abs(a - b) for a, b in pairs),
        Criterion.SD: sum((a - b) ** 2 for a, b in pairs),
        Criterion.COR: sum(a * b for a, b in pairs) / len(pairs),
        Criterion.PROD: sum(a * b for a, b in pairs) / len(pairs),
        Criterion.NPROD: cosine,
        Criterion.CC: cosine,
    }[criterion]


@pytest.mark.parametrize("criterion", Criterion)
@pytest.mark.parametrize("channels", [1, 3])
def test_each_is_its_formula(rng: np.random.Generator, criterion: Criterion, channels: int) -> None:
    m, s = rng.normal(3.0, 2.0, (12, channels)), rng.normal(2.0, 2.0, (2, 4, 12, channels))
    expected = [[by_formula(criterion, m, one) for one in row] for row in s]
    np.testing.assert_allclose(evaluate(criterion, m, s), expected)


def test_known_values() -> None:
    m, s = np.array([[0.0], [1.0], [3.0]]), np.array([[1.0], [1.0], [5.0]])
    assert evaluate(Criterion.MAD, m, s) == 1.0
    assert evaluate(Criterion.SD, m, s) == 5.0
    assert evaluate(Criterion.NPROD, m, s) == pytest.approx(16.0 / np.sqrt(10.0 * 27.0))
    assert evaluate(Criterion.HAUSDORFF, m, s) == 2.0
    assert evaluate(Criterion.CC, m, 2.0 * m + 7.0) == pytest.approx(1.0)


@pytest.mark.parametrize("criterion", Criterion)
def test_the_sequence_itself_is_best_but_for_products(rng: np.random.Generator, criterion: Criterion) -> None:
    m = rng.normal(0.0, 2.0, (20, 2))
    others = np.concatenate([m[None], rng.normal(0.0, 2.0, (50, 20, 2)), 3.0 * m[None]])
    best = int(as_cost(criterion, evaluate(criterion, m, others)).argmin())
    assert best == (51 if criterion in (Criterion.COR, Criterion.PROD) else 0)
    assert criterion.maximized == (CRITERIA[criterion].better == "max")


@pytest.mark.parametrize("criterion", Criterion)
@pytest.mark.parametrize("what", ["offset", "gain", "order"])
def test_the_table_tells_what_they_forgive(rng: np.random.Generator, criterion: Criterion, what: str) -> None:
    """Forgiven: the order of candidates does not change."""
    m, s = rng.normal(4.0, 2.0, (10, 2)), rng.normal(4.0, 2.0, (200, 10, 2))
    spoiled = {"offset": m + np.array([3.0, -5.0]), "gain": 1.6 * m, "order": m[rng.permutation(10)]}[what]
    before, after = (np.argsort(evaluate(criterion, one, s)) for one in (m, spoiled))
    assert bool((before == after).all()) is getattr(CRITERIA[criterion], what)


def test_every_criterion_has_its_row() -> None:
    assert set(CRITERIA) == set(Criterion)
    for note in CRITERIA.values():
        assert note.forgives.endswith(".")
        assert note.better in ("min", "max")


@pytest.mark.parametrize("criterion", SECOND_ORDER)
@pytest.mark.parametrize("centre", [False, True])
def test_sums_give_the_same(rng: np.random.Generator, criterion: Criterion, centre: bool) -> None:
    m, s, w = rng.normal(3.0, 2.0, (12, 2)), rng.normal(2.0, 2.0, (6, 12, 2)), rng.uniform(0.0, 1.0, (6, 12))
    wc = w[..., None]
    sums = [(wc * part).sum(axis=1).T for part in (s, s * s, s * m, m + 0 * s, m * m + 0 * s)]
    moments = Moments(w.sum(axis=1), *sums)
    compared = centred(m, s, w) if centre else m
    found = evaluate_moments(criterion, moments.centred() if centre else moments, 12)
    np.testing.assert_allclose(found, evaluate(criterion, compared, s, w))
    by = np.array([5.0, -7.0])
    moved = moments.shifted(by)
    shifted = evaluate(criterion, m + by, s + by, w)
    np.testing.assert_allclose(evaluate_moments(criterion, moved, 12), shifted)


@pytest.mark.parametrize("criterion", Criterion)
def test_points_of_no_weight_are_not_there(rng: np.random.Generator, criterion: Criterion) -> None:
    m, s = rng.normal(3.0, 2.0, (12, 2)), rng.normal(2.0, 2.0, (12, 2))
    weight = np.array([1.0] * 8 + [0.0] * 4)
    expected = evaluate(criterion, m[:8], s[:8])
    if criterion in (Criterion.AD, Criterion.SD):
        expected = expected * 12 / 8
    assert evaluate(criterion, m, s, weight) == pytest.approx(float(expected))
    assert np.isfinite(evaluate(criterion, m, s, np.zeros(12)))


@pytest.mark.parametrize("criterion", Criterion)
@pytest.mark.filterwarnings("error")
def test_constant_sequences_and_single_points(criterion: Criterion) -> None:
    flat = np.full((7, 1), 4.0)
    for m, s in ((flat, flat), (flat[:1], flat[:1]), (flat * 0.0, flat)):
        value = float(evaluate(criterion, m, s))
        assert np.isfinite(value)
        if criterion is Criterion.CC:
            assert value == 0.0


def test_what_is_not_alike_is_refused() -> None:
    with pytest.raises(InputError, match="measured"):
        evaluate(Criterion.MAD, np.zeros((4, 1)), np.zeros((5, 1)))
    with pytest.raises(InputError, match="measured"):
        evaluate(Criterion.MAD, np.zeros((0, 1)), np.zeros((0, 1)))
    with pytest.raises(InputError, match="criterion"):
        evaluate_moments(Criterion.MAD, Moments(*(np.ones((1,)) for _ in range(6))), 1)
