"""The agent in hand-made worlds: a perfect sensor, a perfect robot, one decision at a time."""

import dataclasses
import json
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from refusals import assert_refused

from jaxlangnav import navigator
from jaxlangnav.grounding import AnnotationGrounder
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorConfig, api
from jaxlangnav.planner.config import SHIPPED, PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
AREA = (0.0, 10.0, -5.0, 5.0)
WORLD = [(CONE, 4.0, 0.5), (HYDRANT, 6.4, 0.8), (CONE, 2.5, -3.5)]
RANGE = 3.0


STEP = api._step  # compiled once for all files that drive the robot


@dataclasses.dataclass
class Run:
    state: navigator.NavigatorState
    places: list
    actions: list
    infos: list

    @property
    def end(self) -> np.ndarray:
        return self.places[-1]


def see(position, heading: float, places=WORLD):
    """Look round: every object in range is detected, without noise."""
    found = [
        (kind, x - position[0], y - position[1])
        for kind, x, y in places
        if np.hypot(x - position[0], y - position[1]) <= RANGE
    ]
    return by_hand.observation(
        np.array([*position, heading]), found, by_hand.sensor(RANGE, noise=0.02), size=8
    )


def go(
    robot,
    state,
    places=WORLD,
    start=(0.0, 0.0),
    max_steps: int = 60,
    seed: int = 0,
    disturb: Callable = lambda state, look, step: state,
) -> Run:
    """Drive until the robot stops; heading along the step. Each look may be disturbed before."""
    position, heading = np.array(start, float), 0.0
    record = Run(state, [position], [], [])
    for step in range(max_steps):
        look = see(position, heading, places)
        record.state = disturb(record.state, look, step)
        key = jax.random.fold_in(jax.random.key(seed), step)
        record.state, action, info = robot.step(key, record.state, look)
        record.actions.append(jax.tree.map(np.asarray, action))
        record.infos.append(info)
        if action.is_stop:
            assert np.allclose(action.step, 0.0)
            break
        move = np.asarray(action.step, float)
        position = position + move
        heading = np.arctan2(move[1], move[0]) if np.hypot(*move) > 0 else heading
        record.places.append(position)
    return record


def distance(run: Run, index: int, places=WORLD) -> float:
    return float(np.hypot(*(run.end - places[index][1:])))


def assert_arrived(run: Run, *nearest: int, places=WORLD) -> None:
    """It has ended its task within reach of one of these things."""
    assert Status(int(run.actions[-1].status)) == Status.ARRIVED
    assert bool(run.state.is_done)
    assert min(distance(run, index, places) for index in nearest) < 1.5


@pytest.mark.parametrize(
    ("said", "x", "y"),
    [
        ("hydrant on your left", 0.0, 6.0),
        ("hydrant on your right", 0.0, -6.0),
        ("hydrant in front of you", 6.0, 0.0),
        ("hydrant behind you", -6.0, 0.0),
        ("thing on your right", 1.5, -5.8),
    ],
)
def test_what_stands_against_the_robot_is_looked_for_there(robot, said, x: float, y: float) -> None:
    """Its mirror image is of the same type; half of all looks would go there first."""
    places = [(HYDRANT, x, y), (HYDRANT, -x, -y)]
    for seed in range(3):
        state = robot.start(f"go to the {said}", area=(-10.0, 10.0, -10.0, 10.0))
        run = go(robot, state, places, seed=seed)
        assert_arrived(run, 0, places=places)
        # 4.8 m straight on; there may be other tours of that side, but none of the other one.
        assert len(run.places) < 22
        assert min(np.hypot(*(np.asarray(run.places) - places[1][1:]).T)) > 5.0


def test_the_other_hydrant_is_not_taken(robot) -> None:
    """A hydrant in front of the cone is seen first and is not meant."""
    places = [*WORLD[:2], (HYDRANT, 2.2, 0.1)]
    run = go(robot, robot.start("go to the hydrant behind the cone", area=AREA), places)
    assert_arrived(run, 1, places=places)


