"""Search against enumeration of all correspondences."""

import numpy as np
import pytest
from oracles.dcg import all_sets, log_probability, root_distribution

from jaxlangnav.grounding.search import (
    Hypothesis,
    best_sets,
    combinations,
    merge,
    search,
    search_exactly,
)
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.training.search_many import flips, search_exactly_many, search_many


def leaf(label="NP", *children):
    return Phrase(label=label, words=(), children=children)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("width", [1, 4, 11, 64])
def test_best_sets_are_those_of_enumeration(seed, width):
    odds = np.random.default_rng(seed).normal(0, 2, 6)
    found = best_sets(odds, width)
    scores = sorted((log_probability(s, odds) for s in all_sets(6)), reverse=True)[:width]
    np.testing.assert_allclose([score for _, score in found], scores, atol=1e-9)
    for expressed, score in found:
        assert log_probability(expressed, odds) == pytest.approx(score)
    assert len({expressed.tobytes() for expressed, _ in found}) == len(found)


def test_excluded_symbols_are_never_expressed():
    odds = np.array([0.1, -np.inf, -0.2])
    assert not any(expressed[1] for expressed, _ in best_sets(odds, 8))
    assert len(best_sets(odds, 8)) == 4


def test_no_symbols_have_one_set():
    assert [score for _, score in best_sets(np.zeros(0), 4)] == [0.0]


def test_combinations_keep_the_best():
    rng = np.random.default_rng(0)
    beams = [
        [Hypothesis(np.array([i]), s) for i, s in enumerate(-np.sort(rng.exponential(1, 4)))]
        for _ in range(3)
    ]
    found = combinations(beams, 4)
    every = sorted(
        (
            a.log_probability + b.log_probability + c.log_probability
            for a in beams[0]
            for b in beams[1]
            for c in beams[2]
        ),
        reverse=True,
    )
    np.testing.assert_allclose([score for _, score in found], every[:4])


def test_equal_sets_add_up():
    one, two = np.array([True]), np.array([False])
    merged = merge([Hypothesis(one, -1.0), Hypothesis(two, -0.9), Hypothesis(one, -1.2)], 4)
    assert merged[0].log_probability == pytest.approx(np.logaddexp(-1.0, -1.2))
    assert merged[1].log_probability == -0.9


def graph_of(seed, size=2):
    """A tree of four phrases whose odds depend on every child symbol."""
    rng = np.random.default_rng(seed)
    tree = leaf("VP", leaf("NP", leaf(), leaf("PP")))
    tables = {}

    def odds(phrase, path, children):
        if path not in tables:
            base = rng.normal(0, 1.5, size)
            tables[path] = (base, rng.normal(0, 2, (len(phrase.children), size, size)))
        base, weight = tables[path]
        masks = [c.expressed if isinstance(c, Hypothesis) else c for c in children]
        return base + sum(mask.astype(float) @ w for mask, w in zip(masks, weight, strict=True))

    return tree, odds


@pytest.mark.parametrize("seed", range(8))
def test_wide_beam_is_exact_enumeration(seed):
    tree, odds = graph_of(seed)
    exact = root_distribution(tree, odds)
    found = search(tree, odds, width=64)
    assert sum(exact.values()) == pytest.approx(1.0)
    assert len(found) == 4
    for hypothesis in found:
        chance = np.exp(hypothesis.log_probability)
        assert chance == pytest.approx(exact[hypothesis.expressed.tobytes()], abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_narrow_beam_never_claims_too_much(seed):
    tree, odds = graph_of(seed)
    exact = root_distribution(tree, odds)
    found = search(tree, odds, width=4)
    for hypothesis in found:
        assert np.exp(hypothesis.log_probability) <= exact[hypothesis.expressed.tobytes()] + 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_a_proven_set_is_the_likeliest_of_the_enumeration(seed):
    tree, odds = graph_of(seed, size=3)
    exact = root_distribution(tree, odds)
    best, is_proven = search_exactly(tree, odds)
    assert is_proven  # four phrases of three symbols: 256 combinations are all there are
    assert best.expressed.tobytes() == max(exact, key=exact.__getitem__)


def test_what_cannot_be_proven_is_not():
    """Forty symbols at even odds: 2^40 sets are equally likely."""
    _, is_proven = search_exactly(leaf(), lambda *_: np.full(40, 1e-3))
    assert not is_proven
    _, is_proven = search_exactly(leaf(), lambda *_: np.full(40, 9.0))
    assert is_proven


@pytest.mark.parametrize("width", [1, 2, 4, 5, 8])
def test_no_cheap_choice_of_flips_is_forgotten(width):
    """Of all choices among ten factors, by costs of every kind, the cheapest are in the table."""
    rng = np.random.default_rng(width)
    table = flips(width)
    assert not table[0].any()
    known = {row.tobytes() for row in np.pad(table, ((0, 0), (0, 10 - width)))}
    every = np.array(list(all_sets(10)))
    for scale in (0.01, 0.3, 1.0, 3.0):
        cost = np.sort(rng.exponential(1, 10) ** scale)
        cheapest = every[np.argsort(every @ cost)[:width]]
        assert {row.tobytes() for row in cheapest} <= known
    if width > 2:
        # As many choices as the beam is wide are never dearer than the dearest factor but one.
        assert len(table) < 4 * width


@pytest.mark.parametrize("width", [1, 4, 16])
def test_many_models_at_once_are_each_alone(width):
    """Models of one tree that come upon different child sets: every hypothesis is the same."""
    graphs = [graph_of(seed, size=3) for seed in range(7)]
    tree = graphs[0][0]

    def odds(phrase, path, children, models):
        return np.stack([graphs[m][1](phrase, path, children) for m in models])

    beams = search_many(tree, odds, len(graphs), width=width)
    for model, (_, alone) in enumerate(graphs):
        same(beams.of(model), search(tree, alone, width=width))


def same(found, wanted):
    """Compare hypotheses and all below them; rounding of sums aside."""
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one.expressed, other.expressed)
        assert one.log_probability == pytest.approx(other.log_probability, abs=1e-12)
        same(one.children, other.children)


def test_a_symbol_that_is_excluded_is_so_for_many_models():
    odds = np.array([[0.1, -np.inf, -0.2, 3.0], [2.0, -np.inf, 0.5, 0.4]])
    beams = search_many(leaf(), lambda *given: odds[given[-1]], 2, width=8)
    for model in range(2):
        same(beams.of(model), search(leaf(), lambda *_, row=odds[model]: row, width=8))
        assert len(beams.of(model)) == 8


def test_many_models_are_proven_as_each_alone():
    rng = np.random.default_rng(4)
    odds = rng.normal(0, 3, (12, 9)) * rng.choice([0.02, 1.0], (12, 1))

    def beams_of(width, models):
        return search_many(leaf(), lambda *given: odds[models][given[-1]], len(models), width=width)

    best, is_proven = search_exactly_many(beams_of, len(odds))
    assert 0 < is_proven.sum() < len(odds)
    for row, one, proven in zip(odds, best, is_proven, strict=True):
        alone, is_sure = search_exactly(leaf(), lambda *_, row=row: row)
        np.testing.assert_array_equal(one, alone.expressed)
        assert proven == is_sure
