"""What cannot be makes the robot stand still and say why; what can be again makes it go on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hostile import MUTATIONS, looks
from test_navigator_step import AREA, distance, go, see

from jaxlangnav import navigator
from jaxlangnav.dialogue import merge_utterance
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import NONE, Fault
from jaxlangnav.navigator import api, speech_acts
from jaxlangnav.pytree import replace

TEXT = "go to the hydrant behind the cone"
START = (2.0, 0.0)
GOOD = see(START, 0.0)


def begin(robot) -> navigator.NavigatorState:
    return robot.start(TEXT, pose=(*START, 0.0), area=AREA)


def advance(robot, state, look, seed: int = 0):
    return robot.step(jax.random.fold_in(jax.random.key(1), seed), state, look)


def assert_stands(action, info) -> None:
    assert int(info.fault) != 0
    assert not bool(action.is_stop)
    np.testing.assert_array_equal(action.step, 0.0)
    np.testing.assert_array_equal(action.waypoint, info.robot)
    assert np.isfinite(np.asarray(info.robot)).all()


def assert_finite(state) -> None:
    """All of the state but log-weights, which may be −∞ where a reading has no probability."""
    kept = replace(state, instruction=None)
    for path, leaf in jax.tree_util.tree_leaves_with_path(kept):
        assert np.isfinite(np.asarray(leaf, float)).all(), jax.tree_util.keystr(path)


def assert_arrives(robot, state, start=START) -> None:
    run = go(robot, state, start=start, seed=3)
    assert bool(run.state.is_done)
    assert distance(run, 1) < 1.5
    assert all(int(info.fault) == 0 for info in run.infos)


def jump(draw: np.random.Generator, look):
    """Report a pose in the area, farther off than a cycle's way."""
    angle, metres = draw.uniform(-np.pi, np.pi), draw.uniform(2.5, 4.0)
    pose = look.pose + np.float32([metres * np.cos(angle), metres * np.sin(angle), 0.0])
    return replace(look, pose=pose)


@pytest.mark.parametrize("number", [220, pytest.param(10_000, marks=pytest.mark.slow)])
def test_hostile_looks_never_stop_or_move_it_and_are_forgotten(robot, number: int) -> None:
    state, draw = begin(robot), np.random.default_rng(7)
    drawn = looks(GOOD, number, seed=number)
    for index in range(1, number, 10):
        drawn[index] = (jump(draw, GOOD), Fault.JUMP)
    for index, (look, flag) in enumerate(drawn):
        state, action, info = advance(robot, state, look, index)
        assert_stands(action, info)
        assert flag in Fault(int(info.fault)), (index, flag)
        if index % 50 == 0:
            assert_finite(state)
    assert_finite(state)
    # Nothing of them is believed: not an object, not a place looked at.
    assert (np.asarray(state.belief.particles.object_type) == NONE).all()
    assert (np.asarray(state.belief.coverage.log_miss) == 0.0).all()
    assert_arrives(robot, state)


def test_hostile_looks_on_the_way_cost_time_and_nothing_else(robot) -> None:
    """Before each look that can be, one of every field that cannot."""
    draw, names = np.random.default_rng(0), list(MUTATIONS)

    def disturb(state, look, step: int):
        broken = MUTATIONS[names[step % len(names)]][0](draw, look)
        state, action, info = advance(robot, state, broken, 1000 + step)
        assert_stands(action, info)
        return state

    state = robot.start(TEXT, area=AREA)
    run = go(robot, state, disturb=disturb)
    assert bool(run.state.is_done)
    assert distance(run, 1) < 1.5


def test_a_carried_robot_says_so_at_once_and_finds_its_way(robot) -> None:
    run = go(robot, robot.start(TEXT, area=AREA), max_steps=3)
    carried = (5.0, -3.0)
    for step in range(2):  # it is doubted, and then taken over
        state, action, info = advance(robot, run.state, see(carried, 0.0), step)
        assert int(info.fault) == Fault.JUMP
        assert_stands(action, info)
        run.state = state
    assert np.hypot(*(np.asarray(info.robot) - carried)) < 0.5
    assert_arrives(robot, run.state, start=carried)


def test_a_quick_robot_is_not_taken_for_a_carried_one(robot) -> None:
    state = robot.start("quickly go to the hydrant", area=AREA)
    run = go(robot, state)
    assert max(float(np.hypot(*action.step)) for action in run.actions) > 1.4
    assert all(int(info.fault) == 0 for info in run.infos)


