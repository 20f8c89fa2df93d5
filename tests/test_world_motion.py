"""Motion, odometry and the simulator."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.messages import (
    Action,
    MotionParams,
    Observation,
    SensorParams,
    default_motion,
    default_sensor,
)
from jaxlangnav.pytree import replace
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import carry_out as move_eagerly
from jaxlangnav.world.scenario import draw_scenario, sample_scenario, scenario_law
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

KEY = jax.random.key(0)
move = jax.jit(move_eagerly)


@jax.jit
def walk(
    key: jax.Array,
    state: WorldState,
    scenario: Scenario,
    action: Action,
    *,
    sensor: SensorParams,
    motion: MotionParams,
) -> tuple[WorldState, Observation]:
    """Move, then sense: what an episode and an environment do."""
    key_move, key_sense = jax.random.split(key)
    state = move_eagerly(key_move, state, action, motion)
    return state, sense(key_sense, state, scenario, sensor)


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
    return WorldState(
        position=jnp.array([1.0, 2.0]),
        heading=jnp.float32(0.7),
        odometry=jnp.array([1.5, 2.5, 0.7]),
        distance=jnp.float32(3.0),
    )


def test_without_noise_truth_and_odometry_move_alike() -> None:
    state = move(KEY, robot(), action(0.3, -0.4), motion())
    np.testing.assert_allclose(state.position, [1.3, 1.6], rtol=1e-6)
    np.testing.assert_allclose(state.odometry, [1.8, 2.1, np.arctan2(-4, 3)], rtol=1e-6)
    np.testing.assert_allclose(state.heading, np.arctan2(-4, 3), rtol=1e-6)
    np.testing.assert_allclose(state.distance, 3.5, rtol=1e-6)


@pytest.mark.parametrize("stop", [action(0.0, 0.0), action(0.5, 0.5, is_stop=True)])
def test_a_stop_or_a_zero_step_changes_nothing_even_with_noise(stop: Action) -> None:
    chex.assert_trees_all_equal(move(KEY, robot(), stop, motion(noise=0.5)), robot())


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
    np.testing.assert_allclose(
        state.position, [1.0 + np.cos(along), 2.0 + np.sin(along)], rtol=1e-6
    )
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


def test_a_run_to_the_goal_succeeds_only_with_a_stop() -> None:
    scenario = sample_scenario(KEY, template="1H1C", relation="behind")
    state = simulator.reset(scenario)
    np.testing.assert_array_equal(state.position, [0.0, 0.0])
    assert float(simulator.goal_distance(state, scenario)) == pytest.approx(
        float(np.hypot(*scenario.goal))
    )
    way = np.asarray(scenario.goal) / np.hypot(*scenario.goal)
    for index in range(30):
        if simulator.goal_distance(state, scenario) <= 1.4:
            break
        state, observation = walk(
            jax.random.fold_in(KEY, index),
            state,
            scenario,
            action(*way),
            sensor=default_sensor(3.0),
            motion=default_motion(),
        )
    assert bool(observation.is_detection.any())
    assert bool(simulator.is_success(state, scenario, jnp.array(True)))
    assert not bool(simulator.is_success(state, scenario, jnp.array(False)))


@pytest.mark.parametrize(("offset", "expected"), [(1.49, True), (1.51, False)])
def test_success_is_a_stop_within_a_metre_and_a_half(offset: float, expected: bool) -> None:
    scenario = sample_scenario(KEY, template="1H1C", relation="null")
    start = simulator.reset(scenario)
    state = WorldState(
        position=scenario.goal + jnp.array([0.0, offset]),
        heading=start.heading,
        odometry=start.odometry,
        distance=start.distance,
    )
    assert bool(simulator.is_success(state, scenario, jnp.array(True))) is expected


def test_an_episode_of_data_traces_once_and_its_batch_equals_a_loop() -> None:
    def run(key, scenario, sensor, motion):
        """Walk five steps ahead; the way an episode uses the simulator."""

        def advance(state, key):
            state, observation = walk(
                key, state, scenario, action(1.0, 0.2), sensor=sensor, motion=motion
            )
            return state, observation.is_detection.sum()

        return jax.lax.scan(advance, simulator.reset(scenario), jax.random.split(key, 5))

    chex.clear_trace_counter()
    traced = jax.jit(chex.assert_max_traces(run, n=1))
    keys = jax.random.split(KEY, 4)
    worlds = [
        draw_scenario(key, scenario_law(template=template, relation=relation))
        for key, template, relation in zip(
            keys,
            ("1H1C", "2H1C", "2H2C", "3H3C"),
            ("null", "behind", "nearest", "behind"),
            strict=True,
        )
    ]
    loop = [
        traced(key, scenario, default_sensor(distance), motion(noise))
        for key, scenario, distance, noise in zip(
            keys, worlds, (3, 5, 5, 5), (0, 0.02, 0.1, 0.02), strict=True
        )
    ]
    for key, scenario, (state, count) in zip(keys[1:], worlds[1:], loop[1:], strict=True):
        again = traced(key, scenario, default_sensor(5.0), motion(0.02))
        assert again[1].shape == count.shape == (5,)
        assert np.isfinite(state.distance)
    stack = jax.tree.map(lambda *leaves: jnp.stack(leaves), *worlds)
    batch = jax.vmap(run, in_axes=(0, 0, None, None))(
        keys, stack, default_sensor(5.0), motion(0.02)
    )
    single = [
        run(key, scenario, default_sensor(5.0), motion(0.02))
        for key, scenario in zip(keys, worlds, strict=True)
    ]
    expected = jax.tree.map(lambda *leaves: jnp.stack(leaves), *single)
    chex.assert_trees_all_close(batch, expected, atol=1e-5)
