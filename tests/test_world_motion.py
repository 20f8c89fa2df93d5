"""Motion, odometry, bodies and the simulator."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed import placed, standing

from jaxlangnav import episode
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Action, MotionParams, default_sensor
from jaxlangnav.navigator import NavigatorConfig, default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.terrain import OPEN, Terrain
from jaxlangnav.terrain.geodesic import among_walls, geodesic
from jaxlangnav.terrain.walls import walls
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import BODY_RADIUS, HOLONOMIC, Unicycle, stop_at_wall
from jaxlangnav.world.scenario import sample_scenario
from jaxlangnav.world.state import WorldState

KEY = jax.random.key(0)
move = jax.jit(HOLONOMIC.move)


def action(x: float, y: float, *, is_stop: bool = False, speed: float = 1.0) -> Action:
    return Action(
        waypoint=jnp.zeros(2),
        step=jnp.array([x, y], jnp.float32),
        is_stop=jnp.array(is_stop),
        status=jnp.int32(0),
        speed=jnp.float32(speed),
        clearance=jnp.float32(0.0),
    )


def motion(noise: float = 0.0, length: float = 1.0) -> MotionParams:
    return MotionParams(step_length=jnp.float32(length), odometry_noise=jnp.float32(noise))


def robot() -> WorldState:
    return standing(1.0, 2.0, 0.7, off=0.5, walked=3.0)


def test_without_noise_truth_and_odometry_move_alike() -> None:
    state = move(KEY, robot(), action(0.3, -0.4), motion())
    np.testing.assert_allclose(state.position, [1.3, 1.6], rtol=1e-6)
    np.testing.assert_allclose(state.odometry, [1.8, 2.1, np.arctan2(-4, 3)], rtol=1e-6)
    np.testing.assert_allclose(state.heading, np.arctan2(-4, 3), rtol=1e-6)
    np.testing.assert_allclose(state.distance, 3.5, rtol=1e-6)


@pytest.mark.parametrize(("speed", "expected"), [(1.0, 1.0), (0.5, 0.5), (2.0, 2.0), (10.0, 5.0)])
def test_a_robot_goes_no_further_than_its_step(speed: float, expected: float) -> None:
    state = move(KEY, robot(), action(3.0, 4.0, speed=speed), motion())
    np.testing.assert_allclose(
        state.position - robot().position, [0.6 * expected, 0.8 * expected], rtol=1e-5
    )
    np.testing.assert_allclose(state.distance, 3.0 + expected, rtol=1e-6)


def test_odometry_noise_is_a_share_of_the_way_on_each_axis() -> None:
    count, share = 8000, 0.02
    keys = jax.random.split(jax.random.key(1), count)
    step = action(0.3, 0.4)
    state = jax.vmap(lambda key: move(key, robot(), step, motion(share)))(keys)
    error = np.asarray(state.position) - [1.3, 2.4]
    sigma = share * 0.5
    standard_error = sigma / np.sqrt(count)
    assert (np.abs(error.mean(0)) < 5 * standard_error).all()
    assert (np.abs(error.std(0) - sigma) < 5 * standard_error / np.sqrt(2)).all()
    assert abs(np.corrcoef(error.T)[0, 1]) < 5 / np.sqrt(count)
    # The robot reads the step it asked for, whatever happened.
    np.testing.assert_allclose(state.odometry[:, :2], np.tile([1.8, 2.9], (count, 1)), rtol=1e-5)
    travelled = np.hypot(*(np.asarray(state.position) - [1.0, 2.0]).T)
    np.testing.assert_allclose(state.distance, 3.0 + travelled, rtol=1e-5)


def test_a_heading_that_drifts_bends_the_way_and_odometry_does_not_know() -> None:
    steady = replace(motion(), heading_bias=jnp.float32(0.2))
    start = replace(robot(), heading=robot().heading + 0.1)  # it has drifted by as much before
    state = move(KEY, start, action(0.6, 0.8), steady)
    np.testing.assert_allclose(state.odometry, [2.1, 3.3, np.arctan2(0.8, 0.6)], rtol=1e-6)
    np.testing.assert_allclose(state.heading - state.odometry[2], 0.3, atol=1e-6)
    along = np.arctan2(0.8, 0.6) + 0.2
    expected = [1.0 + np.cos(along), 2.0 + np.sin(along)]
    np.testing.assert_allclose(state.position, expected, rtol=1e-6)
    still = move(KEY, start, action(0.0, 0.0), replace(steady, turn_noise=jnp.float32(0.5)))
    chex.assert_trees_all_equal(still, start)


@pytest.mark.parametrize(
    ("name", "spread"), [("heading_noise", np.sqrt(0.5)), ("turn_noise", np.sqrt(0.2))]
)
def test_drift_grows_with_the_root_of_the_way_and_of_the_turn(name: str, spread: float) -> None:
    count, share = 8000, 0.1
    keys = jax.random.split(jax.random.key(2), count)
    step = action(0.5 * np.cos(0.9), 0.5 * np.sin(0.9))  # a turn of 0.2 rad, half a metre
    known = replace(motion(), **{name: jnp.float32(share)})
    state = jax.vmap(lambda key: move(key, robot(), step, known))(keys)
    drift = np.asarray(state.heading - state.odometry[:, 2])
    sigma = share * spread
    assert abs(drift.mean()) < 5 * sigma / np.sqrt(count)
    assert abs(drift.std() - sigma) < 5 * sigma / np.sqrt(2 * count)


@pytest.mark.parametrize(("offset", "expected"), [(1.49, True), (1.51, False)])
def test_success_is_a_stop_within_a_metre_and_a_half(offset: float, expected: bool) -> None:
    scenario = sample_scenario(KEY, template="1H1C", relation="null")
    start = simulator.reset(scenario)
    np.testing.assert_array_equal(start.position, [0.0, 0.0])
    state = replace(start, position=scenario.goal + jnp.array([0.0, offset]))
    assert float(simulator.goal_distance(state, scenario)) == pytest.approx(offset, abs=1e-5)
    assert bool(simulator.is_success(state.position, scenario, jnp.array(True))) is expected
    assert not bool(simulator.is_success(state.position, scenario, jnp.array(False)))
    # To find it is to have it in view, past no wall.
    x, y = np.asarray(scenario.goal).tolist()
    hidden = replace(scenario, terrain=among_walls((x - 1.0, y + 2.0, x + 1.0, y + 2.0)))
    away = scenario.goal + jnp.array([0.0, 2.5]), jnp.array(True)
    found = [bool(simulator.is_success(away[0], one, away[1], 3.0)) for one in (scenario, hidden)]
    assert found == [True, False]


def test_a_wall_halts_the_body_and_its_wheels() -> None:
    terrain, before = among_walls((2.0, 0.0, 2.0, 4.0)), robot()
    on = stop_at_wall(before, move(KEY, before, action(3.0, 0.0), motion(length=3.0)), terrain)
    np.testing.assert_allclose(on.position, [2.0 - BODY_RADIUS, 2.0], atol=1e-5)
    np.testing.assert_allclose(on.odometry, [1.5 + 0.75, 2.5, 0.0], atol=1e-5)
    np.testing.assert_allclose(on.distance, 3.75, atol=1e-5)
    # It stands against it, and may leave it.
    chex.assert_trees_all_close(
        stop_at_wall(on, move(KEY, on, action(1.0, 0.0), motion()), terrain).position, on.position
    )
    for place in (terrain, OPEN):
        back = move(KEY, on, action(-1.0, 0.0), motion())
        chex.assert_trees_all_equal(stop_at_wall(on, back, place), back)


MOVE = jax.jit(lambda body, *rest: body.move(*rest))


def wheels(turn_rate: float) -> Unicycle:
    return Unicycle(turn_rate=jnp.float32(turn_rate))


def test_a_quarter_turn_of_half_a_turn_a_cycle_leaves_half_of_the_way() -> None:
    """From heading 0.7 to 0.7 + π/2 at π a cycle: 0.5 m of 1 m are left, along the new heading."""
    target = 0.7 + np.pi / 2
    state = MOVE(wheels(np.pi), KEY, robot(), action(np.cos(target), np.sin(target)), motion())
    assert float(state.heading) == pytest.approx(target, abs=1e-5)
    x, y = 0.5 * np.cos(target), 0.5 * np.sin(target)
    np.testing.assert_allclose(state.position, [1.0 + x, 2.0 + y], atol=1e-5)
    np.testing.assert_allclose(state.odometry, [1.5 + x, 2.5 + y, target], atol=1e-5)
    np.testing.assert_allclose(state.distance, 3.5, atol=1e-5)


def test_who_has_to_turn_round_turns_first_the_shorter_way() -> None:
    target = 0.7 - 3.0
    turning = action(np.cos(target), np.sin(target))
    state = MOVE(wheels(1.0), KEY, robot(), turning, motion(noise=0.3))
    assert float(state.heading) == pytest.approx(0.7 - 1.0, abs=1e-5)
    np.testing.assert_array_equal(state.position, robot().position)
    np.testing.assert_array_equal(state.odometry[:2], robot().odometry[:2])


@pytest.mark.parametrize("body", [HOLONOMIC, wheels(1.0)], ids=["holonomic", "wheels"])
@pytest.mark.parametrize("stop", [action(0.0, 0.0), action(0.5, 0.5, is_stop=True)])
def test_a_stop_or_a_zero_step_changes_nothing_even_with_noise(body, stop: Action) -> None:
    chex.assert_trees_all_equal(MOVE(body, KEY, robot(), stop, motion(noise=0.5)), robot())


def test_who_turns_at_once_goes_where_a_holonomic_body_goes() -> None:
    for step in ((0.3, -0.4), (-3.0, 1.0), (0.0, 0.2)):
        free = MOVE(HOLONOMIC, KEY, robot(), action(*step, speed=0.6), motion(noise=0.1))
        turned = MOVE(wheels(1e6), KEY, robot(), action(*step, speed=0.6), motion(noise=0.1))
        np.testing.assert_allclose(free.position, turned.position, atol=1e-4)
        np.testing.assert_allclose(free.odometry[:2], turned.odometry[:2], atol=1e-4)
        np.testing.assert_allclose(np.cos(free.heading - turned.heading), 1.0, atol=1e-6)


@pytest.mark.slow
def test_an_episode_among_walls_on_two_wheels() -> None:
    """A wall between start and goal: seen past its end, walked round, and never walked through."""
    ends = (3.5, -2.5, 3.5, 1.5)
    there = walls(ends)
    terrain = Terrain(view=there, travel=geodesic(there))
    things, area = [(1, 5.0, 0.0), (0, 6.8, 0.3)], (0.0, 10.0, -5.0, 5.0)
    scene = placed(things, slots=2, area=area, goal=1, terrain=terrain)
    instruction = understand("go to the hydrant behind the cone", load_shipped()).instruction
    config = NavigatorConfig(
        map=MapConfig(num_particles=32, num_objects=4, num_cells=24),
        planner=PlannerConfig(policy="informed", num_visited=8),
    )
    cycle = jax.jit(lambda one: episode.advance(one, params=default_params(), config=config))
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
