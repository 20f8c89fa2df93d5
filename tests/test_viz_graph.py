"""The factor graph of a sentence: counts of the paper, probabilities of the trained model."""

import numpy as np
import pytest
from matplotlib.patches import Wedge

from jaxlangnav.grounding import load_shipped, understand_parse
from jaxlangnav.grounding.symbols import AnnotationSpace, region_symbol, relation_symbol
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import BEHIND, NEAR, ROBOT
from jaxlangnav.viz.graph import _phrase_beliefs, _symbol_name, graph_figure
from jaxlangnav.viz.html import write_graph

PAPER = "go to the hydrant behind the cone"


@pytest.fixture(scope="module")
def model():
    return load_shipped()


def test_the_paper_s_sentence(model):
    figure = graph_figure(parse(PAPER), model)
    said = " ".join(text.get_text() for text in figure.texts)
    assert all(one in said for one in ("2,964 factors", "5,934 random variables", PAPER))
    # Phrases in reading order.
    beliefs = _phrase_beliefs(parse(PAPER), model)
    assert [one.phrase.label for one in beliefs] == ["VP", "PP", "NP", "NP", "PP", "NP"]
    assert [one.parent for one in beliefs[:3]] == [None, (0,), (0, 0)]


def test_probabilities_agree_with_annotation_inference(model):
    tree = parse(PAPER)
    space = AnnotationSpace(len(model.type_names))
    root = _phrase_beliefs(tree, model)[0].probability
    said = understand_parse(tree, model).annotations[0]
    index = space.index[relation_symbol(0, BEHIND, 1)]
    assert said["relation"] == "behind"
    # The figure conditions on the likeliest groundings of the children; inference sums over all.
    assert root[index] >= said["probability"] - 1e-6
    assert np.argmax(root) == index
    assert ((root >= 0) & (root <= 1)).all()


def test_an_untrained_model_knows_nothing_but_superlatives(model):
    parsed = parse("go to the hydrant nearest to the cone")
    for one in _phrase_beliefs(parsed, model.zeroed()):
        assert one.probability == pytest.approx(np.full(494, 0.5))
    assert max(one.rank for one in _phrase_beliefs(parsed, model)) == 1


@pytest.mark.parametrize("number", [1, 3, 5])
def test_every_phrase_shows_its_likeliest_symbols(model, number):
    figure = graph_figure(parse("go to the hydrant"), model, num_symbols=number)
    squares = [line for line in figure.axes[0].lines if line.get_marker() == "s"]
    assert len(squares) == 3 * number + 1  # and one in the key
    wedges = [patch for patch in figure.axes[0].patches if isinstance(patch, Wedge)]
    full = [one for one in wedges if one.theta2 - one.theta1 > 350]
    assert len(full) == 3  # each phrase is sure of one symbol


def test_no_symbols_are_refused(model):
    with pytest.raises(ValueError, match="num_symbols is 0"):
        graph_figure(parse("go to the hydrant"), model, num_symbols=0)


def test_symbol_names():
    types = load_shipped().type_names
    assert _symbol_name(relation_symbol(0, BEHIND, 1), types) == "hydrant behind cone"
    assert _symbol_name(region_symbol(NEAR, ROBOT), types) == "near robot"


def test_it_is_written(model, tmp_path):
    paths = write_graph(parse(PAPER), model, tmp_path)
    assert [path.name for path in paths] == ["graph.png", "graph.svg"]
    assert all(path.stat().st_size > 1000 for path in paths)
