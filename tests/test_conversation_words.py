"""What an utterance is taken for, how words are joined, and which type a noun is everywhere."""

from collections.abc import Sequence

import numpy as np
import pytest
import readings as by_hand

from jaxlangnav import Navigator
from jaxlangnav.dialogue import discourse_of, merge_utterance
from jaxlangnav.dialogue.memory import AVOID_ALL, AVOID_IT
from jaxlangnav.grounding import Context, GraphGrounder, Grounded, load_shipped, understand
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import pad_instruction
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.language.utterance import Kind, Wording, classify
from jaxlangnav.messages import BEHIND, BETWEEN, LEFT, NEAR, NONE, ROBOT
from jaxlangnav.pytree import replace
from jaxlangnav.world.files import world_from_dict

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR


@pytest.mark.parametrize(
    ("text", "kind", "wording", "rest"),
    [
        ("no, the other one", Kind.CORRECTION, Wording.OTHER, ""),
        ("Wait! Not that one, please.", Kind.CORRECTION, Wording.OTHER, ""),
        ("no", Kind.CORRECTION, Wording.OTHER, ""),
        ("closer", Kind.CORRECTION, Wording.CLOSER, ""),
        ("Come back, please", Kind.RETURN, Wording.RETURN, ""),
        ("not that one, the one on the left", Kind.CORRECTION, None, "the one on the left"),
        ("and after that, go to the cone", Kind.ADDITION, None, "go to the cone"),
        ("then stop behind it", Kind.ADDITION, None, "stop behind it"),
        ("stop", Kind.HALT, None, ""),
        ("never mind", Kind.CANCEL, None, ""),
        ("go to the other hydrant", None, None, "go to the other hydrant"),
        ("the left one", None, None, "the left one"),
        ("", None, None, ""),
    ],
)
def test_wordings(text: str, kind, wording, rest: str) -> None:
    said = classify(text)
    assert (said.kind, said.wording, said.rest) == (kind, wording, rest)


@pytest.mark.parametrize(
    ("text", "wording"),
    [
        ("the left one, please", Wording.LEFT),
        ("the fourth one", Wording.FOURTH),
        ("number 5", Wording.FIFTH),
        ("no", Wording.NO),
        ("yes", Wording.YES),
        ("it doesn't matter", Wording.ANY),
    ],
)
def test_answers_are_answers_only_to_a_question(text: str, wording: Wording) -> None:
    said = classify(text, is_asked=True)
    assert (said.kind, said.wording) == (Kind.ANSWER, wording)
    assert classify(text).kind != Kind.ANSWER


def test_halting_wins_over_a_question() -> None:
    for text in ("stop", "wait", "freeze, please"):
        assert classify(text, is_asked=True).kind == Kind.HALT


class Talk:
    """Utterances joined one after the other, by the trained graph."""

    def __init__(self, text: str, labels: Sequence[str] | None = None) -> None:
        self.grounder = GraphGrounder(load_shipped(), labels)
        grounded = self.ground(text)
        wide = pad_instruction(grounded.instruction, Capacity())
        self.readings, self.words = wide.readings, discourse_of(wide, grounded.spoken)
        self.joined = None

    def ground(self, text: str) -> Grounded:
        return self.grounder.ground(text, Context(is_under_way=True))

    def say(self, text: str, **how: bool) -> "Talk":
        new = self.ground(text)
        how = {"is_new_task": False, "is_loose": True} | how
        self.joined = merge_utterance(self.readings, self.words, new.instruction, new.spoken, **how)
        self.readings, self.words = self.joined.instruction.readings, self.joined.words
        return self

    @property
    def kinds(self) -> list[int]:
        return [int(kind) for kind in self.readings.mention_type[0] if kind != NONE]

    @property
    def said(self) -> set[tuple[int, int, int]]:
        """Relations of the likeliest reading; mentions by number."""
        table = (self.readings.figure, self.readings.relation, self.readings.landmark)
        rows = np.stack([np.asarray(leaf)[0] for leaf in table], axis=1)
        return {tuple(row) for row in rows.tolist() if row[0] != NONE}


