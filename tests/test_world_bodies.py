"""Bodies: how a pose changes with a command, and what odometry says of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed import placed
from test_navigator_step import WORLD
from test_world_motion import KEY, action, motion, robot

from jaxlangnav import episode
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Status, default_sensor
from jaxlangnav.navigator import NavigatorConfig, api, default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.terrain import Terrain
from jaxlangnav.terrain.geodesic import geodesic
from jaxlangnav.terrain.walls import walls
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import HOLONOMIC, Unicycle
from jaxlangnav.world.sensor import sense as sense_eagerly
from jaxlangnav.world.state import Scenario

MOVE = jax.jit(lambda body, *rest: body.move(*rest))
sense = jax.jit(sense_eagerly)


def wheels(turn_rate: float) -> Unicycle:
    return Unicycle(turn_rate=jnp.float32(turn_rate))


def test_a_quarter_turn_of_half_a_turn_a_cycle_leaves_half_of_the_way() -> None:
    """From heading 0.7 to 0.7 + π/2 at π a cycle: 0.5 m of 1 m are left, along the new heading."""
    target = 0.7 + np.pi / 2
    state = MOVE(wheels(np.pi), KEY, robot(), action(np.cos(target), np.sin(target)), motion())
    assert float(state.heading) == pytest.approx(target, abs=1e-5)
    driven = 0.5 * np.array([np.cos(target), np.sin(target)])
    np.testing.assert_allclose(state.position, np.array([1.0, 2.0]) + driven, atol=1e-5)
    np.testing.assert_allclose(
        state.odometry, [*(np.array([1.5, 2.5]) + driven), target], atol=1e-5
    )
    np.testing.assert_allclose(state.distance, 3.5, atol=1e-5)


def test_who_has_to_turn_round_turns_first_the_shorter_way() -> None:
    target = 0.7 - 3.0
    state = MOVE(
        wheels(1.0), KEY, robot(), action(np.cos(target), np.sin(target)), motion(noise=0.3)
    )
    assert float(state.heading) == pytest.approx(0.7 - 1.0, abs=1e-5)
    np.testing.assert_array_equal(state.position, robot().position)
    np.testing.assert_array_equal(state.odometry[:2], robot().odometry[:2])


@pytest.mark.parametrize("stop", [action(0.0, 0.0), action(0.5, 0.5, is_stop=True)])
def test_a_stop_or_a_zero_step_changes_nothing(stop) -> None:
    state = MOVE(wheels(1.0), KEY, robot(), stop, motion(noise=0.5))
    jax.tree.map(np.testing.assert_array_equal, state, robot())


def test_who_turns_at_once_goes_where_a_holonomic_body_goes() -> None:
    for step in ((0.3, -0.4), (-3.0, 1.0), (0.0, 0.2)):
        free = MOVE(HOLONOMIC, KEY, robot(), action(*step, speed=0.6), motion(noise=0.1))
        turned = MOVE(wheels(1e6), KEY, robot(), action(*step, speed=0.6), motion(noise=0.1))
        np.testing.assert_allclose(free.position, turned.position, atol=1e-4)
        np.testing.assert_allclose(free.odometry[:2], turned.odometry[:2], atol=1e-4)
        np.testing.assert_allclose(np.cos(free.heading - turned.heading), 1.0, atol=1e-6)


def place(things: list[tuple[int, float, float]], **more) -> Scenario:
    return placed(things, slots=len(things), area=(0.0, 10.0, -5.0, 5.0), goal=1, **more)


def test_a_robot_on_two_wheels_follows_a_sentence() -> None:
    """The belief knows nothing of the body; it turns no faster than it can, and arrives."""
    driver = api.Navigator.pretrained()
    scene, body, sensor = place(WORLD), wheels(0.8), default_sensor()
    world = simulator.reset(scene)
    state = driver.start(
        "go to the hydrant behind the cone", (0.0, 0.0, 0.0), (0.0, 10.0, -5.0, 5.0)
    )
    for cycle in range(60):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(3), cycle), 3)
        state, order, info = driver.step(keys[0], state, sense(keys[1], world, scene, sensor))
        assert int(info.fault) == 0
        after = MOVE(body, keys[2], world, order, motion(noise=0.02))
        assert abs(float(after.heading - world.heading)) <= 0.8 + 1e-5
        world = after
        if order.is_stop:
            break
    assert Status(int(state.status)) == Status.ARRIVED
    assert float(simulator.goal_distance(world, scene)) <= simulator.SUCCESS_RADIUS


@pytest.mark.slow
def test_an_episode_among_walls_on_two_wheels() -> None:
    """A wall between start and goal: seen past its end, walked round, and never walked through."""
    ends = (3.5, -2.5, 3.5, 1.5)
    there = walls(ends)
    scene = place(
        [(1, 5.0, 0.0), (0, 6.8, 0.3)], terrain=Terrain(view=there, travel=geodesic(there))
    )
    instruction = understand("go to the hydrant behind the cone", load_shipped()).instruction
    config = NavigatorConfig(
        map=MapConfig(num_particles=32, num_objects=4, num_cells=24),
        planner=PlannerConfig(policy="informed", num_visited=8),
    )
    cycle = jax.jit(lambda one: episode.cycle(one, params=default_params(), config=config))
    one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], instruction)
    arrived, ways = 0, []
    for seed in range(6):
        task = episode.Task(
            key=jax.random.key(seed),
            scenario=scene,
            instruction_index=jnp.int32(0),
            sensor=default_sensor(4.0),
            motion=motion(noise=0.01),
            body=wheels(1.5),
        )
        progress, path = episode.begin(task, one, config=config), [np.zeros(2)]
        while not progress.navigator.is_done and progress.steps < 80:
            before = np.array(progress.world.position)
            progress, _, seen = cycle(progress)
            hidden = there.is_between(*jnp.asarray(before), scene.object_x, scene.object_y)
            kinds = set(np.asarray(seen.detection_type)[np.asarray(seen.is_detection)].tolist())
            assert not kinds & set(np.asarray(scene.object_type)[np.asarray(hidden)].tolist())
            path.append(np.array(progress.world.position))
        way = np.array(path)
        sides = jnp.asarray(way[:-1]).T, jnp.asarray(way[1:]).T
        assert not np.asarray(there.is_between(*sides[0], *sides[1])).any()
        result = episode.finish(progress)
        arrived += bool(result.is_success)
        ways.append(float(result.distance))
    assert arrived >= 5
    assert np.median(ways) > float(jnp.hypot(*scene.goal)) - simulator.SUCCESS_RADIUS
