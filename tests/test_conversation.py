"""A conversation driven: what each kind of utterance does to where the robot ends."""

import dataclasses
import functools
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_navigator_step import AREA, CONE, HYDRANT, assert_arrived, distance, go, see

from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.language.utterance import Kind, classify
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import api
from jaxlangnav.navigator.candidates import Candidate, select_candidate
from jaxlangnav.pytree import replace

CAR = 2
WORLD = [(HYDRANT, 4.0, 2.5), (HYDRANT, 4.5, -2.5), (CONE, 2.0, -3.0), (CAR, 8.0, 3.0)]
NEAR_HYDRANT, FAR_HYDRANT, ONE_CONE, ONE_CAR = range(4)
NULL = "go to the hydrant"
away = functools.partial(distance, places=WORLD)
arrives = functools.partial(assert_arrived, places=WORLD)


def set_out(robot, text: str = NULL, max_steps: int = 4, places=WORLD):
    return go(robot, robot.start(text, area=AREA), places, max_steps=max_steps)


def tell(robot, run, *texts: str, places=WORLD, max_steps: int = 60):
    """Say something to a robot where a run has left it, and drive on."""
    state = run.state
    for text in texts:
        state, heard = robot.take(state, text)
    return heard, go(robot, state, places, start=tuple(run.end), seed=3, max_steps=max_steps)


def ended(run) -> Status:
    return Status(int(run.actions[-1].status))


@pytest.mark.parametrize(
    ("text", "kind", "end"),
    [
        ("no, the other one", Kind.CORRECTION, FAR_HYDRANT),
        ("no", Kind.CORRECTION, FAR_HYDRANT),
        ("not that one, the one by the cone", Kind.CORRECTION, FAR_HYDRANT),
        ("go to the other hydrant", Kind.COMMAND, FAR_HYDRANT),
        ("I meant the car", Kind.CORRECTION, ONE_CAR),
        ("the hydrant is near the cone", Kind.STATEMENT, FAR_HYDRANT),
    ],
)
def test_another_one_is_found(robot, text: str, kind: Kind, end: int) -> None:
    run = set_out(robot)
    assert int(run.state.talk.approached) == 0
    heard, after = tell(robot, run, text)
    assert heard.kind == kind
    assert (heard.ruled_out == (0,)) == ("other" in text or text.startswith("no"))
    arrives(after, end)


def test_an_arrival_is_corrected_until_there_is_no_other(robot) -> None:
    run = set_out(robot, max_steps=60)
    assert ended(run) == Status.ARRIVED
    _, other = tell(robot, run, "that's not it")
    arrives(other, FAR_HYDRANT)
    _, none = tell(robot, other, "wrong one")
    assert ended(none) == Status.NOT_FOUND
    mass = np.asarray([info.goals.object_mass for info in none.infos])
    assert mass[:, :2].max() == 0.0
    # What is pruned takes what was said of it along: another thing may take its slot.
    assert int(none.state.talk.ruled_out) == 0b11
    particles = none.state.belief.particles
    particles = replace(particles, object_type=jnp.full_like(particles.object_type, NONE))
    gone = replace(none.state, belief=replace(none.state.belief, particles=particles))
    after, *_ = robot.step(jax.random.key(1), gone, see(none.end, 0.0, ()))
    assert int(after.talk.ruled_out) == int(after.talk.context.excluded.max()) == 0
    assert int(after.previous_goal) == int(after.talk.approached) == NONE


@pytest.mark.parametrize("text", ["no, the other one", "no", "closer", "go to the other hydrant"])
def test_nothing_approached_is_no_other(robot, text: str) -> None:
    """Where nothing has been approached there is no coin to toss."""
    with pytest.raises(ValueError, match="approached yet") as refusal:
        robot.hear(robot.start(NULL, area=AREA), text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["go to the other hydrant", "go to the other one"])
def test_at_first_there_is_no_other(robot, text: str) -> None:
    with pytest.raises(ValueError, match="spoken of yet, so there is no other") as refusal:
        robot.start(text, area=AREA)
    assert "\n" not in str(refusal.value)
    for fine in ("go to the cone then go to the other cone", "go to the cone near the other cone"):
        robot.start(fine, area=AREA)