def test_a_statement_speaks_of_the_thing_of_the_task() -> None:
    talk = Talk("go to the hydrant behind the cone")
    talk.say("the hydrant is near the car", is_asked=False)
    hydrant, cone, car = (talk.kinds.index(kind) for kind in (HYDRANT, CONE, CAR))
    assert len(talk.kinds) == 3
    assert talk.said == {(hydrant, BEHIND, cone), (hydrant, NEAR, car)}
    # The goal hangs on the car now, too.
    assert np.asarray(talk.words.is_asked)[0, :3].all()
    assert bool(talk.words.is_pinned[0, 0])


def test_another_one_is_another_thing() -> None:
    talk = Talk("go to the hydrant behind the cone").say("there is a hydrant near the car")
    assert talk.kinds.count(HYDRANT) == 2
    talk = Talk("go to the hydrant").say("go to the other hydrant", is_new_task=True)
    assert talk.kinds.count(HYDRANT) == 2
    goal = int(talk.joined.new_goal[0, 0])
    asked = np.asarray(talk.words.is_asked)[0]
    assert asked[goal]
    assert asked.sum() == 1


def test_what_was_said_is_not_said_twice() -> None:
    talk = Talk("go to the hydrant").say("there is a hydrant").say("there is a hydrant")
    assert talk.kinds == [HYDRANT]
    assert talk.said == {(0, NONE, NONE)}
    talk.say("the hydrant is behind the cone")
    assert all(relation == BEHIND for _, relation, _ in talk.said)


def test_a_new_task_asks_for_nothing_else() -> None:
    talk = Talk("go to the hydrant behind the cone").say("go to the car", is_new_task=True)
    asked = np.asarray(talk.words.is_asked)[0, : len(talk.kinds)]
    assert [kind for kind, one in zip(talk.kinds, asked, strict=True) if one] == [CAR]
    assert len(talk.kinds) == 3


def test_constraints_mark_what_is_avoided() -> None:
    talk = Talk("go to the hydrant").say("avoid the cone and the car", is_asked=False)
    avoid = dict(zip(talk.kinds, np.asarray(talk.words.avoid)[0].tolist(), strict=False))
    assert avoid == {HYDRANT: 0, CONE: AVOID_ALL, CAR: AVOID_ALL}
    talk = Talk("go to the hydrant").say("avoid the cone behind the car", is_asked=False)
    avoid = dict(zip(talk.kinds, np.asarray(talk.words.avoid)[0].tolist(), strict=False))
    assert avoid == {HYDRANT: 0, CONE: AVOID_IT, CAR: 0}
    assert not np.asarray(talk.words.is_asked)[0, talk.kinds.index(CONE)]


def test_the_robot_is_one_thing_and_its_sides_are_where_it_was() -> None:
    talk = Talk("go to the cone on your left").say("the cone on your left is near the car")
    assert talk.kinds.count(ROBOT) == 1
    # "On your left" said from elsewhere may be said of another cone.
    assert talk.kinds.count(CONE) == 2
    assert sum(relation == LEFT for _, relation, _ in talk.said) == 2


def test_neither_goal_nor_what_is_avoided_is_ever_dropped() -> None:
    talk = Talk("go to the bench").say("avoid the cone", is_asked=False)
    for side in ("left of", "behind", "in front of", "near", "right of"):
        for thing in ("hydrant", "barrel"):
            talk.say(f"the {thing} is {side} the car", is_asked=False)
    assert len(talk.said) == Capacity().num_relations
    assert CONE in talk.kinds
    assert int(talk.words.goal[0, 0]) != NONE
    assert int(talk.words.num_dropped) > 0