def test_no_form_of_a_look_compiles_anew(robot) -> None:
    """Nor do numbers: slots, Python's numbers, attributes, ``Observation.of``, params, sensors."""
    state = robot.start("go to the cone", area=AREA)
    look = see((0.0, 0.0), 0.0)
    key = jax.random.key(0)
    _, expected, _ = robot.step(key, state, look)
    compiled = STEP._cache_size()
    short = jax.tree.map(lambda leaf: leaf[:4] if leaf.shape == (8,) else leaf, look)
    loose = jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), short)
    columns = loose.detection_type, loose.detection_range, loose.detection_bearing
    rows = list(zip(*columns, strict=True))[: int(look.is_detection.sum())]
    rows = [(robot.type_names[kind], *polar) for kind, *polar in rows]
    named = robot.observation((0.0, 0.0, 0.0), rows, look.sensor)
    plain = dataclasses.replace(short, detection_attribute=np.zeros(4, np.int32))
    for one in (short, loose, named, plain):
        _, action, _ = robot.step(key, state, one)
        assert np.array_equal(action.waypoint, expected.waypoint)
    assert robot.warm_up() >= 0.0
    known = robot.params.map
    params = replace(known, concentration=known.concentration + 1.0, misleading=jnp.float32(0.2))
    changed = replace(robot.params, mode_speed=jnp.array([2.0, 3.0, 1.0]), map=params)
    blind = replace(look, sensor=by_hand.sensor(2.0, 1.0, probability=0.5, noise=0.3))
    dataclasses.replace(robot, params=changed).step(key, state, blind)
    assert STEP._cache_size() == compiled


def test_the_types_of_a_task_are_named(robot) -> None:
    state = robot.start("go to the hydrant behind the cone on your left", area=AREA)
    assert sorted(robot.spoken(state)) == ["cone", "hydrant"]


def test_numbers_are_set_by_name(robot) -> None:
    own = api.Navigator.pretrained(odometry_noise=np.float32(0.05), misleading="10 %", reach=1)
    assert float(own.params.map.motion.odometry_noise) == pytest.approx(0.05)
    assert float(own.params.map.misleading) == pytest.approx(0.1)
    assert float(own.params.planner.reach) == 1.0
    rest = replace(
        own.params, map=robot.params.map, planner=replace(own.params.planner, reach=np.float32(1.2))
    )
    assert all(jax.tree.leaves(jax.tree.map(np.array_equal, rest, robot.params)))


NUMBERS = [
    ({"misleadin": 0.1}, "did you mean misleading"),
    ({"relations": 0.1}, "no number of the navigator"),
    ({"reach": -1.0}, "must be above 0 m"),
    ({"reach": 0}, "must be above 0 m"),
    ({"step_length": 0}, "must be above 0 m"),
    ({"step_length": "50 s"}, "unknown unit"),
    ({"absent": 2.0}, "at most 1"),
    ({"reach": float("nan")}, "finite"),
    ({"stop_probability": 2.0}, "at most 1"),
    ({"stop_probability": 1.0}, "stop_probability is 1, but must be above 0 and below 1"),
]
"""Numbers that cannot be, and what is said of them."""


def test_find_stops_once_it_is_in_view(robot) -> None:
    run = go(robot, robot.start("find the cone", area=AREA))
    assert bool(run.state.is_done)
    near = min(distance(run, 0), distance(run, 2))
    assert near <= RANGE
    walked = go(robot, robot.start("go to the cone", area=AREA))
    assert_arrived(walked, 0, 2)
    assert len(run.actions) < len(walked.actions)


def test_two_commands_in_order(robot) -> None:
    run = go(robot, robot.start("go to the cone then go to the hydrant", area=AREA))
    assert_arrived(run, 1)
    assert int(run.state.clause) == 1
    way = np.array(run.places)
    cones = [np.hypot(*(way - WORLD[index][1:]).T).min() for index in (0, 2)]
    assert min(cones) < 1.5


def test_hears_another_command_and_keeps_its_map(robot) -> None:
    run = go(robot, robot.start("go to the cone", area=AREA))
    first = int(np.argmin([distance(run, 0), 99.0, distance(run, 2)]))
    types = np.asarray(run.state.belief.particles.object_type)
    assert int(run.state.previous_goal) != NONE
    state = robot.hear(run.state, "go to the other cone")
    assert not bool(state.is_done)
    np.testing.assert_array_equal(state.belief.particles.object_type, types)
    again = go(robot, state, start=tuple(run.end), seed=1)
    assert_arrived(again, 2 - first)


@pytest.fixture
def told(robot) -> api.Navigator:
    """One that takes annotations in place of sentences."""
    return dataclasses.replace(robot, grounder=AnnotationGrounder(robot.type_names))


