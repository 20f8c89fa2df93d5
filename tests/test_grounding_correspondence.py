"""The correspondence graph with someone else's symbols and the engine's, and trees as text."""

import dataclasses
from types import MappingProxyType

import numpy as np
import pytest
from grounding_fixture import TYPES, corpus
from hypothesis import HealthCheck, given, settings, strategies as st
from matplotlib.patches import Wedge
from oracles.dcg import root_distribution

from jaxlangnav.grounding import load_shipped
from jaxlangnav.grounding.correspondence import (
    KIND,
    RANK,
    Block,
    CorrespondenceGraph,
    Described,
    Labelled,
    read_tree,
)
from jaxlangnav.grounding.model import CorrespondenceModel, build_vocabulary
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.symbols import Symbols, count_graph
from jaxlangnav.language.phrase import Phrase, Word
from jaxlangnav.training import train_graph
from jaxlangnav.training.examples import annotation_examples, examples_of
from jaxlangnav.training.fit import TrainingConfig
from jaxlangnav.viz.graph import beliefs_figure

COLOURS = ("red", "blue", "green")


class Blocks:
    """Coloured blocks in a row; a world is a tuple of colours."""

    columns = MappingProxyType({KIND: ("bias", *COLOURS, "meant", "left of meant", "last")})

    def symbols_in(self, world):
        return Symbols([f"{colour} block {i}" for i, colour in enumerate(world)])

    def describe(self, phrase, path, world):
        def given(children):
            return {KIND: Block(slice(None), self.properties(children, world))}

        return Described(given)

    def properties(self, children, world):
        meant = np.any([*children, np.zeros(len(world), bool)], axis=0)
        beside = np.append(meant[1:], False)
        last = np.arange(len(world)) == len(world) - 1
        own = [[colour == one for one in COLOURS] for colour in world]
        return np.column_stack([np.ones(len(world)), own, meant, beside, last])


SPACE = Blocks()
WORLDS = (("red", "blue", "green"), ("blue", "red"), ("green", "blue", "red", "red"))


def labelled():
    """Sentences "take the red one" and "take what is left of the red one" in all worlds."""
    found = []
    for world in WORLDS:
        for colour in COLOURS:
            own = {i for i, one in enumerate(world) if one == colour}
            beside = {i - 1 for i in own if i > 0}
            for text, steps in (
                (f"VP[take]{{NP[the {colour} one]}}", [own, own]),
                (f"VP[take]{{PP[left of]{{NP[the {colour} one]}}}}", [own, beside, beside]),
            ):
                names = SPACE.symbols_in(world).symbols
                expressed = [frozenset(names[i] for i in step) for step in steps]
                found.append(Labelled(root=read_tree(text), world=world, expressed=expressed))
    return found


def is_right(graph, one):
    """Whether the likeliest set at the root is exactly the labelled one."""
    tree = graph.weigh(one.root, one.world, one.clause)
    return set(tree.symbols.members(tree.search()[0].expressed)) == one.expressed[-1]


@pytest.fixture(scope="module")
def graph():
    return train_graph(SPACE, labelled(), config=TrainingConfig(l2=0.003))[0]


def test_own_symbols_are_learned(graph):
    assert all(is_right(graph, one) for one in labelled())
    world = ("green", "green", "red", "blue")  # never seen
    best = graph.ground(read_tree("VP[take]{PP[left of]{NP[the red one]}}"), world)[0]
    assert best.symbols == ("green block 1",)
    assert best.probability > 0.5


def test_beliefs_are_those_of_the_likeliest_reading(graph):
    root, world = read_tree("VP[take]{NP[the blue one]}"), WORLDS[0]
    top, below = graph.weigh(root, world).beliefs()
    assert below.parent == top.path
    assert (below.probability > 0.5).tolist() == [False, True, False]
    meant = below.probability > 0.5
    odds = SPACE.properties([meant], world) @ graph.model.coefficients(root)[KIND]
    np.testing.assert_allclose(top.probability, 1 / (1 + np.exp(-odds)), rtol=1e-5)