def test_between_is_dropped_as_a_whole() -> None:
    talk = Talk("go to the bench").say("the box is between the car and the tree", is_asked=False)
    for side in ("left of", "behind", "in front of", "near", "right of"):
        talk.say(f"the hydrant is {side} the barrel", is_asked=False)
        talk.say(f"the cone is {side} the building", is_asked=False)
        assert (np.asarray(talk.readings.relation[0]) == BETWEEN).sum() in (0, 2)
    assert (np.asarray(talk.readings.relation[0]) == BETWEEN).sum() == 0


@pytest.mark.parametrize(
    "text",
    [
        "go to the cone between the cone and the tree",
        "go to the bench between the two trees",
        "go to the cone behind the cone",
    ],
)
def test_of_one_type_said_again_nothing_changes_places(text: str) -> None:
    talk = Talk(text)
    kinds, said, goal = talk.kinds, set(talk.said), int(talk.words.goal[0, 0])
    talk.say(text)
    assert talk.kinds == kinds
    assert talk.said == said
    is_between = np.asarray(talk.readings.relation[0]) == BETWEEN
    assert is_between.sum() == (2 if "between" in text else 0)
    assert int(talk.words.goal[0, 0]) == goal


def test_what_lies_between_one_of_its_type_and_another_is_gone_to() -> None:
    talk = Talk("the cone is between the cone and the tree. go to the cone")
    assert talk.kinds.count(CONE) == 2
    assert {figure for figure, _, _ in talk.said} == {int(talk.words.goal[0, 0])}


def test_doubts_multiply() -> None:
    readings = by_hand.readings(
        [[HYDRANT], [CONE]], [[(0, NONE, NONE, False)]] * 2, [0.7, 0.3], sizes=(4, 10, 8)
    )
    grounded = Talk("go to the car")
    told = replace(grounded.ground("go to the car").instruction, readings=readings)
    joined = merge_utterance(
        pad_instruction(told, Capacity()).readings, discourse_of(told, None),
        replace(told, readings=by_hand.readings(
            [[CAR], [HYDRANT]], [[(0, NONE, NONE, False)]] * 2, [0.6, 0.4], sizes=(4, 6, 4)
        )),
        None, is_new_task=False,
    )  # fmt: skip
    share = np.exp(np.asarray(joined.instruction.readings.log_probability))
    np.testing.assert_allclose(share, [0.42, 0.28, 0.18, 0.12], rtol=1e-5)
    kinds = [set(row[row != NONE]) for row in np.asarray(joined.instruction.readings.mention_type)]
    assert kinds == [{HYDRANT, CAR}, {HYDRANT}, {CONE, CAR}, {CONE, HYDRANT}]


# ---------------------------------------------------------------- a noun is one type
# At first, later, by a pronoun, in a file of a world. A label of the detector may be a name that
# the lexicon has for a type of its own: its "crate" is a "box" there.

OTHER_NAMES = ("crate", "drum", "pylon", "house", "traffic cone", "fire hydrant", "sofa")
AREA = {"x_min": 0.0, "x_max": 14.0, "y_min": -6.0, "y_max": 6.0}


def grounder(*labels: str) -> GraphGrounder:
    return GraphGrounder(load_shipped(), labels)


def spoken(text: str, *labels: str):
    return understand(text, load_shipped(), Detector(labels)).spoken


@pytest.mark.parametrize("noun", OTHER_NAMES)
@pytest.mark.parametrize(
    "said", ["the {0} is behind the piano", "the piano is in front of the {0}"]
)
def test_a_statement_speaks_of_the_type_of_the_task(noun: str, said: str) -> None:
    talk = Talk(f"go to the {noun}", [noun, "piano"]).say(said.format(noun), is_asked=False)
    assert sorted(talk.kinds) == [0, 1]
    assert int(np.asarray(talk.words.goal)[0, 0]) == talk.kinds.index(0)
    assert bool(talk.words.is_pinned[0, 0])


