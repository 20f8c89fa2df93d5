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
    """Search one phrase; its odds depend on nothing."""
    return search(leaf(), lambda *_: np.asarray(odds), width=width)


def proven(tree, odds):
    return search_exactly(lambda width: search(tree, odds, width=width))


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


def enumerated(tree, odds):
    return root_distribution(tree, lambda _, path, children: odds(path, children))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("width", [4, 64])
def test_beam_is_enumeration_or_claims_less(seed, width):
    """Equal sets that rest on different children add up; a wide beam misses none."""
    tree, odds = graph_of(seed)
    exact = enumerated(tree, odds)
    found = search(tree, odds, width=width)
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
        lambda _, children: np.where(children[0], sure, -sure) if children else np.array([1.0]),
    )
    assert [one.expressed.tolist() for one in found] == [[True], [False]]
    assert [one.children[0].expressed.tolist() for one in found] == [[True], [False]]


@pytest.mark.parametrize("seed", range(8))
def test_a_proven_set_is_the_likeliest_of_the_enumeration(seed):
    tree, odds = graph_of(seed, size=3)
    exact = enumerated(tree, odds)
    best, is_proven = proven(tree, odds)
    assert is_proven  # four phrases of three symbols: 256 combinations are all there are
    assert best.tobytes() == max(exact, key=exact.__getitem__)


def test_what_cannot_be_proven_is_not():
    """Forty symbols at even odds: 2^40 sets are equally likely."""
    for odds, wanted in ((1e-3, False), (9.0, True)):
        assert proven(leaf(), lambda *_, odds=odds: np.full(40, odds))[1] is wanted


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
