"""Symbol spaces and factor graphs: the paper's numbers, from constructed objects."""

import numpy as np
import pytest

from jaxlangnav.grounding.symbols import (
    CONSTRAINT,
    GOAL,
    MODE,
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


def test_graphs_of_the_six_phrase_sentence():
    tree = parse(SENTENCE).clauses
    annotation, behavior = (
        count_graph(tree, AnnotationSpace(8)),
        count_graph(tree, BehaviorSpace(7)),
    )
    assert annotation == {"phrases": 6, "factors": 2964, "variables": 5934}
    assert behavior == {"phrases": 6, "factors": 383, "variables": 772}


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


def test_parts_of_a_behavior_set_agree_with_its_symbols():
    space = BehaviorSpace(4)
    for kind in (OBJECT, REGION, MODE, GOAL, CONSTRAINT):
        mask = space.mask(s for s in space.symbols if s.kind == kind)
        assert space.part(mask, kind).all()
        assert mask.sum() == space.part(mask, kind).size
