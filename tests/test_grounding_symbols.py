"""Symbol spaces and factor graphs: the paper's numbers, from constructed objects."""

import numpy as np
import pytest

from jaxlangnav.grounding.graph import bottom_up, build
from jaxlangnav.grounding.symbols import (
    CONSTRAINT,
    GOAL,
    MODE,
    OBJECT,
    REGION,
    RELATION,
    AnnotationSpace,
    BehaviorSpace,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import ROBOT

SENTENCE = "go to the hydrant behind the cone"


def test_annotation_space_has_the_papers_size():
    space = AnnotationSpace(8)
    kinds = [symbol.kind for symbol in space.symbols]
    assert [kinds.count(k) for k in (OBJECT, REGION, RELATION)] == [8, 54, 432]
    assert space.size == len(space.symbols) == len(set(space.symbols)) == 494


def test_behavior_space_has_the_papers_size():
    space = BehaviorSpace(7)
    assert space.num_noun == 7 + 49
    assert space.num_verb == 2 + 3 + 49 + 49
    assert space.size == len(set(space.symbols)) == 56 + 103


def test_graphs_of_the_six_phrase_sentence():
    tree = parse(SENTENCE).clauses
    annotation, behavior = build(tree, AnnotationSpace(8)), build(tree, BehaviorSpace(7))
    assert annotation.count() == {"phrases": 6, "factors": 2964, "variables": 5934}
    assert behavior.count() == {"phrases": 6, "factors": 383, "variables": 772}


@pytest.mark.parametrize(("text", "phrases"), [("go to the hydrant", 3), (SENTENCE, 6)])
@pytest.mark.parametrize("objects", [0, 1, 9])
def test_counts_follow_the_formula(text, phrases, objects):
    graph = build(parse(text).clauses, BehaviorSpace(objects))
    assert graph.num_factors == (phrases - 1) * 8 * objects + 5 + 14 * objects
    assert graph.num_variables == phrases + 2 * graph.num_factors


def test_clauses_share_no_factor():
    tree = parse("go to the cone then go to the hydrant").clauses
    graph = build(tree, AnnotationSpace(8))
    assert graph.count()["factors"] == 6 * 494
    for factor in graph.factors:
        clauses = {graph.nodes[i].path[0] for i in (factor.node, *factor.children)}
        assert len(clauses) == 1


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
    with pytest.raises(ValueError, match="relation"):
        space.span(RELATION)
