"""Turns and distances: what is read, what is refused by name, and where the robot ends."""

import math

import numpy as np
import pytest
from test_navigator_step import AREA, CONE, go

from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.messages import Status
from jaxlangnav.planner.policy import ARRIVAL_RADIUS

FRONT, BACK, LEFT, RIGHT = "in front of you", "behind you", "to your left", "to your right"


def told(text: str) -> list[tuple[str, float]]:
    """Write what a sentence asks for: place and metres of each command."""
    found = parse(text)
    return [
        (" ".join(word.text for word in clause.children[0].all_words()), round(one.metres, 2))
        for clause, one in zip(found.clauses, found.measures, strict=True)
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("turn left", [(LEFT, 0.5)]),
        ("hey robot, can you turn around please?", [(BACK, 0.5)]),
        ("make a right", [(RIGHT, 0.5)]),
        ("turn left, then left again", None),
        ("go forward two metres", [(FRONT, 2.0)]),
        ("go forward .5 metres", [(FRONT, 0.5)]),
        ("go forward a metre and a half", [(FRONT, 1.5)]),
        ("go forward 1.5 and a half metres", None),
        ("go forward 3 metres and a quarter", None),
        ("go forward one half metre", [(FRONT, 0.5)]),
        ("go forward one and one half metres", None),
        ("go forward negative three metres", None),
        ("drive twenty five feet", [(FRONT, 7.62)]),
        ("back up 3 feet", [(BACK, 0.91)]),
        ("step 1.5 m to the left", [(LEFT, 1.5)]),
        ("turn around and go forward 2m", [(BACK, 2.0)]),
        ("turn left then turn left and walk 2 yards", [(BACK, 1.83)]),
        ("10 feet past the cone", [("behind the cone", 3.05)]),
        ("stop two metres from the cone", [("near the cone", 2.0)]),
        ("go to the cone two metres behind the car", None),
        ("the cone is two metres behind the car", None),
        ("go to the cone and turn left", None),
        ("turn left at the cone", None),
        ("go to the cone then go forward 2 metres", None),
        ("go forward and turn left", None),
        ("go 2 metres to your right and then forward 1 metre", None),
        ("turn left then turn right", None),
        ("go forward 10 cm", None),
        ("go forward 900 metres", None),
        ("go forward -3 metres", None),
        ("go forward three steps", None),
    ],
)
def test_what_is_measured_is_read_or_refused_by_name(text, expected) -> None:
    if expected is not None:
        assert told(text) == expected
        return
    with pytest.raises(LanguageError, match=r"^.*\(word .*\Z"):
        parse(text)


def test_a_manner_said_between_is_kept() -> None:
    tree = str(parse("turn left and slowly go two metres").clauses[0])
    assert tree == "VP[go slowly]{PP[to your left]}"


def test_places_follow_one_another() -> None:
    text = "turn left, go 2 metres, turn right and go 3 metres, then go to the cone"
    first, second, third = parse(text).measures
    assert first.end == pytest.approx((0.0, 2.0), abs=1e-6)
    assert second.end == pytest.approx((3.0, 2.0), abs=1e-6)
    np.testing.assert_allclose(second.frame, (0.0, 2.0, math.pi / 2), atol=1e-6)
    assert (third.metres, third.end) == (0.0, None)
    (half,) = parse("turn 45° to the right and go 2 metres").measures
    assert half.end == pytest.approx((math.sqrt(2.0), -math.sqrt(2.0)), abs=1e-6)


START = (4.0, 0.0)  # where the robot is as it hears; it looks along x
THINGS = [(CONE, 7.0, 0.0)]
ENDS = {
    "turn left": (4.0, 0.5),
    "turn around": (3.5, 0.0),
    "go forward two metres": (6.0, 0.0),
    "back up 3 feet": (4.0 - 0.9144, 0.0),
    "step 1.5 m to the right": (4.0, -1.5),
    "turn left and go forward 2.5 metres": (4.0, 2.5),
    "go forward 2 metres, turn left, go 3 metres and turn right": (6.5, 3.0),
    "turn 45 degrees to the left and go 2 metres": (4.0 + math.sqrt(2.0), math.sqrt(2.0)),
    "go 4 feet past the cone": (7.0 + 1.2192, 0.0),
    "stop 2 metres in front of the cone": (5.0, 0.0),
    "stop one metre left of the cone": (7.0, 1.0),
    "stop 2.5 m from the cone": (4.5, 0.0),
}


@pytest.mark.parametrize("text", ENDS)
def test_the_robot_ends_where_it_was_told(robot, text: str) -> None:
    state = robot.start(text, pose=(*START, 0.0), area=AREA)
    run = go(robot, state, THINGS, start=START)
    assert Status(int(run.actions[-1].status)) == Status.ARRIVED
    assert np.hypot(*(run.end - ENDS[text])) <= ARRIVAL_RADIUS + 0.1


def test_a_way_is_told_from_where_the_robot_has_come_to(robot) -> None:
    run = go(robot, robot.start("go forward 2 metres", area=AREA), [])
    assert np.hypot(*(run.end - (2.0, 0.0))) <= ARRIVAL_RADIUS
    state, _ = robot.take(run.state, "turn left and go 3 metres")
    after = go(robot, state, [], start=tuple(run.end))
    assert Status(int(after.actions[-1].status)) == Status.ARRIVED
    assert np.hypot(*(after.end - (2.0, 3.0))) <= 2.0 * ARRIVAL_RADIUS
    back = go(robot, robot.hear(after.state, "come back"), [], start=tuple(after.end))
    assert np.hypot(*back.end) < 1.25


def test_what_cannot_be_gone_is_refused_and_the_task_stays(robot) -> None:
    state = robot.start("go to the cone", area=AREA)
    outside = r"leads to \(18.3, 0.0\), but the operating area is \(0, 10, -5, 5\)"
    with pytest.raises(ValueError, match=outside):
        robot.hear(state, "go forward 60 feet")
    with pytest.raises(ValueError, match="where the robot will stand when its task is done"):
        robot.hear(state, "then go forward 2 metres")
