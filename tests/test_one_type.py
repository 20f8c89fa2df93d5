"""A noun is one type wherever it is said: at first, later, by a pronoun, in a file of a world.

A label of the detector may be a name that the lexicon has for a type of its own: its "crate" is a
"box" there. Nothing is compiled here.
"""

import numpy as np
import pytest
from test_conversation_words import Talk

from jaxlangnav import Navigator
from jaxlangnav.grounding import Context, GraphGrounder, load_shipped, understand
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.messages import BEHIND, NONE
from jaxlangnav.world.files import world_from_dict

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
def test_a_statement_speaks_of_the_thing_of_the_task(noun: str, said: str) -> None:
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