def form(*weighted: tuple) -> str:
    """Write annotations of "go to the <figure> <relation> the <landmark>", or of a figure alone."""
    readings = []
    for probability, figure, *related in weighted:
        relations = [{"figure": figure, "relation": one, "landmark": of} for one, of in related]
        things = [figure, *(landmark for _, landmark in related)]
        readings.append(
            {
                "probability": probability,
                "things": [{"id": thing, "type": thing} for thing in things],
                "relations": relations,
                "commands": [{"goal": {"thing": figure}}],
            }
        )
    return json.dumps({"readings": readings})


def test_what_the_robot_sees_settles_which_reading_is_meant(told) -> None:
    """The likelier reading puts the hydrant where there is none."""
    said = form((0.6, "hydrant", ("front", "cone")), (0.4, "hydrant", ("behind", "cone")))
    run = go(told, told.start(said, area=AREA))
    assert_arrived(run, 1)
    reading = np.asarray(run.state.belief.particles.reading)
    weight = np.exp(np.asarray(run.state.belief.log_weight))
    assert weight[reading == 1].sum() > 0.9


def test_where_the_likelier_thing_is_nowhere_the_other_will_do(robot, told) -> None:
    """Nothing said tells which thing is meant; there is no car, and the robot looks for it."""
    run = go(told, told.start(form((0.7, "car"), (0.3, "hydrant")), area=AREA))
    assert_arrived(run, 1)
    sure = go(robot, robot.start("go to the hydrant", area=AREA))
    assert len(run.actions) > len(sure.actions)


def test_annotations_may_speak_of_any_types(robot) -> None:
    """No lexicon, no training and no further compilation: the detector's names are enough."""
    types = ("gazebo", "bridge")
    assert (types.index("gazebo"), types.index("bridge")) == (HYDRANT, CONE)
    told = dataclasses.replace(robot, grounder=AnnotationGrounder(types))
    size = api._step._cache_size()
    run = go(told, told.start(form((1.0, "gazebo", ("behind", "bridge"))), area=AREA))
    assert distance(run, 1) < 1.5
    assert api._step._cache_size() == size
    state = told.hear(run.state, form((1.0, "bridge")))
    again = go(told, state, start=tuple(run.end), seed=1)
    assert_arrived(again, 0, 2)


def refusals():
    """What is never compiled, and what is said of it."""
    for numbers, words in NUMBERS:
        yield lambda one=numbers: api.Navigator.pretrained(**one), words
    good = navigator.default_params()
    for table, name, number, words in (
        ("planner", "discount", 1.0, "discount"),
        ("planner", "stop_probability", 0.0, "stop_prob"),
        ("planner", "stop_probability", 0.95, "concentration"),
        ("map", "concentration", 0.0, "concentration"),
        ("map", "concentration", 4.0, r"concentration 4 .* 89 % of the area"),
    ):
        own = replace(good, **{table: replace(getattr(good, table), **{name: jnp.float32(number)})})
        yield lambda own=own: navigator.check(own, policy=SHIPPED["faithful"]), words
    for sizes in ({"num_cells": 25}, {"num_particles": 1}, {"num_objects": 0}):
        yield lambda one=sizes: NavigatorConfig(map=MapConfig(**one)), "must be"
    for planner in ({"policy": "greedy"}, {"num_visited": 0}):
        yield lambda one=planner: PlannerConfig(**one), "must be"
    # Not to be folded into the 12 cells of a search map.
    cells, blocks = MapConfig(num_cells=32), PlannerConfig(policy="informed", num_blocks=8)
    yield lambda: NavigatorConfig(map=cells, planner=blocks), "must be"


def test_numbers_and_sizes_that_cannot_be_are_refused() -> None:
    assert_refused(refusals())


def test_who_may_be_told_of_many_things() -> None:
    good = navigator.default_params()
    faithful, informed = SHIPPED["faithful"], SHIPPED["informed"]
    navigator.check(good, policy=faithful)
    # One that takes the likeliest in the end may be told of many.
    many = replace(good, map=replace(good.map, concentration=jnp.float32(4.0)))
    navigator.check(many, policy=informed)
    # Where it is not known how many there are, seeing no more tells that there are not.
    unknown = replace(many, map=replace(many.map, clumping=jnp.float32(8.0)))
    navigator.check(unknown, policy=faithful)
    assert hash(NavigatorConfig()) == hash(NavigatorConfig())
