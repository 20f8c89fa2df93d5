"""Baselines: they sweep what they say they sweep, and see no more than the robot sees."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments import baselines
from jaxlangnav.experiments.policies import run_policy
from jaxlangnav.experiments.rows import RowSpec, bound_rows
from jaxlangnav.experiments.tasks import BLOCK, SENTENCES, Cell, ground_sentences, make_tasks
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import replace
from jaxlangnav.world.simulator import SUCCESS_RADIUS

SEARCHES = ("frontier", "lawnmower", "arc")


@pytest.fixture(scope="module")
def instructions() -> Any:
    return ground_sentences(list(SENTENCES.values())).instructions


@pytest.fixture(scope="module")
def tasks() -> Task:
    return make_tasks(Cell(world="2H1C", relation="behind", instruction_index=1, seed=7), BLOCK)


def run(policy: str, tasks: Task, instructions: Any) -> EpisodeResult:
    return run_policy(policy, tasks, instructions)


def test_figure_types_are_those_of_the_sentences(instructions: Any) -> None:
    figure_types = jax.vmap(baselines._figure_type)
    np.testing.assert_array_equal(figure_types(instructions), [0, 0, 0])
    other = ground_sentences(["go to the cone near the tree"]).instructions
    np.testing.assert_array_equal(figure_types(other), [1])


@pytest.mark.parametrize("reach", [2.0, 3.0, 5.0, 20.0])
def test_two_passes_see_the_whole_area(reach: float) -> None:
    area = np.array([0.0, 13.0, -9.2, 9.2])
    num_lanes = int(np.ceil(13.0 / (2 * reach)))
    points = [np.zeros(2)]
    for leg in range(4 * num_lanes):
        args = jnp.asarray(area), jnp.float32(reach), jnp.int32(leg)
        points.append(np.array(baselines._lane_waypoint(*args)))
    path = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(points)])
    x, y = np.meshgrid(np.linspace(0.01, 12.99, 40), np.linspace(-9.19, 9.19, 40))
    cells = np.stack([x.ravel(), y.ravel()], axis=1)
    nearest = np.sqrt(((cells[:, None] - path[None]) ** 2).sum(-1)).min(axis=1)
    # Corners of lanes: at worst half a lane across and 0.3 R along lie out of view.
    assert np.mean(nearest <= reach) > 0.995
    assert np.all(nearest <= 1.05 * reach)


def test_arcs_by_hand() -> None:
    area = jnp.array([0.0, 10.0, -7.0, 7.0])
    reach = jnp.float32(2.0)
    points = np.array([baselines._arc_waypoint(area, reach, jnp.int32(leg)) for leg in range(24)])
    radius = np.hypot(points[:, 0], points[:, 1])
    np.testing.assert_allclose(radius, np.repeat([6.6, 9.5, 3.4], 8), rtol=1e-5)
    angle = np.arctan2(points[:, 1], points[:, 0])
    widest = np.pi / 4 - np.arcsin(1.6 / 6.6)
    np.testing.assert_allclose(angle[:8], np.linspace(-widest, widest, 8), atol=1e-5)
    # The next pass comes back the other way; after three it mows the lawn.
    assert angle[8] == pytest.approx(-angle[15], abs=1e-5)
    assert angle[8] > 0.0
    after = baselines._arc_waypoint(area, reach, jnp.int32(24))
    np.testing.assert_allclose(after, baselines._lane_waypoint(area, reach, jnp.int32(0)))


@pytest.mark.slow
def test_knowing_the_law_is_worth_metres(instructions: Any) -> None:
    tasks = make_tasks(Cell(world="1H1C", relation="null", seed=11), BLOCK)
    mean = {name: float(np.mean(run(name, tasks, instructions).distance)) for name in SEARCHES}
    assert mean["arc"] < mean["frontier"] < mean["lawnmower"]


def test_the_known_map_goes_straight(tasks: Task, instructions: Any) -> None:
    result = run("known", tasks, instructions)
    assert np.all(result.is_success)
    straight = np.linalg.norm(np.asarray(tasks.scenario.goal), axis=1)
    np.testing.assert_allclose(result.distance, straight, rtol=0.03, atol=0.1)


@pytest.mark.slow
def test_a_blind_search_is_right_half_of_the_time(tasks: Task, instructions: Any) -> None:
    for policy in SEARCHES:
        result = run(policy, tasks, instructions)
        assert abs(np.mean(result.is_success) - 0.5) < 5 * np.sqrt(0.25 / BLOCK), policy
        assert np.mean(result.is_stopped) > 0.99
        # It stops by a hydrant, if not by the right one.
        final = np.asarray(result.final)
        to_hydrants = np.hypot(
            np.asarray(tasks.scenario.object_x)[:, :2] - final[:, :1],
            np.asarray(tasks.scenario.object_y)[:, :2] - final[:, 1:],
        ).min(axis=1)
        assert np.all(to_hydrants[result.is_stopped] < SUCCESS_RADIUS)


def test_what_is_not_seen_changes_nothing(tasks: Task, instructions: Any) -> None:
    """The same robot, the same noise, other objects: blind, it must walk the same way."""
    blind = replace(tasks, sensor=replace(tasks.sensor, detection_probability=jnp.zeros(BLOCK)))
    worlds = blind.scenario
    others = {"object_x": worlds.object_x[::-1], "object_y": worlds.object_y + 1.0}
    moved = replace(blind, scenario=replace(worlds, goal=worlds.goal[::-1], **others))
    for policy in SEARCHES:
        one, other = run(policy, blind, instructions), run(policy, moved, instructions)
        np.testing.assert_array_equal(one.final, other.final)
        np.testing.assert_array_equal(one.distance, other.distance)
        assert not np.any(one.is_stopped)


def test_a_noiseless_walk_by_hand(instructions: Any) -> None:
    """A hydrant in view at the start: straight to it, stop within reach."""
    tasks = make_tasks(RowSpec(world="1H1C", range=5.0, relation="null").setting(seed=0), BLOCK)
    worlds, none, sure = tasks.scenario, jnp.zeros(BLOCK), jnp.ones(BLOCK)
    worlds = replace(
        worlds,
        object_x=worlds.object_x.at[:, 0].set(4.0),
        object_y=worlds.object_y.at[:, 0].set(0.0),
        goal=jnp.broadcast_to(jnp.array([4.0, 0.0]), (BLOCK, 2)),
    )
    sensor = replace(tasks.sensor, detection_probability=sure, noise=none)
    motion = replace(tasks.motion, odometry_noise=none)
    tasks = replace(tasks, scenario=worlds, sensor=sensor, motion=motion)
    reach = float(PlannerParams().reach)
    for policy in SEARCHES:
        result = run(policy, tasks, instructions)
        assert np.all(result.is_success)
        # Whole steps of a metre, the last one cut short at the target.
        expected = 4.0 if reach < 1.0 else 4.0 - np.floor(reach)
        np.testing.assert_allclose(result.distance, expected, atol=1e-4)


def test_limits_of_rows() -> None:
    rows = [RowSpec(world="2H1C", range=3.0, relation=one) for one in ("null", "behind")]
    null, behind = bound_rows(rows)
    assert null["success"] == 50.0
    assert null["known"] == pytest.approx(10.49)
    assert behind["success"] == 100.0
