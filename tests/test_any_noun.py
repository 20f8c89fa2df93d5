"""Any noun: a sentence brings its own types, bound to labels; and goals of any type."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
import readings as by_hand
from test_conversation import curious, leftmost
from test_navigator_step import AREA, CONE, HYDRANT, STEP, distance, go

from jaxlangnav.grounding import GraphGrounder, load_shipped, understand
from jaxlangnav.grounding.binding import Detector, UnknownObjectError
from jaxlangnav.grounding.command_summary import list_commands
from jaxlangnav.grounding.readings import unpad_readings
from jaxlangnav.inputs.object_types import (
    ANYTHING,
    ATTRIBUTES,
    MAX_LABELS,
    attribute_code,
    attribute_words,
    is_type,
    label_of,
    merge_types,
    name_of,
    type_code,
)
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.messages import BEHIND, LEFT, NONE, ROBOT, Status
from jaxlangnav.navigator import api
from jaxlangnav.pytree import replace

LABELS = (
    "person", "bicycle", "car", "motorcycle", "traffic light", "fire hydrant", "stop sign",
    "parking meter", "bench", "potted plant", "dining table", "tv", "sports ball", "gazebo",
    "easel", "truck", "mailbox", "sofa", "orange", "yield sign", "box", "cone",
)  # fmt: skip
SENTENCES = (
    "go to the {0}",
    "go to the {0} behind the {1}",
    "go to the {0} that is to the left of the {1}",
    "find the {0} nearest to the {1}",
    "go to the second {0} on your left",
    "move behind the {0}",
    "go quickly to the {0} but stay away from the {1}",
    "go to the {0}, then stop behind it",
    "go to the {0} in front of the {1}, then to the other {0}",
    "the {0} is near the {1}. go to the {0}",
)


def understood(text, model, labels=LABELS, attributes=()):
    return understand(text, model, Detector(labels, attributes))


def arrays(text, model, labels):
    """Everything that the navigator takes, with labels in place of their indices."""
    told = jax.tree.map(np.asarray, understood(text, model, labels).instruction)

    def named(indices):
        return [labels[i] if i >= 0 else i for i in np.ravel(indices)]

    names = named(told.readings.mention_type), named(told.clauses.named_types)
    blank = replace(
        told,
        readings=replace(told.readings, mention_type=None),
        clauses=replace(told.clauses, named_types=None),
    )
    return names, jax.tree.leaves(blank)


@pytest.mark.parametrize("sentence", SENTENCES)
def test_which_noun_it_is_makes_no_difference(sentence, model) -> None:
    """The trained graph goes by the class of a word: to the bit the same for any pair of nouns."""
    pairs = (("gazebo", "easel"), ("kiosk", "sundial"), ("vending machine", "lily"))
    found = [arrays(sentence.format(*pair), model, pair) for pair in pairs]
    for pair, (names, leaves) in zip(pairs, found, strict=True):
        instead = dict(zip(pair, pairs[0], strict=True))
        assert [[instead.get(n, n) for n in part] for part in names] == list(found[0][0])
        for leaf, first in zip(leaves, found[0][1], strict=True):
            np.testing.assert_array_equal(leaf, first)


def likeliest(text, figure, landmark, labels, model):
    """What the likeliest reading says of F and L, and how sure it is."""
    told = understood(text.format(figure, landmark), model, labels)
    readings = jax.tree.map(np.asarray, told.instruction.readings)
    names = {labels.index(figure): "F", labels.index(landmark): "L", ROBOT: "R"}
    said = [names.get(int(k)) for k in readings.mention_type[0]]
    columns = (readings.figure[0], readings.relation[0], readings.landmark[0], readings.rank[0])
    edges = {
        (said[f], int(r), said[by] if by != NONE else None, int(rank))
        for f, r, by, rank in zip(*columns, strict=True)
        if f != NONE
    }
    return edges, sorted(map(str, said)), float(np.exp(readings.log_probability[0]))


@pytest.mark.parametrize("steps", [(3,), pytest.param((1, 2, 4, 5, 6, 7), marks=pytest.mark.slow)])
@pytest.mark.parametrize("text", SENTENCES)
def test_new_nouns_are_read_as_those_of_the_training(text, steps, model) -> None:
    """What is said of "gazebo" and "easel" is what is said of any pair of the known types."""
    types = load_lexicon().type_names
    *new, sure = likeliest(text, "gazebo", "easel", ("gazebo", "easel"), model)
    assert sure > 0.9
    for step, first in itertools.product(steps, range(len(types))):
        pair = types[first], types[(first + step) % len(types)]
        assert list(likeliest(text, *pair, types, model)[:2]) == new, pair


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("go to the gazebo", "gazebo"),
        ("go to the hydrant", "fire hydrant"),  # a synonym of the lexicon
        ("go to the ball", "sports ball"),
        ("go to the traffic cone", "cone"),
        ("go to the plant", "potted plant"),  # by head noun, "any of the detector's"
        ("go to the orange", "orange"),  # an adjective of the grammar, here a thing
        ("go to the stop sign", "stop sign"),
        ("go to the rickety gazebo", "gazebo"),
        ("go to the man", "person"),  # a broader label
        ("go to the fire truck", "truck"),  # by its head
    ],
)
def test_nouns_are_bound_to_labels(text, label, model) -> None:
    readings = understood(text, model).instruction.readings
    assert int(readings.mention_type[0, 0]) == LABELS.index(label)


def test_a_noun_may_be_any_of_several_labels(model) -> None:
    told = understood("go to the sign behind the gazebo", model).instruction
    signs = {LABELS.index("stop sign"), LABELS.index("yield sign")}
    (command,) = list_commands(told, LABELS)
    assert command["goal"]["object"] == "stop sign or yield sign"
    np.testing.assert_allclose(np.exp(told.readings.log_probability[:2]), 0.5, atol=0.01)
    named = [set(row[row != NONE].tolist()) for row in np.asarray(told.clauses.named_types)[0]]
    assert signs in named


def test_labels_are_written_as_detectors_write_them(model) -> None:
    told = understood("go to the stop sign", model, ("Traffic_Light", "Stop-Sign"))
    assert int(told.instruction.readings.mention_type[0, 0]) == 1


def test_a_landmark_without_a_label_is_noted_and_the_rest_used(model) -> None:
    grounder = GraphGrounder(model, LABELS)
    told = understand("go to the hydrant behind the zorbel", model, grounder.detector)
    assert told.notes == ("my detector has no label for 'zorbel': it is never seen",)
    kind = int(told.instruction.readings.mention_type[0, 0])
    assert kind == len(LABELS)
    assert grounder.names[kind] == "zorbel"
    assert grounder.type_names == LABELS
    # In the next sentence it is what it was.
    again = understand("go to the gazebo near the zorbel", model, grounder.detector)
    assert kind in np.asarray(again.instruction.readings.mention_type[0])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("go to the kiosk", r"'kiosk' \(word 4\): my detector has no label .* it knows person"),
        ("go to the tree house behind the bench", "'tree house'.*no label"),
        ("move behind the kiosk", "'kiosk'.*no label"),
        ("go to the hydrant, then to the kiosk", "'kiosk'.*no label"),
        ("go to the tallest truck", "how tall things are is not compared"),
        ("go to the biggest red box", "how big things are is not compared"),
        ("smash the gazebo", "'smash'"),
        ("go to the car bench", "'car bench'.*names no one object"),
    ],
)
def test_what_can_never_be_found_is_refused(text, why, model) -> None:
    with pytest.raises((UnknownObjectError, LanguageError), match=why) as error:
        understood(text, model)
    assert "\n" not in str(error.value)


def test_a_noun_of_too_many_labels_is_asked_back(model) -> None:
    labels = ("stop sign", "yield sign", "exit sign", "street sign", "road sign")
    with pytest.raises(UnknownObjectError, match=r"may be any of 5 labels .*: name one of them"):
        understood("go to the sign", model, labels)


@pytest.mark.parametrize(
    ("labels", "groups", "why"),
    [
        ((), (), "0 names"),
        (("box", "Box"), (), "'box' twice"),
        (("box", " "), (), "have an empty name at place 2"),
        ("crate", (), "labels is 'crate', but must be a list of names"),
        (None, (), "labels is None, but must be a list of names"),
        (("box", 3), (), r"labels\[1\] is 3, but must be a name"),
        (("cr\x1bate",), (), r"labels\[0\].*control character U\+001B"),
        (("the",), (), "'the', which has a meaning of its own"),
        (("box", "behind"), (), "'behind', which has a meaning of its own"),
        (("box",), "colour", "attributes is 'colour', but must be a list of names"),
        (("box",), ("smell",), "cannot report 'smell'"),
    ],
)
def test_labels_that_cannot_be_are_refused(labels, groups, why) -> None:
    with pytest.raises(ValueError, match=why):
        Detector(labels, groups)


def test_labels_that_detectors_have_are_taken() -> None:
    """Words of the grammar too, where they name a class of things."""
    labels = ("object", "exit", "stop sign", "parking meter", "path", "light", "orange", "step")
    assert Detector(labels).labels == labels


def test_a_kind_is_a_label_and_attributes() -> None:
    red, tall = attribute_code("red"), attribute_code("tall")
    both = attribute_code("tall", "red")
    assert attribute_words(both) == ("red", "tall")
    ball = [type_code(7, code) for code in (0, red, attribute_code("blue"), both)]
    asked = type_code(7, red)
    assert [bool(is_type(one, asked)) for one in ball] == [True, True, False, True]
    assert not is_type(type_code(8, red), asked)
    assert merge_types(ball[2], type_code(7, both)) == ball[3]
    assert merge_types(ball[1], type_code(7, tall)) == ball[3]
    for special in (NONE, ROBOT):
        assert label_of(special) == special
        assert int(label_of(np.int32(special))) == special
        assert not is_type(special, asked)
        assert is_type(special, special)
    assert not is_type(NONE, ROBOT)
    for words in itertools.product(*((None, *values) for values in ATTRIBUTES.values())):
        given = tuple(word for word in words if word)
        code = attribute_code(*given)
        assert attribute_words(code) == given
        kind = type_code(MAX_LABELS - 1, code)
        assert int(np.float32(kind)) == kind  # as tables of particles hold it


def test_attributes_that_the_detector_reports_are_part_of_what_is_meant(model) -> None:
    told = understood("go to the red ball behind the blue ball", model, attributes=("colour",))
    ball = LABELS.index("sports ball")
    said = [type_code(ball, attribute_code(word)) for word in ("blue", "red")]
    assert told.instruction.readings.mention_type[0, :2].tolist() == said
    assert told.notes == ()
    assert [one["figure"] for one in told.annotations[:1]] == ["ball"]
    assert [one["landmark"] for one in told.annotations[:1]] == ["blue ball"]


@pytest.mark.parametrize(
    ("text", "groups", "notes"),
    [
        ("go to the red box", (), ("'red' is not used: my detector reports no colour",)),
        ("go to the dark red box", ("colour",), ()),
        (
            "go to the red and white box",
            ("colour",),
            ("'white' is not used: one colour of a thing is compared",),
        ),
        (
            "go to the lovely box",
            ("colour",),
            ("'lovely' is not used: it is no attribute that is compared",),
        ),
    ],
)
def test_no_adjective_is_dropped_silently(text, groups, notes, model) -> None:
    assert understood(text, model, attributes=groups).notes == notes


def test_it_is_what_it_was_attributes_and_all(model) -> None:
    told = understood("go to the red box, then stop behind it", model, attributes=("colour",))
    kind = type_code(LABELS.index("box"), attribute_code("red"))
    readings = told.instruction.readings
    assert set(np.asarray(readings.mention_type[0]).tolist()) == {kind, NONE}


def test_own_nouns_drive_an_episode_and_compile_nothing(robot, caplog) -> None:
    labels = ["gazebo", "easel"]
    assert (labels.index("gazebo"), labels.index("easel")) == (HYDRANT, CONE)
    told = dataclasses.replace(robot, grounder=GraphGrounder(load_shipped(), labels))
    go(robot, robot.start("go to the hydrant", area=AREA), max_steps=1)
    size = api._step._cache_size()
    run = go(told, told.start("go to the gazebo behind the easel", area=AREA))
    assert distance(run, 1) < 1.5
    state = told.hear(run.state, "go to the easel near the zorbel")
    assert told.missing(state) == ["zorbel"]
    assert "my detector has no label for 'zorbel'" in caplog.text
    assert api._step._cache_size() == size


BALLS = ((3.0, 2.0, "blue"), (3.0, -2.0, "red"), (6.0, 0.5, "green"), (6.0, -4.0, "yellow"))


def look_at_balls(place, heading: float):
    """Look round: every ball is in view, with its colour."""
    found = [(HYDRANT, x - place[0], y - place[1]) for x, y, _ in BALLS]
    pose, sensor = np.array([*place, heading]), by_hand.sensor(12.0, noise=0.02)
    codes = np.zeros(8, np.int32)
    codes[: len(BALLS)] = [attribute_code(colour) for _, _, colour in BALLS]
    seen = by_hand.observation(pose, found, sensor, size=8)
    return replace(seen, detection_attribute=codes)


@pytest.mark.parametrize("colour", ["red", "green"])
def test_the_red_ball_is_chosen_among_balls(robot, colour: str) -> None:
    grounder = GraphGrounder(load_shipped(), ["ball", "tree"], ["colour"])
    told = dataclasses.replace(robot, grounder=grounder)
    state, place, heading = told.start(f"go to the {colour} ball", area=AREA), np.zeros(2), 0.0
    for step in range(30):
        key = jax.random.fold_in(jax.random.key(0), step)
        state, action, _ = told.step(key, state, look_at_balls(place, heading))
        if action.is_stop:
            break
        move = np.asarray(action.step, float)
        place, heading = place + move, float(np.arctan2(move[1], move[0]))
    away = {name: float(np.hypot(x - place[0], y - place[1])) for x, y, name in BALLS}
    assert int(state.status) == Status.ARRIVED
    assert min(away, key=away.__getitem__) == colour
    assert away[colour] < 1.25


def test_an_object_of_the_attributes_that_are_said_is_not_ruled_out(robot) -> None:
    grounder = GraphGrounder(load_shipped(), ["ball", "tree"], ["colour"])
    told = dataclasses.replace(robot, grounder=grounder)
    state = told.start("go to the red ball", area=AREA)
    for key in jax.random.split(jax.random.key(0), 2):
        state, _, _ = told.step(key, state, look_at_balls(np.zeros(2), 0.0))
    assert told.take(state, "no, the ball")[1].ruled_out == (int(state.talk.approached),)
    after, outcome = told.take(state, "no no the red one")
    assert not outcome.ruled_out
    assert bool(after.is_resting)  # by "no no"
    assert "the red ball is approached" in outcome.notes[0]


# ---------------------------------------------------------------- goals of any type

CAR, TREE, BENCH, BARREL = 2, 4, 5, 6
BEHIND_IT = "go to the thing behind the cone"


def read(text, model, detector=None):
    return unpad_readings(understand(text, model, detector).instruction.readings)[0][0]


@pytest.mark.parametrize(
    ("text", "mentions", "relations"),
    [
        (BEHIND_IT, (CONE, ANYTHING), {(1, BEHIND, 0, 0)}),
        ("the one behind the car", (CAR, ANYTHING), {(1, BEHIND, 0, 0)}),
        ("go to the one on your left", (ROBOT, ANYTHING), {(1, LEFT, 0, 0)}),
        # A place has no thing in it.
        ("move behind the cone", (CONE,), {(0, NONE, NONE, 0)}),
    ],
)
def test_the_thing_is_a_mention_of_its_own(text, mentions, relations, model) -> None:
    found = read(text, model)
    assert found.mentions == mentions
    assert set(found.relations) == relations


def test_what_is_said_of_it_comes_last(model) -> None:
    """It is none of the other things, which have to be known first."""
    found = read("go to the thing behind the cone, then to the car", model)
    figures = [found.mentions[figure] for figure, *_ in found.relations]
    assert figures == [CAR, ANYTHING]


def test_a_colour_of_the_thing_counts_or_is_noted(model) -> None:
    text = "go to the red thing behind the cone"
    detector = Detector(model.type_names, ["colour"])
    seen = read(text, model, detector)
    red = type_code(ANYTHING, attribute_code("red"))
    assert seen.mentions == (CONE, red)
    assert name_of(red, model.type_names) == "red thing"
    assert "'red'" in "".join(understand(text, model).notes)
    with pytest.raises(ValueError, match=r"'thing' \(word 15\): .* one at a time"):
        read(f"{text} and then go to the blue thing near the car", model, detector)


def test_everything_seen_fits_and_nothing_else() -> None:
    red, blue = (type_code(BENCH, attribute_code(one)) for one in ("red", "blue"))
    seen = np.array([HYDRANT, BENCH, red, blue, NONE, ROBOT])
    assert is_type(seen, ANYTHING).tolist() == [True] * 4 + [False] * 2
    wanted = type_code(ANYTHING, attribute_code("red"))
    assert is_type(seen, wanted).tolist() == [True, True, True, False, False, False]
    assert not is_type(ANYTHING, np.array([HYDRANT, NONE, ROBOT])).any()


def test_the_thing_is_found_whatever_it_is(robot) -> None:
    """One compiled program, whichever type it has; it is out of the first view."""
    go(robot, robot.start("go to the cone", area=AREA), max_steps=1)
    compiled = STEP._cache_size()
    for kind in (BARREL, CONE):
        places = [(CONE, 4.0, 0.5), (kind, 6.4, 0.8), (TREE, 2.5, -3.5)]
        run = go(robot, robot.start(BEHIND_IT, area=AREA), places)
        assert Status(int(run.actions[-1].status)) == Status.ARRIVED
        assert distance(run, 1, places) < 1.5
        assert robot.missing(run.state) == []
    assert STEP._cache_size() == compiled
    assert robot.spoken(run.state) == list(robot.type_names)


def test_where_nothing_is_behind_the_cone_nothing_is_found(robot) -> None:
    """Two things are in plain view, and neither is taken for it."""
    places = [(CONE, 4.0, 0.5), (BARREL, 2.0, 3.0), (TREE, 4.5, -3.5)]
    run = go(robot, robot.start(BEHIND_IT, area=AREA), places)
    assert Status(int(run.actions[-1].status)) == Status.NOT_FOUND
    told = [Status(int(action.status)) for action in run.actions]
    assert Status.ARRIVED not in told
    assert robot.missing(robot.start(BEHIND_IT, area=AREA)) == ["cone", "thing"]


def test_what_nobody_spoke_of_may_be_the_thing(robot) -> None:
    """A bench that was passed on the way is remembered, and is then the thing behind the cone."""
    # From wherever the robot stops beside the cone, the tree is not behind it.
    places = [(HYDRANT, 2.5, 1.0), (CONE, 4.0, 0.0), (BENCH, 5.5, -1.0), (TREE, 1.0, -3.5)]
    run = go(robot, robot.start("go to the cone", area=AREA), places)
    assert Status(int(run.actions[-1].status)) == Status.ARRIVED
    aside = np.asarray(run.state.belief.bystanders.object_type).tolist()
    assert BENCH in aside
    state = robot.hear(run.state, BEHIND_IT)
    after = go(robot, state, places, start=tuple(run.end))
    held = np.asarray(after.state.belief.particles.object_type)
    assert (held == BENCH).any(axis=0).all()
    assert BENCH not in np.asarray(after.state.belief.bystanders.object_type)
    assert Status(int(after.actions[-1].status)) == Status.ARRIVED
    assert distance(after, 2, places) < 1.5
    assert len(after.actions) < 8


@pytest.mark.parametrize("answer", ["the left one", "the right one"])
def test_which_one_is_asked_of_things_of_two_types(robot, answer: str) -> None:
    """A barrel and a tree stand behind the cone; the answer tells which of them is gone to."""
    places = [(CONE, 4.0, 0.0), (BARREL, 6.3, 0.7), (TREE, 6.3, -0.7)]
    asking = curious(robot)
    run = go(asking, asking.start(BEHIND_IT, area=AREA), places)
    assert Status(int(run.actions[-1].status)) == Status.WHICH_ONE
    found = asking.candidates(run.state)
    assert {one.type_name for one in found} == {asking.type_names[one] for one in (BARREL, TREE)}
    assert sum(one.probability for one in found) > 0.7
    left = 1 + leftmost(run, places[1:])
    meant = left if answer == "the left one" else 3 - left
    after = go(asking, asking.hear(run.state, answer), places, start=tuple(run.end))
    assert Status(int(after.actions[-1].status)) == Status.ARRIVED
    assert distance(after, meant, places) < 1.5
