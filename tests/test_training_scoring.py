"""Many models scored at once, against one model and one sentence at a time."""

import dataclasses

import numpy as np
import pytest
from grounding_fixture import TYPES, corpus

from jaxlangnav.grounding import load_shipped
from jaxlangnav.grounding.annotation import infer_annotations
from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.training.scoring import Models, score_annotations, score_behaviors

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
        weighed = graph.weigh(tree.root, tree.world, tree.clause)
        best = weighed.search(width)[0]
        right &= bool((best.expressed == weighed.symbols.mask(tree.expressed[-1])).all())
        confidence *= np.exp(best.log_probability)
    return right, confidence


def alone_behaviors(annotation, model, labelled, width):
    """The same, a row for each world."""
    space = Behaviors(TYPES, infer_annotations(labelled.parse, annotation, TYPES).rank)
    return [alone(space, model, trees, width) for trees in labelled.behaving]


def test_each_of_many_models_is_scored_as_alone(instructions, models):
    """Sentences that a model is not tested on are left out of its own results alone."""
    stacked = [Models.of(one) for one in models]
    widths = (4, 1)
    found = (
        score_annotations(instructions, stacked[0], IS_TESTED, TYPES, widths=widths),
        score_behaviors(instructions, *stacked, IS_TESTED, TYPES, widths=widths),
    )
    for width in widths:
        for k, (annotation, behavior) in enumerate(zip(*models, strict=True)):
            tested = [instructions[i] for i in np.flatnonzero(IS_TESTED[k])]
            wanted = (
                [alone(Annotations(TYPES), annotation, one.annotated, width) for one in tested],
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
    annotation, behavior = (Models.of(one) for one in models)
    for wrong, said in ((IS_TESTED[:2], "shape"), (IS_TESTED.astype(float), "type")):
        with pytest.raises(AssertionError, match=said):
            score_annotations(instructions, annotation, wrong, TYPES, widths=(4,))
        with pytest.raises(AssertionError, match=said):
            score_behaviors(instructions, annotation, behavior, wrong, TYPES, widths=(4,))
