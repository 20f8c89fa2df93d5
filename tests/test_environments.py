"""Our worlds as environments: the laws of reset and step, and Gymnasium's own checks."""

import warnings

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from jaxlangnav.environments import functional
from jaxlangnav.environments.gymnasium_env import ID, FollowVectorEnv
from jaxlangnav.experiments.sentences import SENTENCES
from jaxlangnav.pytree import replace
from jaxlangnav.world.templates import RELATION_NAMES

STOP = jnp.array([0.0, 0.0, 1.0])


def test_commands_are_those_of_the_tables() -> None:
    assert tuple(functional.COMMANDS) == RELATION_NAMES
    assert dict(SENTENCES) == functional.COMMANDS


def test_the_observation_says_what_is_sensed() -> None:
    params = functional.default_params(sensing_range=50.0)
    noiseless = replace(
        params.sensor, detection_probability=jnp.float32(1.0), noise=jnp.float32(0.0)
    )
    observation, state = functional.reset(jax.random.key(3), replace(params, sensor=noiseless))
    assert observation.shape == (functional.OBSERVATION_SIZE,)
    assert observation[:4].tolist() == [0.0, 0.0, 1.0, 0.0]
    np.testing.assert_allclose(observation[4:8], state.scenario.area)
    assert observation[8:12].tolist() == [50.0, 0.0, 1.0, 0.0]
    seen = np.asarray(observation[12:]).reshape(-1, 5)
    assert seen[:, 0].tolist() == [1.0, 1.0, *[0.0] * 6]
    assert not seen[2:].any()
    # Facing +x from the origin, the robot's frame is the map's; the cone is nearer.
    kinds, places = seen[:2, 3:], seen[:2, 1:3]
    np.testing.assert_array_equal(kinds, [[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_allclose(places[1], state.scenario.goal, atol=1e-4)


def test_going_to_the_goal_and_stopping_is_rewarded() -> None:
    params = functional.default_params(metre_cost=0.01)
    _, state = functional.reset(jax.random.key(0), params)
    total, keys = 0.0, jax.random.split(jax.random.key(1), 40)
    for key in keys:
        way = state.scenario.goal - state.world.position
        action = jnp.append(jnp.clip(way, -1.0, 1.0), -1.0)
        if jnp.hypot(way[0], way[1]) < 1.0:
            action = STOP
        _, state, reward, is_over, info = functional.step(key, state, action, params)
        total += float(reward)
        if is_over:
            break
    assert bool(info.is_success)
    assert total == pytest.approx(1.0 - 0.01 * float(info.distance), abs=1e-5)


def test_stopping_elsewhere_earns_nothing_and_time_runs_out() -> None:
    params = functional.default_params(max_steps=2)
    _, state = functional.reset(jax.random.key(0), params)
    _, _, reward, is_over, info = functional.step(jax.random.key(1), state, STOP, params)
    assert (float(reward), bool(is_over), bool(info.is_success)) == (0.0, True, False)
    still = jnp.array([0.0, 0.0, -1.0])
    for expected in (False, True):
        _, state, _, is_over, info = functional.step(jax.random.key(1), state, still, params)
        assert (bool(is_over), bool(info.is_cut_off)) == (expected, expected)
        assert float(info.distance) == 0.0


def test_a_long_step_is_shortened() -> None:
    params = functional.default_params()
    _, state = functional.reset(jax.random.key(0), params)
    action = jnp.array([1.0, 1.0, -1.0])
    observation, _, _, _, _ = functional.step(jax.random.key(1), state, action, params)
    assert float(jnp.hypot(observation[0], observation[1])) == pytest.approx(1.0, abs=1e-5)


def test_lanes_are_alike_alone_and_together() -> None:
    params = functional.default_params(world="2H1C")
    keys = jax.random.split(jax.random.key(7), 5)
    together, _ = jax.vmap(functional.reset, in_axes=(0, None))(keys, params)
    alone = [functional.reset(key, params)[0] for key in keys]
    np.testing.assert_allclose(together, np.stack(alone), atol=1e-5)
    assert len({tuple(row) for row in np.asarray(together[:, 4:8]).tolist()}) == 1


def test_step_and_reset_begins_anew() -> None:
    params = functional.default_params()
    _, state = functional.reset(jax.random.key(0), params)
    _, after, _, is_over, _ = functional.step_and_reset(jax.random.key(1), state, STOP, params)
    assert bool(is_over)
    assert int(after.steps) == 0
    assert not np.allclose(after.scenario.goal, state.scenario.goal)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"world": "9H1C"}, "hydrants"),
        ({"relation": "beside"}, "beside"),
        ({"sensing_range": 0.0}, "sensing_range is 0"),
        ({"max_steps": 0}, "max_steps is 0"),
    ],
)
def test_bad_options_are_refused(options: dict, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        functional.default_params(**options)


def test_gymnasium_finds_nothing_to_object_to() -> None:
    env = gymnasium.make(ID, world="2H1C", relation="nearest", sensing_range=5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    _, info = env.reset(seed=1)
    assert info["instruction"] == "go to the hydrant nearest to the cone"
    with pytest.raises(ValueError, match="relation"):
        gymnasium.make(ID, relation="beside")


def test_the_vector_form_begins_ended_lanes_anew() -> None:
    env = FollowVectorEnv(4, relation="null")
    observation, _ = env.reset(seed=2)
    assert observation.shape == (4, functional.OBSERVATION_SIZE)
    assert env.observation_space.contains(observation)
    first = env.reset(seed=2)[0]
    np.testing.assert_array_equal(first, observation)
    actions = np.zeros((4, 3), np.float32)
    actions[:, 0], actions[:, 2] = 1.0, -1.0
    actions[1] = [0.0, 0.0, 1.0]
    moved, _, ended, late, info = env.step(actions)
    assert ended.tolist() == [False, True, False, False]
    assert not late.any()
    assert info["distance"][1] == 0.0
    np.testing.assert_allclose(moved[[0, 2, 3], 0], 1.0, atol=1e-5)
    again, reward, ended, _, info = env.step(actions)
    assert not ended[1]
    assert reward[1] == 0.0
    assert again[1, :2].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(again[[0, 2, 3], 0], 2.0, atol=1e-5)
    with pytest.raises(ValueError, match="num_envs is 0"):
        FollowVectorEnv(0)