def test_any_candidate_can_be_chosen_by_its_place() -> None:
    found = [Candidate(slot=n, type_name="cone", x=n, y=0.0, probability=0.2) for n in range(7)]
    pose = np.zeros(3)
    for text, slot in (("the first", 0), ("the fourth", 3), ("number 6", 5), ("the last", 6)):
        chosen = select_candidate(classify(text, is_asked=True).wording, found, pose)
        assert chosen is found[slot]
    assert select_candidate(classify("the fourth", is_asked=True).wording, found[:3], pose) is None


def test_a_statement_changes_no_task(robot) -> None:
    run = set_out(robot, "go to the car")
    state, heard = robot.take(run.state, "the hydrant is behind the car")
    assert heard.kind == Kind.STATEMENT
    names = ("clause", "status", "is_halted", "previous_goal")
    before, after = (
        (one.instruction.clauses, *(getattr(one, name) for name in names))
        for one in (run.state, state)
    )
    jax.tree.map(np.testing.assert_array_equal, before, after)
    _, after = tell(robot, run, "the hydrant is behind the car")
    arrives(after, ONE_CAR)


def test_an_ended_robot_that_is_informed_stays_where_it_is(robot) -> None:
    run = set_out(robot, "go to the car", max_steps=60)
    _, after = tell(robot, run, "the hydrant is behind the cone", max_steps=3)
    assert [Status(int(action.status)) for action in after.actions] == [Status.ARRIVED]


def test_what_is_to_be_avoided_is_never_a_goal(robot) -> None:
    idle = go(robot, robot.wait(area=AREA), WORLD, max_steps=1)
    heard, after = tell(robot, idle, "steer clear of the cone", max_steps=3)
    assert heard.kind == Kind.CONSTRAINT
    assert {int(action.status) for action in after.actions} == {Status.IDLE}
    np.testing.assert_array_equal(after.end, (0.0, 0.0))
    run = set_out(robot, "go to the car", max_steps=2)
    # Two things to keep away from: it goes to and fro before the gap between them.
    _, told = tell(robot, run, "avoid the cone", "avoid the hydrant", max_steps=120)
    arrives(told, ONE_CAR)
    constraint = np.asarray([info.behavior.constraint for info in told.infos])
    assert constraint[-1].max() > 0.9
    goals = np.asarray([info.goals.object_mass for info in told.infos])
    types = np.asarray(told.state.belief.particles.object_type)[:, 0]
    assert goals[:, :-1][:, types != CAR].max() < 0.01
    # The very thing may be asked for all the same.
    _, there = tell(robot, told, NULL)
    assert min(away(there, NEAR_HYDRANT), away(there, FAR_HYDRANT)) < 1.5


def test_an_addition_comes_after_the_task(robot) -> None:
    heard, after = tell(robot, set_out(robot), "and after that go to the car")
    assert heard.kind == Kind.ADDITION
    arrives(after, ONE_CAR)
    passed = np.hypot(*(np.asarray(after.places) - WORLD[NEAR_HYDRANT][1:]).T)
    assert passed.min() < 1.5
    # At its end, it begins at once.
    _, back = tell(robot, after, "then go to the cone")
    assert away(back, ONE_CONE) < 1.5


def test_more_commands_than_are_held_are_refused(robot) -> None:
    state = robot.start("go to the hydrant, then to the car, then to the cone", area=AREA)
    with pytest.raises(ValueError, match="at most 3"):
        robot.hear(state, "then go to the car")


def test_it_comes_back_and_comes_closer(robot) -> None:
    run = set_out(robot, max_steps=60)
    heard, back = tell(robot, run, "come back")
    assert heard.kind == Kind.RETURN
    assert ended(back) == Status.ARRIVED
    assert np.hypot(*back.end) < 1.25
    _, near = tell(robot, run, "closer")
    assert ended(near) == Status.ARRIVED
    assert away(near, NEAR_HYDRANT) <= 0.65 < away(run, NEAR_HYDRANT)


def test_it_is_what_is_being_approached(robot) -> None:
    _, after = tell(robot, set_out(robot), "go behind it")
    assert ended(after) == Status.ARRIVED
    hydrant = np.asarray(WORLD[NEAR_HYDRANT][1:])
    assert np.hypot(*(after.end - hydrant)) < 3.0
    assert np.hypot(*after.end) > np.hypot(*hydrant)