def test_dead_weights_are_said_and_healed(robot) -> None:
    run = go(robot, begin(robot), start=START, max_steps=2)
    for dead in (-np.inf, np.nan):
        weight = jnp.full_like(run.state.belief.log_weight, dead)
        state = replace(run.state, belief=replace(run.state.belief, log_weight=weight))
        place = tuple(run.end)
        state, action, info = advance(robot, state, see(place, 0.0))
        assert int(info.fault) == Fault.WEIGHTS
        assert_stands(action, info)
        assert_finite(state)
        assert_arrives(robot, state, start=place)


def test_who_was_never_asked_for_anything_stands_still(robot) -> None:
    """A statement is no beginning, and without a command there is a fault."""
    with pytest.raises(ValueError, match="asks for nothing"):
        robot.start("the hydrant is behind the car", area=AREA)
    state = begin(robot)
    none = jnp.zeros_like(state.instruction.num_clauses)
    idle = replace(state, instruction=replace(state.instruction, num_clauses=none))
    _, action, info = advance(robot, idle, GOOD)
    assert int(info.fault) == Fault.COMMAND
    assert_stands(action, info)


def test_a_command_heard_at_a_place_that_cannot_be_is_heard_where_it_was(robot) -> None:
    state = begin(robot)
    instruction = understand("go to the cone", load_shipped()).instruction
    readings, words = state.instruction.readings, state.talk.words
    merged = merge_utterance(readings, words, instruction, None, is_new_task=True)
    nowhere = jnp.array([jnp.nan, 0, 0])
    told = speech_acts.tell(state, merged, nowhere, effect=speech_acts.Effect.REPLACE)
    np.testing.assert_array_equal(told.talk.viewer[0], state.belief.last_pose)
    assert bool(told.belief.must_ground)


LABELS = ("hydrant", "cone")
SAID = "go to the hydrant"
STATE = "state is None, but must be what navigator.start, wait, step or hear gave"


@pytest.fixture(scope="module")
def owner() -> api.Navigator:
    return api.Navigator.pretrained(labels=LABELS)


def doors(other: api.Navigator):
    yield lambda state: other.step(jax.random.key(0), state, other.observation((0.0, 0.0, 0.0)))
    yield lambda state: other.hear(state, "go to the cone")
    yield lambda state: other.take(state, "stop")
    yield from (other.candidates, other.missing, other.spoken)


@pytest.mark.parametrize(
    ("policy", "labels", "why"),
    [
        ("informed", ("gazebo", "cone"), "other labels than gazebo"),
        ("informed", ("cone", "hydrant"), "other labels than cone"),
        ("informed", (*LABELS, "gazebo"), "other labels than hydrant"),
        ("faithful", LABELS, "another policy than faithful"),
    ],
)
def test_a_state_of_another_navigator_is_refused(owner, policy: str, labels, why: str) -> None:
    other = api.Navigator.pretrained(policy, labels=labels)
    for state in (owner.start(SAID), owner.wait()):
        for door in doors(other):
            with pytest.raises(ValueError, match=why) as refusal:
                door(state)
            assert "\n" not in str(refusal.value)


def test_what_is_no_state_is_refused(owner) -> None:
    """In one line, by whatever takes one, before anything is compiled."""
    for door in doors(owner):
        with pytest.raises(ValueError, match="state is") as refusal:
            door(None)
        assert str(refusal.value) == STATE


def test_a_state_is_taken_by_a_navigator_alike(owner) -> None:
    """Other numbers are no other navigator, and a state may have been written to a file."""
    like = api.Navigator.pretrained(labels=list(LABELS), reach=2.0)
    state = owner.start(SAID)
    leaves, structure = jax.tree.flatten(state)
    read = jax.tree.unflatten(structure, [np.array(leaf) for leaf in leaves])
    for given in (state, owner.hear(state, "stop"), read):
        assert like.spoken(given) == ["hydrant"]


def test_a_state_of_the_engine_is_anybodys(owner) -> None:
    state = owner.start(SAID)
    bare = navigator.start(
        state.instruction, jnp.zeros(3), jnp.array([-9.0, 9.0, -9.0, 9.0]), config=owner.config
    )
    assert owner.spoken(bare) == ["hydrant"]
    assert owner.take(bare, "stop")[0].signature is not None


def test_states_are_stacked_and_traced(owner) -> None:
    states = jax.tree.map(lambda *leaves: np.stack(leaves), owner.start(SAID), owner.wait())
    with pytest.raises(ValueError, match=r"state is a batch of the shape \(2,\), but .* jax.vmap"):
        owner.hear(states, "stop")
    halted = jax.jit(jax.vmap(lambda state: replace(state, is_halted=jnp.asarray(True))))(states)
    first = jax.tree.map(lambda leaf: leaf[0], halted)
    assert owner.spoken(first) == ["hydrant"]
