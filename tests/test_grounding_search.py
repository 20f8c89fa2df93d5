"""Search against enumeration of all correspondences, and the paper's numbers of symbols."""

import numpy as np
import pytest
from oracles.dcg import all_sets, log_probability, root_distribution

from jaxlangnav.grounding.search import search, search_exactly
from jaxlangnav.grounding.symbols import (
    OBJECT,
    REGION,
    RELATION,
    AnnotationSpace,
    BehaviorSpace,
    bottom_up,
    count_graph,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import ROBOT


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


ODDS = {
    f"normal {seed}": np.random.default_rng(seed).normal(0, 2, 6) for seed in range(6)
} | {
    # Margins of every kind, many of them near to one another or far apart.
    f"margins {scale} {seed}": np.random.default_rng(seed).exponential(1, 10) ** scale
    for scale in (0.01, 0.3, 1.0, 3.0) for seed in (1, 2)
} | {"excluded": np.array([0.1, -np.inf, -0.2, 3.0]), "none": np.zeros(0)}  # fmt: skip


@pytest.mark.parametrize("name", ODDS)
@pytest.mark.parametrize("width", [1, 4, 5, 8, 64])
def test_best_sets_are_those_of_enumeration(name, width):
    odds = ODDS[name]
    found = beam_of(odds, width)
    every = [log_probability(one, odds) for one in all_sets(len(odds))]
    possible = sorted((one for one in every if one > -np.inf), reverse=True)
    np.testing.assert_allclose([one.log_probability for one in found], possible[:width], atol=1e-9)
    for one in found:
        assert log_probability(one.expressed, odds) == pytest.approx(one.log_probability)
    assert len({one.expressed.tobytes() for one in found}) == len(found)


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


@pytest.mark.parametrize("seed", range(8))
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


def test_many_models_are_proven_as_each_alone():
    rng = np.random.default_rng(4)
    odds = rng.normal(0, 3, (12, 9)) * rng.choice([0.02, 1.0], (12, 1))
    best, is_proven = proven(leaf(), lambda path, children, models: odds[models], len(odds))
    assert 0 < is_proven.sum() < len(odds)
    for row, one, is_sure in zip(odds, best, is_proven, strict=True):
        alone, sure = proven(leaf(), of_one(lambda path, children, row=row: row))
        np.testing.assert_array_equal(one, alone[0])
        assert is_sure == sure[0]


# ---------------------------------------------------------------- symbol spaces and factor graphs

SENTENCE = "go to the hydrant behind the cone"


def test_annotation_space_has_the_papers_size():
    space = AnnotationSpace(8)
    kinds = [symbol.kind for symbol in space.symbols]
    assert [kinds.count(k) for k in (OBJECT, REGION, RELATION)] == [8, 54, 432]
    assert space.size == len(space.symbols) == len(set(space.symbols)) == 494


def test_behavior_space_has_the_papers_size():
    space = BehaviorSpace(7)
    noun, verb = (leaf_of(label) for label in ("NP", "VP"))
    assert space.num_expressible(noun) == 7 + 49
    assert space.num_expressible(verb) == 2 + 3 + 49 + 49
    assert space.size == len(set(space.symbols)) == 56 + 103


def leaf_of(label):
    return Phrase(label=label, words=())


@pytest.mark.parametrize(("text", "phrases"), [("go to the hydrant", 3), (SENTENCE, 6)])
@pytest.mark.parametrize("objects", [0, 1, 9])
def test_counts_follow_the_formula(text, phrases, objects):
    counts = count_graph(parse(text).clauses, BehaviorSpace(objects))
    assert counts["factors"] == (phrases - 1) * 8 * objects + 5 + 14 * objects
    assert counts["variables"] == phrases + 2 * counts["factors"]


def test_children_stand_before_parents():
    nodes = bottom_up(parse(SENTENCE).clauses[0])
    assert all(child < i for i, node in enumerate(nodes) for child in node.children)
    assert nodes[-1].path == (0,)


def test_sets_and_members_are_inverse():
    space = AnnotationSpace(3)
    said = (object_symbol(1), region_symbol(4, ROBOT), relation_symbol(2, 0, 1))
    mask = space.mask(said)
    assert space.members(mask) == said
    objects, regions, relations = space.parts(mask)
    assert objects.tolist() == [False, True, False]
    assert np.argwhere(regions).tolist() == [[4, 3]]
    assert np.argwhere(relations).tolist() == [[2, 0, 1]]
