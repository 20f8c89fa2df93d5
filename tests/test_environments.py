"""Our worlds as environments: the laws of reset and step, and Gymnasium's own checks."""

import importlib.util
import warnings
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from jaxlangnav.environments import ID, functional
from jaxlangnav.environments.command import COMMAND_SIZE, embed_command
from jaxlangnav.environments.functional import (
    DISCRETE_ACTIONS,
    NUM_CELLS,
    OBSERVATION_SIZE,
    STOP_THRESHOLD,
    VIEW_SIZE,
)
from jaxlangnav.environments.gymnasium_env import FollowEnv, FollowVectorEnv
from jaxlangnav.environments.pool import draw_pool, sample_world
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import BEHIND, NONE, ROBOT
from jaxlangnav.pytree import replace
from jaxlangnav.relations.table import REGISTRY
from jaxlangnav.world.state import CONE, HYDRANT
from jaxlangnav.world.templates import RELATION_NAMES

STOP = jnp.array([0.0, 0.0, 1.0])
RESET, STEP = jax.jit(functional.reset), jax.jit(functional.step)
STEP_AND_RESET = jax.jit(functional.step_and_reset)
RESET_MANY = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
PICK_MANY = jax.jit(jax.vmap(sample_world, in_axes=(0, None)))


@pytest.fixture(scope="module")
def pool() -> Any:
    return draw_pool(jax.random.key(9), functional.default_params().worlds, num_worlds=64)


def test_commands_are_those_of_the_tables() -> None:
    assert tuple(SENTENCES) == RELATION_NAMES