def test_a_statement_by_another_name_speaks_of_it_too() -> None:
    talk = Talk("go to the crate", ["crate", "piano"])
    talk.say("the box is behind the piano", is_asked=False)
    crate, piano = talk.kinds.index(0), talk.kinds.index(1)
    assert talk.said == {(crate, BEHIND, piano)}


@pytest.mark.parametrize("noun", [*OTHER_NAMES, "gazebo"])
def test_what_a_sentence_speaks_of_is_a_label(noun: str) -> None:
    labels = (noun, "piano")
    assert spoken(f"go to the {noun}", *labels).goals == (0,)
    assert spoken(f"the {noun} is near the piano. go to the piano", *labels).known == {0}
    twice = spoken(f"go to the {noun}, then to the other {noun}", *labels)
    assert twice.goals == (0, 0)
    assert twice.others == {0}
    avoiding = GraphGrounder(load_shipped(), labels).ground(
        f"stay away from the {noun}", Context(is_under_way=True)
    )
    assert avoiding.spoken is not None
    assert avoiding.spoken.avoided == ((0, True),)


def test_the_nouns_of_two_labels_are_two_things() -> None:
    """The lexicon knows one type for both."""
    labels = ("crate", "box", "piano")
    assert spoken("go to the crate behind the box", *labels).goals == (0,)
    assert spoken("go to the crate, then go to the box", *labels).goals == (0, 1)
    assert spoken("go to the box", *labels).goals == (1,)
    talk = Talk("go to the crate", labels).say("the box is behind the piano", is_asked=False)
    assert sorted(talk.kinds) == [0, 1, 2]


def test_another_crate_than_none_is_refused_by_its_name() -> None:
    with pytest.raises(ValueError, match="no crate has been spoken of yet"):
        grounder("crate", "piano").ground("go to the other crate", Context(is_under_way=False))


def test_a_noun_of_several_labels_is_the_goal_whichever_it_is() -> None:
    talk = Talk("go to the box", ["crate", "piano", "carton"])
    goals = np.asarray(talk.words.goal)
    readings = talk.readings
    kinds = [
        int(np.asarray(readings.mention_type)[k, goals[k, 0]])
        for k in np.flatnonzero(np.isfinite(np.asarray(readings.log_probability)))
        if np.asarray(readings.log_probability)[k] > np.log(0.1)
    ]
    assert sorted(kinds) == [0, 2]
    talk.say("the box is behind the piano", is_asked=False)
    share = np.exp(np.asarray(talk.readings.log_probability))
    told = np.asarray(talk.words.is_pinned)[:, 0] & (np.asarray(talk.words.goal)[:, 0] != NONE)
    assert share[told].sum() > 0.99


def test_one_noun_in_two_ways_is_one_thing() -> None:
    """Of one sentence: first as the detector says it, then as the lexicon does."""
    labels = ("crate", "piano")
    detector = Detector(labels)
    told = understand("go to the crate, then stop behind the box", load_shipped(), detector)
    assert told.spoken.goals == (0, 0)
    again = grounder(*labels).ground(
        "go to the box behind the piano", Context(is_under_way=True, about=0, is_at=True)
    )
    assert again.spoken is not None
    assert again.spoken.goals == (0,)


def test_only_what_is_said_is_to_be_looked_for() -> None:
    for labels in (["crate", "piano"], None):
        robot = Navigator.pretrained(labels=labels)
        assert len(robot.spoken(robot.start("go to crate"))) == 1


def test_a_world_may_call_things_by_any_name_of_their_type() -> None:
    names = ("crate", "box", "fire hydrant", "piano")
    things = [{"type": one, "x": 2.0 + 3.0 * i, "y": 2.0} for i, one in enumerate(names)]
    world = world_from_dict({"area": AREA, "objects": things}, file="depot.toml")
    types = [world.type_names[i] for i in np.asarray(world.scenario.object_type)[:4]]
    assert types == ["box", "box", "hydrant", "piano"]
