"""What sentences say and ask for, by the shipped models."""

import dataclasses

import numpy as np
import pytest
from grounding_fixture import zeroed_model

from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.annotation import describe_annotation, infer_annotations
from jaxlangnav.grounding.command_summary import summarize_commands
from jaxlangnav.grounding.readings import CapacityError, build_reading, to_readings, unpad_readings
from jaxlangnav.grounding.symbols import object_symbol, region_symbol, relation_symbol
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import AT, BEHIND, BETWEEN, LEFT, NEAR, NONE, RIGHT, ROBOT

HYDRANT, CONE, CAR, TREE = 0, 1, 2, 4


@pytest.mark.parametrize(
    "text",
    [
        "stay away from the nearest cone and go to the second cone",
        "go to the second cone but avoid the nearest cone",
    ],
)
def test_two_ranks_of_one_type_speak_of_two_things(model, text):
    """They were one thing, to be gone to and kept away from: the robot never got on."""
    found, score = unpad_readings(understand(text, model).instruction.readings)[0]
    assert found.mentions == (ROBOT, CONE, CONE)
    assert set(found.relations) == {(1, NEAR, 0, 1), (2, NEAR, 0, 2)}
    assert np.exp(score) > 0.9


def test_nested_relations_attach_to_the_inner_noun(model):
    found = understand("go to the hydrant behind the cone near the car", model).annotations
    said = {(a["figure"], a["relation"], a["landmark"]) for a in found if a["probability"] > 0.5}
    assert said == {("hydrant", "behind", "cone"), ("cone", "near", "car")}


def test_a_model_that_knows_nothing_finds_no_relation():
    understood = understand("go to the hydrant behind the cone", zeroed_model())
    assert not [a for a in understood.annotations if a["relation"] is not None]
    assert (np.asarray(understood.instruction.readings.relation) == NONE).all()


def reworded(text, old, /, **new):
    """Parse a sentence of one clause and put something else in place of a word."""
    tree = parse(text)

    def swap(phrase):
        words = (dataclasses.replace(w, **new) if w.lemma == old else w for w in phrase.words)
        children = tuple(map(swap, phrase.children))
        return Phrase(label=phrase.label, words=tuple(words), children=children)

    return dataclasses.replace(tree, clauses=(swap(tree.clauses[0]),))


@pytest.mark.parametrize(("old", "new"), [("hydrant", "zorbel"), ("behind", "abaft")])
def test_a_new_synonym_needs_no_retraining(model, old, new):
    renamed = reworded("go to the hydrant behind the cone", old, text=new, lemma=new)
    assert not any(new in name for name in model.annotation.vocabulary.names)
    belief = infer_annotations(renamed, model.annotation, model.type_names)
    (said, log_probability), *_ = belief.clauses
    assert said == (((relation_symbol(HYDRANT, BEHIND, CONE), 0),),)
    assert np.exp(log_probability) > 0.9


def test_a_word_without_senses_does_not_ground_everything(model):
    changed = reworded("go to the hydrant", "hydrant", text="zorbel", lemma="zorbel", senses=())
    belief = infer_annotations(changed, model.annotation, model.type_names)
    assert sum(p for _, _, p in belief.marginals()) < 0.5


def test_each_relation_can_be_grounded_given_the_earlier_ones():
    outer = (relation_symbol(HYDRANT, BEHIND, CONE), 0)
    inner = (relation_symbol(CONE, NEAR, CAR), 1)
    reading = build_reading((outer, inner))
    assert reading.mentions == (CAR, CONE, HYDRANT)
    assert reading.relations == ((1, NEAR, 0, True), (2, BEHIND, 1, False))


def test_things_of_one_type_are_one_thing():
    said = ((relation_symbol(HYDRANT, BEHIND, CONE), 0), (object_symbol(CONE), 0))
    assert build_reading(said).mentions == (CONE, HYDRANT)
    both = build_reading(((relation_symbol(CONE, NEAR, CONE), 0),))
    assert both.mentions == (CONE, CONE)


def test_a_region_without_a_figure_only_says_that_its_landmark_exists():
    reading = build_reading(((region_symbol(BEHIND, CONE), 0),))
    assert reading.mentions == (CONE,)
    assert reading.relations == ((0, NONE, NONE, False),)


def test_the_robot_is_a_landmark_and_ranks_are_kept():
    assert build_reading(((relation_symbol(CONE, NEAR, ROBOT), 1),)).mentions == (ROBOT, CONE)
    assert build_reading(((relation_symbol(CONE, NEAR, ROBOT), 2),)).relations == ((1, NEAR, 0, 2),)
    # The robot's side comes after what ties the cone to a hydrant, which may show where it is.
    reading = build_reading((said(HYDRANT, BEHIND, CONE), said(CONE, NEAR, ROBOT)))
    assert [one[2] for one in reading.relations] == [1, 0]


def said(figure, relation, landmark, rank=0):
    return (relation_symbol(figure, relation, landmark), rank)


