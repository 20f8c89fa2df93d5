"""The corpus as training data, and the measures taken on it."""

import dataclasses

import numpy as np
import pytest
from grounding_fixture import TYPES, corpus

from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.annotation import infer_annotations
from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.properties import Annotations, Behaviors, find_ranks
from jaxlangnav.grounding.symbols import (
    ACTION,
    CONSTRAINT,
    GOAL,
    MODE,
    BehaviorSymbol,
    object_symbol,
    post_order,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.inputs.object_types import MAX_LABELS
from jaxlangnav.language.corpus import load_corpus
from jaxlangnav.messages import AT, BEHIND, LEFT, NEAR, NONE, ROBOT
from jaxlangnav.training.examples import (
    labelled_instruction,
    model_examples,
    read_annotation,
    read_behavior,
)
from jaxlangnav.training.scoring import Scorer


def test_symbols_are_read_by_name():
    assert read_annotation("object(cone)", TYPES) == object_symbol(1)
    assert read_annotation("region(left,robot)", TYPES) == region_symbol(LEFT, ROBOT)
    assert read_annotation("relation(hydrant,behind,cone)", TYPES) == relation_symbol(0, BEHIND, 1)
    assert read_behavior("goal(at,3)", 5) == BehaviorSymbol(GOAL, AT, 3)
    assert read_behavior("goal(left,robot)", 5) == BehaviorSymbol(GOAL, LEFT, 5)
    assert read_behavior("constraint(near,2)", 5) == BehaviorSymbol(CONSTRAINT, NEAR, 2)
    assert read_behavior("action(find)", 5) == BehaviorSymbol(ACTION, NONE, 1)
    assert read_behavior("mode(carefully)", 5) == BehaviorSymbol(MODE, NONE, 2)


def test_labels_stand_at_their_phrases():
    (labelled,) = corpus(sentences=("go to the car behind the tree",))
    car, tree = TYPES.index("car"), TYPES.index("tree")
    (clause,) = labelled.annotations
    expressed = dict(zip([n.path for n in post_order(clause.root)], clause.expressed, strict=True))
    assert expressed[(0,)] == {relation_symbol(car, BEHIND, tree)}
    assert expressed[(0, 0, 0, 0)] == {object_symbol(car)}
    assert expressed[(0, 0, 0, 1)] == {region_symbol(BEHIND, tree)}
    assert len(labelled.behaviors) == 3


def test_statements_have_no_behavior():
    (labelled,) = corpus(sentences=("the barrel is behind the bench",))
    assert not any(labelled.behaviors)
    assert model_examples("behavior", [labelled], TYPES) == []
    assert len(model_examples("annotation", [labelled], TYPES)) == 4


def test_ranks_pass_up():
    (labelled,) = corpus(sentences=("go to the box that is nearest to the cone",))
    clause = labelled.parse.clauses[0]
    place = clause.children[0].children[0].children[1]
    assert place.label == "SBAR"
    assert find_ranks(place, (0, 0, 0, 1), labelled.rank, TYPES)[NEAR] == 1
    noun = clause.children[0].children[0].children[0]
    assert find_ranks(noun, (0, 0, 0, 0), {}, TYPES).sum() == 0


def test_ranks_of_a_landmark_stay_below():
    (labelled,) = corpus(sentences=("go to the box near the second cone",))
    place = labelled.parse.clauses[0].children[0].children[0].children[1]
    path = (0, 0, 0, 1)
    assert place.words[0].text == "near"
    assert find_ranks(place, path, labelled.rank, TYPES).sum() == 0
    ordinal = place.children[0].children[1]
    assert find_ranks(ordinal, (*path, 0, 1), labelled.rank, TYPES)[NEAR] == 2


def test_each_factor_is_an_example():
    instructions = corpus(num_worlds=1, sentences=("go to the car",))
    examples = model_examples("annotation", instructions, TYPES)
    assert [len(e.blocks["symbol"].labels) for e in examples] == [494] * 3
    slots = len(instructions[0].behaviors[0][0].world.object_type)
    examples = model_examples("behavior", instructions, TYPES)
    sizes = [sum(len(block.labels) for block in it.blocks.values()) for it in examples]
    assert sizes == [8 * slots, 8 * slots, 5 + 14 * slots]


@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
def test_what_is_held_out_is_grounded_right(every):
    model = load_shipped()
    held_out = [example for example in load_corpus() if example.split == "test"][::every]
    instructions = [labelled_instruction(example, TYPES) for example in held_out]
    both = [[one] for one in (model.annotation, model.behavior)]
    scorer = Scorer(instructions, TYPES)
    annotation, behavior = scorer.annotations(both[0]), scorer.behaviors(*both)
    annotation, behavior = (results.by_width[4][0] for results in (annotation, behavior))
    assert annotation.accuracy > 0.995
    assert behavior.accuracy > 0.995
    assert ((annotation.confidence > 0) & (annotation.confidence <= 1 + 1e-9)).all()
    # Ranks are summed out and gold may be the answer given, so log_gold ≤ log confidence there.
    right = annotation.is_right
    assert np.abs(annotation.log_gold - np.log(annotation.confidence))[right].max() < 1e-9


def test_more_types_than_a_program_holds_are_refused():
    model = load_shipped()
    names = (*TYPES, *(f"kind{number}" for number in range(MAX_LABELS)))
    crowded = dataclasses.replace(model, type_names=names)
    with pytest.raises(ValueError, match=f"give 1 to {MAX_LABELS - 1} names"):
        understand("go to the hydrant", crowded)


SENTENCES = (
    "go to the second box near the tree",
    "find the car",
    "go to the box that is behind the car",
)
IS_TESTED = np.array([[True, True, True], [True, False, True], [True, True, True]])


@pytest.fixture(scope="module")
def instructions():
    return corpus(num_worlds=2, sentences=SENTENCES)


@pytest.fixture(scope="module")
def models():
    """The shipped model, one that is unsure, and one that is wrong about ranks and more."""
    shipped = load_shipped()
    rng = np.random.default_rng(0)

    def blurred(model):
        noise = {k: w + rng.normal(0, 2.5, w.shape) * (w != 0) for k, w in model.weights.items()}
        weights = {kind: weight.astype(np.float32) for kind, weight in noise.items()}
        return dataclasses.replace(model, weights=weights)

    def three(model):
        return model, dataclasses.replace(model, temperature=6.0), blurred(model)

    return three(shipped.annotation), three(shipped.behavior)


def alone(space, model, trees, width):
    """Right, and how confident: the best sets of one search for each clause."""
    graph, right, confidence = CorrespondenceGraph(space, model), True, 1.0
    for tree in trees:
        weighed = graph.score(tree.root, tree.world, tree.clause)
        best = weighed.search(width)[0]
        right &= bool((best.expressed == weighed.symbols.mask(tree.expressed[-1])).all())
        confidence *= np.exp(best.log_probability)
    return right, confidence


def alone_behaviors(annotation, model, labelled, width):
    space = Behaviors(TYPES, infer_annotations(labelled.parse, annotation, TYPES).rank)
    return [alone(space, model, trees, width) for trees in labelled.behaviors]


def test_each_of_many_models_is_scored_as_alone(instructions, models):
    """Sentences that a model is not tested on are left out of its own results alone."""
    widths = (4, 1)
    scorer = Scorer(instructions, TYPES, IS_TESTED, widths=widths)
    found = scorer.annotations(models[0]), scorer.behaviors(*models)
    for width in widths:
        for k, (annotation, behavior) in enumerate(zip(*models, strict=True)):
            tested = [instructions[i] for i in np.flatnonzero(IS_TESTED[k])]
            wanted = (
                [alone(Annotations(TYPES), annotation, one.annotations, width) for one in tested],
                [
                    row
                    for one in tested
                    for row in alone_behaviors(annotation, behavior, one, width)
                ],
            )
            for results, rows in zip(found, wanted, strict=True):
                scores = results.by_width[width][k]
                right, confidence = zip(*rows, strict=True)
                np.testing.assert_array_equal(scores.is_right, right)
                # A few hundred factors, log-odds of tens rounded in float32: 1e-6 each.
                np.testing.assert_allclose(scores.confidence, confidence, rtol=1e-3)
    assert found[0].by_width[4][0].is_right.all()
    assert found[1].by_width[4][0].is_right.all()
    assert not all(results.by_width[4][2].is_right.all() for results in found)


def test_a_mask_of_other_models_or_sentences_is_refused(instructions, models):
    annotation, behavior = models
    for wrong, said in ((IS_TESTED[:2], "shape"), (IS_TESTED.astype(float), "type")):
        with pytest.raises(AssertionError, match=said):
            Scorer(instructions, TYPES, wrong).annotations(annotation)
        with pytest.raises(AssertionError, match=said):
            Scorer(instructions, TYPES, wrong).behaviors(annotation, behavior)
