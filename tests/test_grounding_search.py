"""Search against enumeration of all correspondences."""

import numpy as np
import pytest
from oracles.dcg import all_sets, log_probability, root_distribution

from jaxlangnav.grounding.search import search, search_exactly
from jaxlangnav.language.phrase import Phrase


def leaf(label="NP", *children):
    return Phrase(label=label, words=(), children=children)


def beam_of(odds, width):
    """Search one phrase of one model; its odds depend on nothing."""
    return search(leaf(), lambda *_: np.asarray(odds)[None], 1, width=width).of(0)


def proven(tree, odds, num_models=1):
    def beams_of(width, models):
        def some(path, children, rows):
            return odds(path, children, models[rows])

        return search(tree, some, len(models), width=width)

    return search_exactly(beams_of, num_models)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("width", [1, 4, 11, 64])
def test_best_sets_are_those_of_enumeration(seed, width):
    odds = np.random.default_rng(seed).normal(0, 2, 6)
    found = beam_of(odds, width)
    scores = sorted((log_probability(s, odds) for s in all_sets(6)), reverse=True)[:width]
    np.testing.assert_allclose([one.log_probability for one in found], scores, atol=1e-9)
    for one in found:
        assert log_probability(one.expressed, odds) == pytest.approx(one.log_probability)
    assert len({one.expressed.tobytes() for one in found}) == len(found)


@pytest.mark.parametrize("scale", [0.01, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("width", [1, 2, 4, 5, 8])
def test_no_cheap_set_of_flips_is_forgotten(width, scale):
    """Margins of every kind, many of them near to one another or far apart."""
    margins = np.random.default_rng(width).exponential(1, 10) ** scale
    scores = np.sort([log_probability(one, margins) for one in all_sets(10)])[::-1]
    found = [one.log_probability for one in beam_of(margins, width)]
    np.testing.assert_allclose(found, scores[:width], atol=1e-9)


def test_excluded_symbols_are_never_expressed():
    odds = np.array([0.1, -np.inf, -0.2])
    assert not any(one.expressed[1] for one in beam_of(odds, 8))
    assert len(beam_of(odds, 8)) == 4


def test_no_symbols_have_one_set():
    assert [one.log_probability for one in beam_of(np.zeros(0), 4)] == [0.0]


def graph_of(seed, size=2):
    """A tree of five phrases whose odds depend on every child symbol."""
    rng = np.random.default_rng(seed)
    tree = leaf("VP", leaf("NP", leaf(), leaf("PP")))
    tables = {}

    def odds(path, children):
        if path not in tables:
            base = rng.normal(0, 1.5, size)
            tables[path] = (base, rng.normal(0, 2, (len(children), size, size)))
        base, weight = tables[path]
        return base + sum(mask.astype(float) @ w for mask, w in zip(children, weight, strict=True))

    return tree, odds


def of_one(odds):
    return lambda path, children, models: odds(path, children)[None].repeat(len(models), 0)


def enumerated(tree, odds):
    return root_distribution(tree, lambda _, path, children: odds(path, children))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("width", [4, 64])
def test_beam_is_enumeration_or_claims_less(seed, width):
    """Equal sets that rest on different children add up; a wide beam misses none."""
    tree, odds = graph_of(seed)
    exact = enumerated(tree, odds)
    found = search(tree, of_one(odds), 1, width=width).of(0)
    assert sum(exact.values()) == pytest.approx(1.0)
    assert len(found) == 4
    for one in found:
        chance, wanted = np.exp(one.log_probability), exact[one.expressed.tobytes()]
        assert chance <= wanted + 1e-12
        assert width == 4 or chance == pytest.approx(wanted, abs=1e-12)


def test_a_hypothesis_rests_on_its_likeliest_children():
    """By hand: given a leaf that expresses its symbol, the root does so too, and else not."""
    tree, sure = leaf("VP", leaf()), np.array([5.0])
    found = search(
        tree,
        lambda path, children, models: np.stack(
            [np.where(children[0], sure, -sure) if children else np.array([1.0])] * len(models)
        ),
        1,
        width=4,
    ).of(0)
    assert [one.expressed.tolist() for one in found] == [[True], [False]]
    assert [one.children[0].expressed.tolist() for one in found] == [[True], [False]]


@pytest.mark.parametrize("seed", range(20))
def test_a_proven_set_is_the_likeliest_of_the_enumeration(seed):
    tree, odds = graph_of(seed, size=3)
    exact = enumerated(tree, odds)
    (best,), is_proven = proven(tree, of_one(odds))
    assert is_proven.all()  # four phrases of three symbols: 256 combinations are all there are
    assert best.tobytes() == max(exact, key=exact.__getitem__)


def test_what_cannot_be_proven_is_not():
    """Forty symbols at even odds: 2^40 sets are equally likely."""
    odds = np.stack([np.full(40, 1e-3), np.full(40, 9.0)])
    _, is_proven = proven(leaf(), lambda path, children, models: odds[models], 2)
    assert is_proven.tolist() == [False, True]


@pytest.mark.parametrize("width", [1, 4, 16])
def test_many_models_at_once_are_each_alone(width):
    """Models of one tree that come upon different child sets: every hypothesis is the same."""
    graphs = [graph_of(seed, size=3) for seed in range(7)]
    tree = graphs[0][0]

    def odds(path, children, models):
        return np.stack([graphs[m][1](path, children) for m in models])

    beams = search(tree, odds, len(graphs), width=width)
    for model, (_, alone) in enumerate(graphs):
        same(beams.of(model), search(tree, of_one(alone), 1, width=width).of(0))


def same(found, wanted):
    """Compare hypotheses and all below them; rounding of sums aside."""
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one.expressed, other.expressed)
        assert one.log_probability == pytest.approx(other.log_probability, abs=1e-12)
        same(one.children, other.children)


def test_a_symbol_that_is_excluded_is_so_for_many_models():
    odds = np.array([[0.1, -np.inf, -0.2, 3.0], [2.0, -np.inf, 0.5, 0.4]])
    beams = search(leaf(), lambda path, children, models: odds[models], 2, width=8)
    for model in range(2):
        same(beams.of(model), beam_of(odds[model], 8))
        assert len(beams.of(model)) == 8


def test_many_models_are_proven_as_each_alone():
    rng = np.random.default_rng(4)
    odds = rng.normal(0, 3, (12, 9)) * rng.choice([0.02, 1.0], (12, 1))
    best, is_proven = proven(leaf(), lambda path, children, models: odds[models], len(odds))
    assert 0 < is_proven.sum() < len(odds)
    for row, one, is_sure in zip(odds, best, is_proven, strict=True):
        alone, sure = proven(leaf(), of_one(lambda path, children, row=row: row))
        np.testing.assert_array_equal(one, alone[0])
        assert is_sure == sure[0]
