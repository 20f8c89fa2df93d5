"""The correspondence graph with anybody's symbols, its search, and trees as text."""

import dataclasses
import itertools
from types import MappingProxyType

import numpy as np
import pytest
from grounding_fixture import TYPES, corpus
from hypothesis import HealthCheck, given, settings, strategies as st
from matplotlib.patches import Wedge
from oracles.dcg import all_sets, log_probability, root_distribution

from jaxlangnav.grounding import load_shipped
from jaxlangnav.grounding.correspondence import (
    RANKS,
    SYMBOLS,
    Block,
    CorrespondenceGraph,
    Described,
    Labelled,
    read_tree,
)
from jaxlangnav.grounding.model import CorrespondenceModel, build_vocabulary
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.search import search, search_exactly
from jaxlangnav.grounding.symbols import (
    AnnotationSpace,
    BehaviorSpace,
    SymbolDomain,
    count_factors,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.messages import ROBOT
from jaxlangnav.training import train_graph
from jaxlangnav.training.examples import examples_of, model_examples
from jaxlangnav.training.fit import TrainingConfig
from jaxlangnav.viz.graph import beliefs_figure

COLOURS = ("red", "blue", "green")


COLUMNS = {"thing": ("bias", *COLOURS, "meant"), "side": ("bias", "meant"), RANKS: ("bias", "is")}


class Yard:
    """Things and their left sides, ranks too; a noun phrase expresses things alone."""

    columns = MappingProxyType(COLUMNS)

    def symbols_in(self, world):
        names = [f"{what} {i}" for what in ("at", "left of") for i in range(len(world))]
        return SymbolDomain(names)

    def describe(self, phrase, path, world):
        own = [[colour == one for one in COLOURS] for colour in world]
        size = len(world)

        def given(children):
            meant = np.any([child[:size] for child in children] or [np.zeros(size)], axis=0)
            things = Block(slice(0, size), np.column_stack([np.ones(size), own, meant]))
            if phrase.label == "NP":
                return {"thing": things}
            sides = Block(size + np.arange(size), np.column_stack([np.ones(size), meant]))
            return {"thing": things, "side": sides}

        said = "second" in {word.text for word in phrase.words}
        return Described(given, np.array([[1.0, not said], [1.0, said]]))


SPACE = Yard()
WORLDS = (("red", "blue", "green"), ("blue", "red"), ("green", "blue", "red", "red"))


def labelled():
    """Sentences "take the red one" and "go left of the red one" in all worlds."""
    found = []
    for world, colour in itertools.product(WORLDS, COLOURS):
        own = [i for i, one in enumerate(world) if one == colour]
        things, sides = (frozenset(f"{what} {i}" for i in own) for what in ("at", "left of"))
        for verb, meant in (("take", things), ("go left of", sides)):
            root = read_tree(f"VP[{verb}]{{NP[the {colour} one]}}")
            one = Labelled(root=root, world=world, expressed=[things, meant], ranks=[0, 0])
            found.append(one)
    return found


def is_right(graph, one):
    """Whether the likeliest set at the root is exactly the labelled one."""
    tree = graph.score(one.root, one.world, one.clause)
    return set(tree.symbols.members(tree.search()[0].expressed)) == one.expressed[-1]


@pytest.fixture(scope="module")
def graph():
    return train_graph(SPACE, labelled(), config=TrainingConfig(l2=0.003))[0]


def test_own_symbols_are_learned(graph):
    assert all(is_right(graph, one) for one in labelled())
    world = ("green", "green", "red", "blue")  # never seen
    best = graph.ground(read_tree("VP[go left of]{NP[the red one]}"), world)[0]
    assert best.symbols == ("left of 2",)
    assert best.probability > 0.5


def test_beliefs_are_those_of_the_likeliest_reading(graph):
    root, world = read_tree("VP[take]{NP[the blue one]}"), WORLDS[0]
    top, below = graph.score(root, world).beliefs()
    assert below.parent == top.path
    meant = below.probability > 0.5
    assert meant.tolist() == [False, True, False, *[False] * 3]
    coefficients = graph.model.coefficients(root)
    for kind, block in SPACE.describe(root, (0,), world).given([meant]).items():
        likely = 1 / (1 + np.exp(-block.properties @ coefficients[kind]))
        np.testing.assert_allclose(top.probability[block.indices], likely, rtol=1e-5)


def test_a_picture_of_own_symbols(graph):
    root, world = read_tree("VP[take]{NP[the blue one]}"), WORLDS[0]
    figure = beliefs_figure(
        graph.score(root, world).beliefs(),
        SPACE.symbols_in(world).symbols,
        title="take the blue one",
    )
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts.count("at 1") == 2
    assert "3 more" in texts
    assert any(isinstance(patch, Wedge) for patch in figure.axes[0].patches)


def test_bad_corpora_are_refused():
    good = labelled()[0]
    stranger = [frozenset({"pink block 9"}), frozenset()]
    with pytest.raises(ValueError, match="tree 0: pink block 9 is no symbol"):
        examples_of(SPACE, [Labelled(root=good.root, world=good.world, expressed=stranger)])
    with pytest.raises(ValueError, match=r"1 labels, but .* has 2 phrases"):
        examples_of(SPACE, [Labelled(root=good.root, world=good.world, expressed=stranger[1:])])
    with pytest.raises(ValueError, match="no tree to train on"):
        train_graph(SPACE, [])
    with pytest.raises(ValueError, match="groups of features are"):
        train_graph(SPACE, [good], without=frozenset({"smell"}))

    class Short(Yard):
        columns = MappingProxyType(COLUMNS | {"thing": ("bias",)})

    with pytest.raises(ValueError, match=r"properties are \(3, 5\), but must be \(3, 1\)"):
        examples_of(Short(), [good])


def test_factors_of_own_symbols_are_counted():
    root = read_tree("VP[take]{PP[left of]{NP[the red one]}}")
    sizes = {"phrases": 3, "factors": 3 * 8, "variables": 3 + 2 * 3 * 8}
    assert count_factors([root], SPACE.symbols_in(WORLDS[2])) == sizes


SECOND = read_tree("VP[go left of]{NP[the second red one]}")


@pytest.fixture(scope="module")
def yard():
    """Log-odds of a few, so that nothing is certain."""
    vocabulary = build_vocabulary(list(SECOND.walk()))
    rng = np.random.default_rng(0)
    weights = {
        kind: rng.normal(size=(len(vocabulary.names), len(names))).astype(np.float32)
        for kind, names in COLUMNS.items()
    }
    return CorrespondenceGraph(SPACE, CorrespondenceModel(vocabulary, weights))


def test_symbols_of_several_kinds_are_searched_as_enumerated(yard):
    world = ("red", "blue")
    tree = yard.score(SECOND, world, clause=1)

    def log_odds(phrase, path, children):
        return tree.log_odds(path, tuple(children))

    exact = root_distribution(SECOND, log_odds, (1,))
    found = {one.expressed.tobytes(): one.log_probability for one in tree.search(64)}
    assert len(found) == 16
    for key, probability in exact.items():
        assert found.get(key, -np.inf) == pytest.approx(np.log(probability), abs=1e-6)
    noun = tree.log_odds((1, 0), ())
    assert np.isfinite(noun).tolist() == [True, True, False, False]


def test_ranks_are_a_choice_by_the_words_alone(yard):
    (noun,) = SECOND.children
    chance = yard.score(SECOND, WORLDS[0]).log_ranks()[(0, 0)]
    coefficients = yard.model.coefficients(noun)[RANKS]
    scores = np.exp([0.0, coefficients[0], coefficients.sum()])
    np.testing.assert_allclose(np.exp(chance), scores / scores.sum(), rtol=1e-6)
    beliefs = {one.path: one.rank for one in yard.score(SECOND, WORLDS[0]).beliefs()}
    assert beliefs[(0, 0)] == np.argmax(chance)


def test_examples_of_several_kinds():
    both = [frozenset({"at 0"}), frozenset({"left of 0"})]
    one = Labelled(root=SECOND, world=("red", "blue"), expressed=both, ranks=[2, 0])
    noun, verb = examples_of(SPACE, [one])
    assert noun.blocks["thing"].labels.tolist() == [True, False]
    assert noun.blocks[RANKS].labels.tolist() == [False, True]
    assert set(noun.blocks) == {"thing", RANKS}
    assert verb.blocks["side"].labels.tolist() == [True, False]
    assert verb.blocks["side"].properties.tolist() == [[1, 1], [1, 0]]
    assert not verb.blocks[RANKS].labels.any()
    with pytest.raises(ValueError, match=r"tree 0: 1 labels, but .* has 2 phrases"):
        examples_of(SPACE, [dataclasses.replace(one, ranks=[2])])


def test_the_engine_s_symbols_are_two_more_spaces():
    """One graph grounds and one function labels: annotations, and behaviors in worlds."""
    model = load_shipped()
    sentences = ("find the second car", "go to the tree then go to the bench behind the car")
    instructions = corpus(num_worlds=1, sentences=sentences)
    graph = CorrespondenceGraph(Annotations(TYPES), model.annotation)
    trees = [tree for one in instructions for tree in one.annotations]
    assert [tree.clause for tree in trees] == [0, 0, 1]
    assert all(is_right(graph, one) for one in trees)
    for one in instructions:
        behavior = CorrespondenceGraph(Behaviors(TYPES, one.rank), model.behavior)
        assert all(is_right(behavior, tree) for trees in one.behaviors for tree in trees)
    made = model_examples("annotation", instructions, TYPES)
    for mine, own in zip(examples_of(graph.space, trees), made, strict=True):
        assert mine.phrase == own.phrase
        for kind in (SYMBOLS, RANKS):
            for one, other in zip(mine.blocks[kind], own.blocks[kind], strict=True):
                np.testing.assert_array_equal(one, other)


phrases = st.recursive(
    st.builds(
        Phrase,
        label=st.sampled_from(["NP", "VP", "PP"]),
        words=st.lists(st.sampled_from(["the", "red", "left-of", "o'er"]), max_size=3).map(
            lambda words: tuple(Word(text=w, tag="", lemma=w) for w in words)
        ),
    ),
    lambda below: st.builds(
        Phrase,
        label=st.sampled_from(["NP", "VP", "S"]),
        words=st.just(()),
        children=st.lists(below, min_size=1, max_size=3).map(tuple),
    ),
    max_leaves=8,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(phrases)
def test_reading_a_tree_inverts_writing_it(phrase):
    found = read_tree(str(phrase))
    assert str(found) == str(phrase)
    assert [w.position for w in found.all_words()] == list(range(1, len(found.all_words()) + 1))


@pytest.mark.parametrize(
    "text", ["", "VP", "VP[a", "VP[a]{", "VP[a]{}", "VP[a]{NP[b]", "VP[a]NP[b]", "VP[a]}", "x[a]"]
)
def test_what_is_no_tree_is_refused(text):
    with pytest.raises(ValueError, match="no tree"):
        read_tree(text)


# ------------ search against enumeration, and the paper's numbers of symbols


def leaf(label="NP", *children):
    return Phrase(label=label, words=(), children=children)


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
    found = search(leaf(), lambda *_: np.asarray(odds), width=width)
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


SENTENCE = "go to the hydrant behind the cone"


@pytest.mark.parametrize(("text", "phrases"), [("go to the hydrant", 3), (SENTENCE, 6)])
@pytest.mark.parametrize("objects", [0, 1, 9])
def test_counts_follow_the_formula(text, phrases, objects):
    counts = count_factors(parse(text).clauses, BehaviorSpace(objects))
    assert counts["factors"] == (phrases - 1) * 8 * objects + 5 + 14 * objects
    assert counts["variables"] == phrases + 2 * counts["factors"]


def test_sets_and_members_are_inverse():
    space = AnnotationSpace(3)
    said = (object_symbol(1), region_symbol(4, ROBOT), relation_symbol(2, 0, 1))
    mask = space.mask(said)
    assert space.members(mask) == said
    objects, regions, relations = space.parts(mask)
    assert objects.tolist() == [False, True, False]
    assert np.argwhere(regions).tolist() == [[4, 3]]
    assert np.argwhere(relations).tolist() == [[2, 0, 1]]
