"""How a task ends, and words that end it: halt, resume, cancel, nothing to be found."""

import logging

import jax
import numpy as np
import pytest
from test_navigator_step import AREA, CONE, HYDRANT, RANGE, WORLD, Run, assert_arrived, go, see

from jaxlangnav.language.halting import Act
from jaxlangnav.language.utterance import Kind
from jaxlangnav.messages import Fault, Status
from jaxlangnav.navigator import speech_acts
from jaxlangnav.planner import policy
from jaxlangnav.pytree import replace

TEXT = "go to the hydrant behind the cone"
SLOW = pytest.mark.slow


def assert_stands(action, status: Status) -> None:
    assert Status(int(action.status)) == status
    np.testing.assert_array_equal(action.step, 0.0)


def advance(robot, run, number: int, state):
    """Step a robot that stands where a run has ended."""
    for step in range(number):
        key = jax.random.fold_in(jax.random.key(9), step)
        state, action, info = robot.step(key, state, see(tuple(run.end), 0.0))
        if Status(int(action.status)) > Status.APPROACHING:
            np.testing.assert_allclose(action.waypoint, info.robot)
        yield state, action, info


@pytest.fixture(scope="module")
def arrived(robot) -> Run:
    return go(robot, robot.start(TEXT, area=AREA))


def test_the_way_to_an_arrival_is_told(robot, arrived) -> None:
    run = arrived
    assert_arrived(run, 1)
    for action in run.actions:
        assert float(np.hypot(*action.step)) <= 1.0 + 1e-5
        assert np.isfinite(action.waypoint).all()
    # Cone, hydrant, decision: believed in the end.
    assert float(run.infos[-1].choice.stop_mass) >= float(robot.params.planner.stop_probability)
    told = [Status(int(action.status)) for action in run.actions]
    assert told[0] == Status.SEARCHING
    assert told[-2] == Status.APPROACHING
    assert Status.ARRIVED not in told[:-1]
    for _, action, _ in advance(robot, run, 3, run.state):
        assert_stands(action, Status.ARRIVED)
        assert bool(action.is_stop)
    assert robot.missing(run.state) == []


def test_halted_it_stands_and_looks_and_goes_on(robot) -> None:
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=3)
    halted = robot.hear(run.state, "Stop, please!")
    assert bool(halted.is_halted)
    looked = float(np.exp(run.state.belief.coverage.log_miss).mean())
    for after, action, info in advance(robot, run, 12, halted):
        assert_stands(action, Status.HALTED)
        assert not bool(action.is_stop)
        assert not bool(after.is_done)
        assert int(info.fault) == 0
    assert float(np.exp(after.belief.coverage.log_miss).mean()) < looked
    again = go(robot, robot.hear(after, "carry on"), start=tuple(run.end), seed=2)
    assert_arrived(again, 1)


def test_another_command_ends_a_halt(robot) -> None:
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=2)
    state = robot.hear(robot.hear(run.state, "halt"), "go to the cone")
    assert not bool(state.is_halted)
    again = go(robot, state, start=tuple(run.end))
    assert_arrived(again, 0, 2)


def test_cancelled_it_is_idle_without_a_fault_until_it_is_told(robot) -> None:
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=2)
    for words in (["never mind"], ["stop", "cancel"], ["cancel", "carry on"]):
        state = run.state
        for text in words:
            state = robot.hear(state, text)
        for _, action, info in advance(robot, run, 4, state):
            assert_stands(action, Status.IDLE)
            assert int(info.fault) == 0
            assert not bool(action.is_stop)
    again = go(robot, robot.hear(state, TEXT), start=tuple(run.end))
    assert Status(int(again.actions[-1].status)) == Status.ARRIVED


@pytest.mark.parametrize("words", [["cancel", "freeze"], ["stop"]])
def test_what_it_was_is_remembered_through_a_halt(robot, words: list[str]) -> None:
    run = go(robot, robot.start("find the cone", area=AREA))
    halted = run.state
    for text in words:
        halted = robot.hear(halted, text)
    _, action, _ = next(advance(robot, run, 1, halted))
    assert_stands(action, Status.HALTED)
    _, action, _ = next(advance(robot, run, 1, robot.hear(halted, "go on")))
    assert_stands(action, Status.IDLE if "cancel" in words else Status.ARRIVED)


def test_a_halt_with_more_that_is_not_understood_is_not_lost(robot, caplog) -> None:
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=1)
    for said in ("Stop! There is a wombat", "stop and gather the wombats", "Stop! Wrong one!"):
        with caplog.at_level(logging.WARNING):
            state = robot.hear(run.state, said)
        assert bool(state.is_halted), said
        assert ("halted" in caplog.text) == ("There" not in said)
        caplog.clear()
    assert bool(robot.hear(run.state, "there is a wombat, stop").is_halted)


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("Stop! Go to the cone", Kind.COMMAND),
        ("stop and come back", Kind.RETURN),
        ("never mind, come back", Kind.RETURN),
        ("forget it and come back", Kind.RETURN),
        ("Never mind, go to the cone", Kind.COMMAND),
        ("cancel, the cone is behind the hydrant", Kind.CANCEL),
        ("Never mind, there is a wombat", Kind.CANCEL),
    ],
)
def test_what_begins_with_halting_or_cancelling_goes_on_from_there(robot, said, kind) -> None:
    """As if one were said after the other."""
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=1)
    state, heard = robot.take(run.state, said)
    assert heard.kind == kind
    assert heard.text == said
    assert not bool(state.is_halted)
    assert int(state.instruction.num_clauses) == (kind != Kind.CANCEL)