def test_halting_words_halt_whatever_else_is_said(robot) -> None:
    run = set_out(robot)
    for text in ("stop, avoid the cone", "Stop! The hydrant is behind the car"):
        state, heard = robot.take(run.state, text)
        assert heard.kind == Kind.HALT
        assert bool(state.is_halted)
    for text in ("the car is behind the cone", "avoid the cone", "then go to the cone"):
        assert bool(robot.hear(state, text).is_halted), text
    assert not bool(robot.hear(state, "no, the other one").is_halted)


def curious(robot, cost: float = 0.05):
    """Ask where it is worth it; with the tables' numbers others are soon thought of."""
    planner = replace(robot.params.planner, question_cost=np.float32(cost))
    believed = replace(robot.params.map, misleading=np.float32(0.05), clumping=np.float32(0.0))
    params = replace(robot.params, planner=planner, map=believed)
    return dataclasses.replace(robot, params=params)


def leftmost(run, places) -> int:
    """Tell which of some things is the left one, as the robot stands where it asks."""
    x, y, turn = np.asarray(run.state.belief.last_pose)
    return int(np.argmax([(b - y) * np.cos(turn) - (a - x) * np.sin(turn) for _, a, b in places]))


@pytest.mark.parametrize(
    ("answer", "end"), [("the left one", NEAR_HYDRANT), ("the one by the cone", FAR_HYDRANT)]
)
def test_a_question_in_place_of_a_guess(robot, answer: str, end: int) -> None:
    asking = curious(robot)
    run = set_out(asking, max_steps=60)
    assert ended(run) == Status.WHICH_ONE
    assert bool(run.actions[-1].is_stop)
    found = asking.candidates(run.state)
    assert {one.type_name for one in found} == {"hydrant"}
    assert len(found) == 2
    assert sum(one.probability for one in found) > 0.8
    heard, after = tell(asking, run, answer)
    assert heard.kind == Kind.ANSWER
    assert ended(after) == Status.ARRIVED
    if answer == "the left one":
        end = leftmost(run, WORLD[:2])
    assert away(after, end) < 1.5


def test_an_answer_that_is_none_is_refused_and_none_of_them_searches_on(robot) -> None:
    asking = curious(robot)
    run = set_out(asking, max_steps=60)
    with pytest.raises(ValueError, match="may be one of 2"):
        asking.hear(run.state, "yes")
    _, any_of = tell(asking, run, "you choose")
    assert ended(any_of) == Status.ARRIVED
    _, none = tell(asking, run, "neither of them")
    assert ended(none) == Status.NOT_FOUND


def test_one_candidate_is_no_question(robot) -> None:
    places = [WORLD[NEAR_HYDRANT], WORLD[ONE_CONE]]
    run = set_out(curious(robot), max_steps=60, places=places)
    assert ended(run) == Status.ARRIVED


def test_a_robot_that_makes_no_way_tries_others_and_says_so(robot) -> None:
    state, statuses, sent = robot.start(NULL, area=AREA), [], []
    for step in range(60):
        key = jax.random.fold_in(jax.random.key(1), step)
        state, action, info = robot.step(key, state, see((1.0, 0.0), 0.0, WORLD))
        statuses.append(Status(int(action.status)))
        sent.append(np.asarray(info.choice.waypoint_x + 100.0 * info.choice.waypoint_y))
        if action.is_stop:
            break
    assert statuses[-1] == Status.BLOCKED
    assert len(statuses) > (robot.config.num_detours + 1) * robot.config.patience
    assert len(np.unique(np.round(sent, 1))) > robot.config.num_detours
    np.testing.assert_array_equal(action.step, 0.0)
    free = go(robot, robot.hear(state, NULL), WORLD, start=(1.0, 0.0))
    assert ended(free) == Status.ARRIVED


STREAM = (
    "the cone is near the hydrant", "then go to the car", "no, the other one", "avoid the cone",
    "stop", "carry on", "go to the hydrant behind the car", "closer", "come back", "never mind",
    "the car is on your left", "find the other hydrant", "go to it", "not that one, the left one",
    "wait",
)  # fmt: skip