def test_the_observation_says_what_is_sensed() -> None:
    params = functional.default_params(sensing_range=50.0)
    perfect = {"detection_probability": jnp.float32(1.0), "noise": jnp.float32(0.0)}
    noiseless = replace(params.sensor, **perfect)
    observation, state = RESET(jax.random.key(3), replace(params, sensor=noiseless))
    assert observation.shape == (OBSERVATION_SIZE,)
    assert observation[:4].tolist() == [0.0, 0.0, 1.0, 0.0]
    np.testing.assert_allclose(observation[4:8], state.scenario.area)
    command = np.zeros(COMMAND_SIZE)
    command[BEHIND] = 1.0
    np.testing.assert_allclose(observation[8 : 9 + COMMAND_SIZE], [50.0, *command], atol=1e-3)
    seen = np.asarray(observation[9 + COMMAND_SIZE : VIEW_SIZE]).reshape(-1, 5)
    assert seen[:, 0].tolist() == [1.0, 1.0, *[0.0] * 6]
    assert not seen[2:].any()
    # Facing +x from the origin, the robot's frame is the map's; the cone is nearer.
    roles, places = seen[:2, 3:], seen[:2, 1:3]
    np.testing.assert_array_equal(roles, [[0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_allclose(places[1], state.scenario.goal, atol=1e-4)
    known = np.asarray(observation[VIEW_SIZE : VIEW_SIZE + 6]).reshape(2, 3)
    np.testing.assert_allclose(known, [[1.0, *places[1]], [1.0, *places[0]]], atol=1e-4)
    assert observation[VIEW_SIZE + 6 :].tolist() == [1.0] * NUM_CELLS**2


def test_what_has_been_seen_is_remembered_and_where_it_was_looked() -> None:
    params = functional.default_params(sensing_range=3.0)
    _, state = RESET(jax.random.key(0), params)
    x, y = np.asarray(state.scenario.goal)
    back = jnp.array([-1.0, 0.0, -1.0])
    seen = 0.0
    for key in jax.random.split(jax.random.key(1), 20):
        way = state.scenario.goal - state.world.position
        action = jnp.append(jnp.clip(way, -1.0, 1.0), -1.0) if seen == 0.0 else back
        observation, state, *_ = STEP(key, state, action, params)
        seen = float(observation[VIEW_SIZE])
    assert float(observation[2]) == pytest.approx(-1.0)  # it has turned round
    place = observation[:2] - observation[VIEW_SIZE + 1 : VIEW_SIZE + 3]
    np.testing.assert_allclose(place, [x, y], atol=0.7)
    looked = np.asarray(observation[VIEW_SIZE + 6 :]).reshape(NUM_CELLS, NUM_CELLS)
    assert 0.1 < looked.mean() < 0.9
    assert looked[NUM_CELLS // 2, 0] == 1.0


@pytest.mark.parametrize(
    ("text", "relation", "flags", "landmark"),
    [
        ("go to the hydrant", None, [0, 0, 0, 0], NONE),
        ("go to the hydrant nearest to the cone", "near", [1, 0, 0, 0], CONE),
        ("find the hydrant on your left", "left", [0, 1, 0, 1], ROBOT),
        ("move behind the cone", "behind", [0, 0, 1, 0], CONE),
    ],
)
def test_a_sentence_is_embedded(
    text: str, relation: str | None, flags: list[int], landmark: int
) -> None:
    command = embed_command(understand(text, load_shipped()), is_find_task="find" in text)
    expected = [float(one.name == relation) for one in REGISTRY] + [float(one) for one in flags]
    np.testing.assert_allclose(command.embedding, expected, atol=0.01)
    assert int(command.landmark) == landmark
    assert int(command.figure) == (NONE if relation == "behind" else HYDRANT)


@pytest.mark.parametrize(
    ("options", "shaping"),
    [({}, 0.0), ({"world": "street", "instruction": "find the car", "shaping": 0.1}, 0.1)],
)
def test_going_to_the_goal_and_stopping_is_rewarded(options: dict, shaping: float) -> None:
    """In a world of the tables, or of a file and with any sentence."""
    params = functional.default_params(**options)
    _, state = RESET(jax.random.key(0), params)
    total, metres = 0.0, float(jnp.hypot(*(state.scenario.goal - state.world.position)))
    for key in jax.random.split(jax.random.key(1), 60):
        way = state.scenario.goal - state.world.position
        is_near = jnp.hypot(way[0], way[1]) < params.stop_radius - 0.5
        action = STOP if is_near else jnp.append(jnp.clip(way, -1.0, 1.0), -1.0)
        _, state, reward, is_over, info = STEP(key, state, action, params)
        total += float(reward)
        if is_over:
            break
    assert bool(info.is_success)
    assert (float(params.stop_radius) > 1.5) == bool(options)  # to find is to see
    nearer = shaping * (metres - float(info.goal_distance))
    assert total == pytest.approx(1.0 - 0.01 * float(info.distance) + nearer, abs=1e-4)


def test_stopping_elsewhere_earns_nothing_and_time_runs_out() -> None:
    params = functional.default_params(max_steps=2)
    _, state = RESET(jax.random.key(0), params)
    _, _, reward, is_over, info = STEP(jax.random.key(1), state, STOP, params)
    assert (float(reward), bool(is_over), bool(info.is_success)) == (0.0, True, False)
    observation = STEP(jax.random.key(1), state, jnp.array([1.0, 1.0, -1.0]), params)[0]
    # A long step is shortened.
    assert float(jnp.hypot(observation[0], observation[1])) == pytest.approx(1.0, abs=1e-5)
    still = jnp.array([0.0, 0.0, -1.0])
    for expected in (False, True):
        _, state, _, is_over, info = STEP(jax.random.key(1), state, still, params)
        assert (bool(is_over), bool(info.is_truncated)) == (expected, expected)
        assert float(info.distance) == 0.0


def test_lanes_are_alike_alone_and_together(pool: Any) -> None:
    params = functional.default_params()
    keys = jax.random.split(jax.random.key(7), 5)
    params = replace(params, worlds=pool)
    together, _ = RESET_MANY(keys, params)
    alone = [RESET(key, params)[0] for key in keys]
    np.testing.assert_allclose(together, np.stack(alone), atol=1e-5)
    assert len({tuple(row) for row in np.asarray(together[:, 4:8]).tolist()}) == 1


def test_step_and_reset_begins_anew(pool: Any) -> None:
    params = replace(functional.default_params(), worlds=pool)
    _, state = RESET(jax.random.key(0), params)
    observation, after, _, is_over, _ = STEP_AND_RESET(jax.random.key(1), state, STOP, params)
    assert bool(is_over)
    assert int(after.steps) == 0
    assert (np.asarray(pool.goal) == np.asarray(after.scenario.goal)).all(axis=1).sum() == 1
    assert observation[:4].tolist() == [0.0, 0.0, 1.0, 0.0]
    _, after, _, is_over, info = STEP_AND_RESET(
        jax.random.key(1), state, jnp.array([1.0, 0.0, -1.0]), params
    )
    assert not bool(is_over)
    assert int(after.steps) == 1
    np.testing.assert_array_equal(after.scenario.goal, state.scenario.goal)
    assert float(info.distance) > 0.5


def test_a_pool_holds_the_worlds_of_the_law_and_hands_them_out_evenly(pool: Any) -> None:
    assert bool(pool.is_valid.all())
    goals = np.asarray(pool.goal)
    assert len({tuple(goal) for goal in goals.tolist()}) == 64
    drawn = np.asarray(PICK_MANY(jax.random.split(jax.random.key(2), 6400), pool).goal)
    times = (drawn[:, None] == goals).all(axis=-1).sum(axis=0)
    assert times.sum() == 6400
    # Each is handed out a hundred times, with a standard deviation of ten.
    assert np.abs(times - 100).max() < 50
    with pytest.raises(ValueError, match="num_worlds is 0"):
        draw_pool(jax.random.key(0), functional.default_params().worlds, num_worlds=0)


def test_a_world_that_does_not_meet_the_law_is_replaced() -> None:
    """Three hydrants and three cones in a few metres often find no place."""
    law = functional.default_params(world="3H3C").worlds
    crowded = replace(law, range_mean=0.9 * law.range_mean, range_sd=0.5 * law.range_sd)
    pool = draw_pool(jax.random.key(4), crowded, num_worlds=64)
    assert bool(pool.is_valid.all())
    assert 1 < len({tuple(goal) for goal in pool.goal.tolist()}) < 64


def test_discrete_actions_are_stop_and_whole_steps() -> None:
    assert (DISCRETE_ACTIONS[:, 2] > STOP_THRESHOLD).tolist() == [True, *[False] * 16]
    np.testing.assert_allclose(np.hypot(*DISCRETE_ACTIONS[1:, :2].T), 1.0, atol=1e-6)
    np.testing.assert_allclose(DISCRETE_ACTIONS[[1, 5], :2], [[1.0, 0.0], [0.0, 1.0]], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "options", "expected"),
    [
        (functional.default_params, {"world": "9H1C"}, "hydrants"),
        (functional.default_params, {"relation": "beside"}, "beside"),
        (functional.default_params, {"sensing_range": 0.0}, "range_max is 0"),
        (functional.default_params, {"world": "yard", "sensing_range": 1e9}, "range_max is 1e"),
        (functional.default_params, {"max_steps": 0}, "max_steps is 0"),
        (functional.default_params, {"instruction": "go"}, "in 1H1C worlds relation names"),
        (functional.default_params, {"world": "street", "instruction": "go to the cone"}, "fits"),
        (functional.default_params, {"world": "nowhere"}, "unknown world"),
        (FollowEnv, {"relation": "beside"}, "relation"),
        (FollowEnv, {"actions": "few"}, "actions is 'few', but must be one of: continuous, d"),
        (FollowEnv, {"render_mode": "human"}, "'human', but must be one of: rgb_array"),
        (FollowVectorEnv, {"num_envs": 0}, "num_envs is 0"),
        (FollowVectorEnv, {"num_envs": 1, "num_worlds": -1}, "num_worlds is -1"),
    ],
)
def test_bad_options_are_refused(make: Any, options: dict, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        make(**options)


@pytest.mark.parametrize("options", [{}, {"actions": "discrete", "render_mode": "rgb_array"}])
def test_gymnasium_finds_nothing_to_object_to(options: dict) -> None:
    law = {"world": "2H1C", "relation": "nearest", "sensing_range": 5.0}
    env = gymnasium.make(f"jaxlangnav:{ID}", **law, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    _, info = env.reset(seed=1)
    assert info["instruction"] == "go to the hydrant nearest to the cone"


def test_an_environment_draws_itself() -> None:
    env = FollowEnv(render_mode="rgb_array", actions="discrete")
    with pytest.raises(ValueError, match="render before reset"):
        env.render()
    env.reset(seed=0)
    before = env.render()
    assert before.dtype == np.uint8
    assert before.shape[0] == 480
    assert before.shape[2] == 3
    for _ in range(3):
        env.step(1)
    assert 0.001 < (env.render() != before).any(axis=-1).mean() < 0.5
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), before)


def test_pictures_need_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'jaxlangnav\[viz\]'"):
        FollowEnv(render_mode="rgb_array")


def test_without_a_render_mode_there_is_no_picture() -> None:
    with pytest.warns(UserWarning, match="render_mode="):
        assert FollowEnv().render() is None


def test_the_vector_form_begins_ended_lanes_anew() -> None:
    options = {"relation": "null", "render_mode": "rgb_array"}
    env = gymnasium.make_vec(f"jaxlangnav:{ID}", num_envs=4, num_worlds=64, **options).unwrapped
    observation, info = env.reset(seed=2)
    assert info["instruction"].tolist() == ["go to the hydrant"] * 4
    assert observation.shape == (4, OBSERVATION_SIZE)
    assert env.observation_space.contains(observation)
    np.testing.assert_array_equal(env.reset(seed=2)[0], observation)
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
    assert [picture.shape[::2] for picture in env.render()] == [(480, 3)] * 4