@pytest.mark.parametrize(
    ("first", "second", "number"),
    [
        # "the cone on your left, then the one on your right", "the first, then the second": two
        ((said(CONE, LEFT, ROBOT),), (said(CONE, RIGHT, ROBOT),), 2),
        ((said(CONE, NEAR, ROBOT, 1),), (said(CONE, NEAR, ROBOT, 2),), 2),
        # no more is said of it, or more of the same: one
        ((said(CONE, LEFT, ROBOT),), ((object_symbol(CONE), 0),), 1),
        ((said(CONE, LEFT, ROBOT),), (said(HYDRANT, BEHIND, CONE),), 1),
        ((said(CONE, LEFT, ROBOT),), (said(CONE, LEFT, ROBOT),), 1),
        (((object_symbol(CONE), 0),), (said(CONE, LEFT, ROBOT),), 1),
    ],
)
def test_things_of_later_clauses(first, second, number):
    reading = build_reading(first, second)
    assert reading.mentions.count(CONE) == number
    assert reading.mentions.count(ROBOT) <= 1
    assert len(set(reading.relations)) == len(reading.relations)


BETWEEN_TWO = (said(HYDRANT, BETWEEN, CONE), said(HYDRANT, BETWEEN, CAR))


@pytest.mark.parametrize(
    ("clause", "mentions", "relations"),
    [
        (BETWEEN_TWO, (CONE, CAR, HYDRANT), [(2, 0), (2, 1)]),
        # of one type alone there are two; and the figure is a third
        ((said(HYDRANT, BETWEEN, CONE),), (CONE, CONE, HYDRANT), [(2, 0), (2, 1)]),
        ((said(CONE, BETWEEN, CONE),), (CONE, CONE, CONE), [(2, 0), (2, 1)]),
        (
            (said(CONE, BETWEEN, CONE), said(CONE, BETWEEN, CAR)),
            (CONE, CAR, CONE),
            [(2, 0), (2, 1)],
        ),
        # a landmark is placed first
        ((*BETWEEN_TWO, said(CAR, BEHIND, 4)), (4, CAR, CONE, HYDRANT), [(1, 0), (3, 2), (3, 1)]),
    ],
)
def test_what_lies_between_has_two_relations(clause, mentions, relations):
    reading = build_reading(clause)
    assert reading.mentions == mentions
    assert [one[::2][:2] for one in reading.relations] == relations
    if mentions.count(CONE) < 2:
        assert build_reading(clause, clause) == reading


@pytest.mark.parametrize(
    ("text", "landmarks"),
    [
        ("go to the hydrant between the cone and the car", {"cone", "car"}),
        ("find the hydrant that is in between the two trees", {"tree"}),
        ("the hydrant is between the box and the barrel. go to it", {"box", "barrel"}),
        ("go to the hydrant between the fountain and the cone near the car", {"fountain", "cone"}),
    ],
)
def test_between_is_read_as_its_two_relations(model, text, landmarks):
    """The trained graph has six relations: "between" is near either, and a pair."""
    understood = understand(text, model)
    told = [describe_annotation(*one, understood.names) for one in understood.belief.marginals()]
    between = [one for one in told if one["relation"] == "between" and one["probability"] > 0.05]
    assert {one["landmark"] for one in between if one["probability"] > 0.95} == landmarks
    assert {one["figure"] for one in between} == {"hydrant"}
    readings = understood.instruction.readings
    is_pair = np.asarray(readings.relation[0]) == BETWEEN
    assert is_pair.sum() == 2
    assert len(set(np.asarray(readings.landmark[0])[is_pair].tolist())) == 2


def test_too_much_is_refused(model):
    belief = understand("go to the hydrant", model).belief
    said = tuple((relation_symbol(t, NEAR, t + 1), 0) for t in range(6))
    crowded = dataclasses.replace(belief, clauses=(((said,), 0.0),))
    with pytest.raises(CapacityError, match="say less at once"):
        to_readings(crowded)


@pytest.fixture(scope="module")
def ask():
    model = load_shipped()

    def of(text: str):
        understood = understand(text, model)
        kinds = understood.instruction.readings.mention_type[0].tolist()
        names = (*understood.type_names, "nothing")
        found = summarize_commands(understood.instruction)
        return found, [names[kinds[one.mention] if one.mention >= 0 else NONE] for one in found]

    return of


def test_commands_and_what_to_keep_away_from(ask) -> None:
    found, goals = ask("go to the hydrant behind the cone and avoid the car, then find the bench")
    assert goals == ["hydrant", "bench"]
    assert [one.action for one in found] == ["navigate", "find"]
    assert [one.region for one in found] == [AT, AT]
    assert [len(one.avoid) for one in found] == [1, 0]
    assert found[0].avoid[0][0] == NEAR
    # The hydrant is placed against the cone; the car and the bench are no business of its.
    assert [len(one.landmarks) for one in found] == [1, 0]
    found, goals = ask("go to the hydrant between the cone and the car")
    assert (goals, len(found[0].landmarks)) == (["hydrant"], 2)


@pytest.mark.parametrize("rank", ["second", "third", "fourth"])
def test_a_thing_of_a_rank_is_the_goal(ask, rank: str) -> None:
    (command,), goals = ask(f"go to the {rank} cone from the right")
    assert goals == ["cone"]
    assert command.probability > 0.9


def test_a_region_and_a_manner(ask) -> None:
    found, goals = ask("carefully move behind the cone")
    assert goals == ["cone"]
    assert found[0].region == BEHIND
    assert found[0].mode == "carefully"


def test_the_other_one_is_none_that_was_named(ask) -> None:
    _, goals = ask("go to the cone, then go to the other cone")
    assert goals == ["cone", "nothing"]