@pytest.mark.parametrize("said", ["stop", "carry on", "never mind"])
def test_a_robot_without_a_task_is_not_halted(robot, said: str) -> None:
    with pytest.raises(ValueError, match=r"no task yet.*give a command") as refusal:
        robot.start(said, area=AREA)
    assert "\n" not in str(refusal.value)


def test_a_batch_is_halted_as_one_is(robot) -> None:
    one = robot.start(TEXT, area=AREA)
    both = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), one)
    for act in Act:
        alone = speech_acts.apply_act(one, act)
        twice = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), alone)
        jax.tree.map(np.testing.assert_array_equal, speech_acts.apply_act(both, act), twice)


def test_a_fault_changes_no_status(robot, arrived) -> None:
    broken = replace(see(tuple(arrived.end), 0.0), pose=np.float32([np.nan, 0.0, 0.0]))
    _, action, info = robot.step(jax.random.key(0), arrived.state, broken)
    assert int(info.fault) == Fault.POSE
    assert_stands(action, Status.ARRIVED)
    assert not bool(action.is_stop)


def test_what_is_nowhere_is_not_found_and_named(robot) -> None:
    places = [(CONE, 4.0, 0.5), (CONE, 2.5, -3.5)]
    for text in ("go to the hydrant", "find the hydrant behind the cone"):
        run = go(robot, robot.start(text, area=AREA), places, max_steps=90)
        assert Status(int(run.actions[-1].status)) == Status.NOT_FOUND
        assert bool(run.actions[-1].is_stop)
        assert bool(run.state.is_done)
        assert robot.missing(run.state) == ["hydrant"]
        assert float(np.exp(run.state.belief.coverage.log_miss).mean()) < 0.1
        for _, action, _ in advance(robot, run, 2, run.state):
            assert_stands(action, Status.NOT_FOUND)


def test_a_landmark_that_is_nowhere_hides_no_goal(robot) -> None:
    places = [(HYDRANT, *WORLD[1][1:])]
    run = go(robot, robot.start(TEXT, area=AREA), places, max_steps=90)
    assert_arrived(run, 0, places=places)
    assert robot.missing(run.state) == ["cone"]


@pytest.mark.parametrize(("looks", "arrives"), [((0,), False), ((0, 1), True)])
def test_nothing_arrives_at_what_the_last_looks_should_have_shown(robot, looks, arrives) -> None:
    """Detected at 2.9 m and missed in plain view, twice at least; one miss is the detector's."""
    state, position, hydrant = robot.start("go to the hydrant", area=AREA), np.zeros(2), (2.9, 0.2)
    for step in range(4):
        look = see(position, 0.0, [(HYDRANT, *hydrant)] if step in looks else [])
        state, action, _ = robot.step(jax.random.key(step), state, look)
        if bool(action.is_stop):
            break
        position = position + np.asarray(action.step)
    assert (Status(int(action.status)) == Status.ARRIVED) == arrives
    assert float(look.sensor.false_detections) == 0.0


SAID = (
    "go to the hydrant",
    "find the cone left of the hydrant",
    "go to the second cone",
    "move behind the car",
    "go to the bench but avoid the cone",
    "go to the cone then find the hydrant nearest to the cone",
)


@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(s, marks=SLOW) for s in range(6, 60))])
def test_no_arrival_without_a_goal_seen_within_reach(robot, seed: int) -> None:
    """Random sentences, areas and things: nothing stops for what is not there; no broken number."""
    draw = np.random.default_rng(seed)
    low, sides = draw.uniform(-6.0, 0.0, 2), draw.uniform(1.0, 14.0, 2)
    area = (low[0], low[0] + sides[0], low[1], low[1] + sides[1])
    places = [
        (int(draw.choice([HYDRANT, CONE, 2])), *(low + draw.uniform(0.0, 1.0, 2) * sides))
        for _ in range(draw.integers(0, 6))
    ]
    start = low + draw.uniform(0.0, 1.0, 2) * sides
    state = robot.start(SAID[seed % len(SAID)], pose=(*start, draw.uniform(-3.0, 3.0)), area=area)
    run = go(robot, state, places, start=tuple(start), max_steps=40, seed=seed)
    params = robot.params.planner
    for action, info in zip(run.actions, run.infos, strict=True):
        assert np.isfinite([*action.waypoint, *action.step]).all()
        goals = info.goals
        assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(goals))
        away = np.hypot(goals.object_x - info.robot[0], goals.object_y - info.robot[1])
        reach = RANGE if float(info.behavior.action[1]) > 0.5 else float(params.reach)
        is_goal = np.asarray(goals.is_object) & (goals.object_accepted >= policy.MIN_GOAL_PROB)
        if Status(int(action.status)) == Status.ARRIVED:
            assert (is_goal & (away <= reach)).any()
        if Status(int(action.status)) == Status.NOT_FOUND:
            assert not is_goal.any()
        assert bool(action.is_stop) == (int(action.status) in (Status.ARRIVED, Status.NOT_FOUND))