def test_a_picture_of_own_symbols(graph):
    root, world = read_tree("VP[take]{NP[the blue one]}"), WORLDS[0]
    figure = beliefs_figure(
        graph.weigh(root, world).beliefs(),
        SPACE.symbols_in(world).symbols,
        title="take the blue one",
        num_symbols=2,
    )
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts.count("blue block 1") == 2
    assert "1 more" in texts
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

    class Short(Blocks):
        columns = MappingProxyType({KIND: ("bias",)})

    with pytest.raises(ValueError, match=r"properties are \(3, 7\), but must be \(3, 1\)"):
        examples_of(Short(), [good])


def test_factors_of_own_symbols_are_counted():
    root = read_tree("VP[take]{PP[left of]{NP[the red one]}}")
    sizes = {"phrases": 3, "factors": 3 * 4, "variables": 3 + 2 * 3 * 4}
    assert count_graph([root], SPACE.symbols_in(WORLDS[2])) == sizes


# ---------------------------------------------------------------- symbols of several kinds


COLUMNS = {"thing": ("bias", *COLOURS, "meant"), "side": ("bias", "meant"), RANK: ("bias", "is")}


class Yard:
    """Things and their left sides, ranks too; a noun phrase expresses things alone."""

    columns = MappingProxyType(COLUMNS)

    def symbols_in(self, world):
        return Symbols([f"{what} {i}" for what in ("at", "left of") for i in range(len(world))])

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
    return CorrespondenceGraph(Yard(), CorrespondenceModel(vocabulary, weights))


def test_symbols_of_several_kinds_are_searched_as_enumerated(yard):
    world = ("red", "blue")
    tree = yard.weigh(SECOND, world, clause=1)

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
    chance = yard.weigh(SECOND, WORLDS[0]).log_ranks()[(0, 0)]
    coefficients = yard.model.coefficients(noun)[RANK]
    scores = np.exp([0.0, coefficients[0], coefficients.sum()])
    np.testing.assert_allclose(np.exp(chance), scores / scores.sum(), rtol=1e-6)
    beliefs = {one.path: one.rank for one in yard.weigh(SECOND, WORLDS[0]).beliefs()}
    assert beliefs[(0, 0)] == np.argmax(chance)


def test_examples_of_several_kinds():
    both = [frozenset({"at 0"}), frozenset({"left of 0"})]
    one = Labelled(root=SECOND, world=("red", "blue"), expressed=both, ranks=[2, 0])
    noun, verb = examples_of(Yard(), [one])
    assert noun.rows["thing"].labels.tolist() == [True, False]
    assert noun.rows[RANK].labels.tolist() == [False, True]
    assert set(noun.rows) == {"thing", RANK}
    assert verb.rows["side"].labels.tolist() == [True, False]
    assert verb.rows["side"].properties.tolist() == [[1, 1], [1, 0]]
    assert not verb.rows[RANK].labels.any()
    with pytest.raises(ValueError, match=r"tree 0: 1 labels, but .* has 2 phrases"):
        examples_of(Yard(), [dataclasses.replace(one, ranks=[2])])


def test_the_engine_s_symbols_are_two_more_spaces():
    """One graph grounds and one function labels: annotations, and behaviors in worlds."""
    model = load_shipped()
    sentences = ("find the second car", "go to the tree then go to the bench behind the car")
    instructions = corpus(num_worlds=1, sentences=sentences)
    graph = CorrespondenceGraph(Annotations(TYPES), model.annotation)
    trees = [tree for one in instructions for tree in one.annotated]
    assert [tree.clause for tree in trees] == [0, 0, 1]
    assert all(is_right(graph, one) for one in trees)
    for one in instructions:
        behavior = CorrespondenceGraph(Behaviors(TYPES, one.rank), model.behavior)
        assert all(is_right(behavior, tree) for trees in one.behaving for tree in trees)
    made = annotation_examples(instructions, TYPES)
    for mine, own in zip(examples_of(graph.space, trees), made, strict=True):
        assert mine.phrase == own.phrase
        for kind in (KIND, RANK):
            for one, other in zip(mine.rows[kind], own.rows[kind], strict=True):
                np.testing.assert_array_equal(one, other)


# ---------------------------------------------------------------- trees as text

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