def test_nothing_said_is_compiled(robot) -> None:
    run = set_out(robot)
    before, state = api._step._cache_size(), run.state
    kinds = set()
    for index, text in enumerate(STREAM):
        # As if the robot were at something, whatever became of the last utterance.
        state = replace(state, talk=replace(state.talk, approached=run.state.talk.approached))
        state, heard = robot.take(state, text)
        kinds.add(heard.kind)
        state, action, _ = robot.step(jax.random.key(index), state, see(run.end, 0.0, WORLD))
        assert np.isfinite(action.step).all()
    assert kinds == set(Kind) - {Kind.ANSWER}
    assert api._step._cache_size() == before


def test_what_finds_no_room_leaves_the_oldest_first_and_is_counted(robot) -> None:
    state = set_out(robot, max_steps=1).state
    number, notes = 0, ()
    for side in ("left of", "behind", "in front of", "near", "right of"):
        for thing in ("hydrant", "cone"):
            state, heard = robot.take(state, f"the {thing} is {side} the car")
            number, notes = number + 1, notes + heard.notes
    held = np.asarray(state.instruction.readings.relation)[0]
    most = Capacity().num_relations
    assert (held >= 0).sum() == most
    assert int(state.talk.words.num_dropped) == number - most
    assert np.asarray(state.talk.words.heard)[0].min() == number - most + 1
    assert len(notes) == number - most


def test_sizes_that_do_not_fit_are_refused(robot) -> None:
    with pytest.raises(ValueError, match="at least 6"):
        Capacity(num_mentions=5)
    with pytest.raises(ValueError, match="at most 31"):
        dataclasses.replace(robot, capacity=Capacity(num_mentions=32))


# ---------------- after ``warm_up`` no utterance compiles anything: JAX counts, in its own process

SAID = (
    "go to the cone", "then go to the cone", "there is a tree left of the cone",
    "keep away from the car", "go three metres forward", "no, I meant the cone",
    "not that one, the one by the cone", "go to the other hydrant", "stop", "go on",
    "never mind", "come back", "the other one", "closer", "never mind, come back",
)  # fmt: skip
ANSWERS = ("the left one", "the second", "the nearest", "any", "no", "the one by the cone")


def talk_and_count_compilations() -> None:
    compiled = []

    def listen(name, seconds, **about):
        if name.endswith("backend_compile_duration"):
            compiled.append(about.get("fun_name"))

    # The decision cycle, most of a minute to compile, is counted in test_navigator_step.
    api._step = lambda key, state, look, **rest: (state, None, None)
    jax.monitoring.register_event_duration_secs_listener(listen)
    for numbers in ({}, {"heading_noise": 0.01}):
        one = api.Navigator.pretrained(**numbers)
        one.warm_up()
        compiled.clear()
        converse(one, compiled)


def converse(one, compiled: list) -> None:
    idle = one.wait()
    state = one.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    one.start("go two metres forward and then one metre to the left")
    assert not compiled, compiled
    # Two things seen may be meant, the first of which is approached; made without JAX.
    shares, particles = np.zeros_like(state.talk.candidate), state.belief.particles
    shares[:2] = 0.6, 0.4
    kinds = np.array(particles.object_type)
    kinds[:2] = 0
    particles = replace(particles, object_type=jax.device_put(kinds))
    talk = replace(state.talk, approached=jnp.int32(0), candidate=jax.device_put(shares))
    state = replace(state, belief=replace(state.belief, particles=particles), talk=talk)
    asked = replace(state, status=jnp.int32(Status.WHICH_ONE))
    shapes = jax.tree.map(jax.typeof, state)
    for told, texts in ((idle, SAID[:4]), (state, SAID), (asked, ANSWERS)):
        for text in texts:
            after, heard = one.take(told, text)
            assert jax.tree.map(jax.typeof, after) == shapes, text
            bool(after.is_resting)
            for ask in (one.candidates, one.missing, one.spoken):
                ask(after)
            print(heard.kind.name, text)
            assert not compiled, (text, compiled)


def test_after_warming_up_no_utterance_compiles_anything() -> None:
    code = "import test_conversation as t; t.talk_and_count_compilations()"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=Path(__file__).parent, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-1000:]
    kinds = {line.split()[0] for line in done.stdout.splitlines()}
    assert kinds == {kind.name for kind in Kind}
