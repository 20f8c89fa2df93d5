"""Goals of any type: what they are read as, what may be meant, and how the search for them ends."""

import numpy as np
import pytest
from test_conversation import curious
from test_navigator_step import AREA, CONE, HYDRANT, STEP, distance, go

from jaxlangnav.grounding import understand
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.readings import unpad_readings
from jaxlangnav.inputs.object_types import ANYTHING, attributes, fits, kind_of, name_of
from jaxlangnav.messages import BEHIND, BETWEEN, LEFT, NEAR, NONE, ROBOT, Status

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
        (
            "go to the item between the cone and the car",
            (CONE, CAR, ANYTHING),
            {(2, NEAR, 0, BETWEEN), (2, NEAR, 1, BETWEEN)},
        ),
        (
            "go to the cone, then to the thing behind it",
            (CONE, ANYTHING),
            {(0, NONE, NONE, 0), (1, BEHIND, 0, 0)},
        ),
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
    seen = read(text, model, Detector(model.type_names, ["colour"]))
    red = kind_of(ANYTHING, attributes("red"))
    assert seen.mentions == (CONE, red)
    assert name_of(red, model.type_names) == "red thing"
    assert "'red'" in "".join(understand(text, model).notes)


def test_everything_seen_fits_and_nothing_else() -> None:
    red, blue = (kind_of(BENCH, attributes(one)) for one in ("red", "blue"))
    seen = np.array([HYDRANT, BENCH, red, blue, NONE, ROBOT])
    assert fits(seen, ANYTHING).tolist() == [True] * 4 + [False] * 2
    wanted = kind_of(ANYTHING, attributes("red"))
    assert fits(seen, wanted).tolist() == [True, True, True, False, False, False]
    assert not fits(ANYTHING, np.array([HYDRANT, NONE, ROBOT])).any()


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
    x, y, turn = np.asarray(run.state.belief.last_pose)
    leftward = [(b - y) * np.cos(turn) - (a - x) * np.sin(turn) for _, a, b in places[1:]]
    meant = 1 + int(np.argmax(leftward) if answer == "the left one" else np.argmin(leftward))
    after = go(asking, asking.hear(run.state, answer), places, start=tuple(run.end))
    assert Status(int(after.actions[-1].status)) == Status.ARRIVED
    assert distance(after, meant, places) < 1.5
