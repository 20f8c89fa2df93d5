"""Compare agents in the same worlds: random, scripted, PPO, and the shipped policies.

    python examples/agents.py 10                 # minutes of training, on the paper's 1H1C, behind
    python examples/agents.py 10 2H1C nearest

PPO (Schulman et al., 2017) in its usual form: clipped surrogate, generalised advantages, Adam.
"""

import itertools
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from jaxlangnav import keep_compiled_programs
from jaxlangnav.environments import functional
from jaxlangnav.environments.command import COMMAND_SIZE
from jaxlangnav.environments.functional import (
    DISCRETE_ACTIONS,
    NUM_CELLS,
    VIEW_SIZE,
    EnvironmentParams,
)
from jaxlangnav.environments.pool import draw_pool
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.policies import run_policy
from jaxlangnav.experiments.tasks import (
    SENTENCES,
    Cell,
    ground_sentences,
    known_distances,
    make_tasks,
)
from jaxlangnav.pytree import replace

NUM_ENVS, STEPS, EPOCHS, MINIBATCHES = 512, 64, 4, 8
DISCOUNT, GAE_LAMBDA, CLIP, ENTROPY_COST, LEARNING_RATE = 0.99, 0.95, 0.2, 0.01, 7e-4
HIDDEN = 128
ACTIONS = jnp.asarray(DISCRETE_ACTIONS)
Weights = dict[str, Any]
Policy = Callable[[Array, Array], Array]  # key, observation → index into ``DISCRETE_ACTIONS``


def split_memory(observation: Array) -> tuple[Array, Array, Array]:
    """Split the observation's memory: known bool[2], offsets f32[2, 2] in map axes, cells."""
    known = observation[VIEW_SIZE : VIEW_SIZE + 6].reshape(2, 3)
    return known[:, 0] > 0.5, to_map(known[:, 1:], observation), observation[VIEW_SIZE + 6 :]


def to_map(points: Array, observation: Array) -> Array:
    """Rotate positions from the robot's frame, f32[n, 2], to the map's axes."""
    cosine, sine = observation[2], observation[3]
    return points @ jnp.array([[cosine, sine], [-sine, cosine]])


def features(observation: Array) -> Array:
    """Compute network inputs f32[n]: the observation, scaled and rotated to the map's axes."""
    is_known, offset, cells = split_memory(observation)
    seen = observation[9 + COMMAND_SIZE : VIEW_SIZE].reshape(-1, 5)
    objects = [seen[:, [0, 3, 4]], to_map(seen[:, 1:3], observation) / 5.0, is_known, offset / 5.0]
    pose = [observation[:2] / 10.0, observation[4:8] / 10.0, observation[9 : 9 + COMMAND_SIZE]]
    return jnp.concatenate([jnp.ravel(x).astype(jnp.float32) for x in (*pose, *objects, cells)])


def scripted_agent(key: Array, observation: Array) -> Array:
    """Go to the last detected object of the goal's type, else to the nearest unobserved cell."""
    is_known, offset, cells = split_memory(observation)
    x_min, x_max, y_min, y_max = observation[4:8]
    centre = (jnp.arange(NUM_CELLS) + 0.5) / NUM_CELLS
    y, x = jnp.meshgrid(
        y_min + centre * (y_max - y_min), x_min + centre * (x_max - x_min), indexing="ij"
    )
    offsets = jnp.stack([x.ravel() - observation[0], y.ravel() - observation[1]], axis=1)
    distance = jnp.where(cells > 0.5, jnp.inf, jnp.hypot(offsets[:, 0], offsets[:, 1]))
    direction = jnp.where(is_known[0], offset[0], offsets[jnp.argmin(distance)])
    is_near = is_known[0] & (jnp.hypot(direction[0], direction[1]) < 1.0)
    return jnp.where(is_near, 0, 1 + jnp.argmax(ACTIONS[1:, :2] @ direction))


def init_mlp(rng: np.random.Generator, sizes: list[int], last_scale: float) -> list[Weights]:
    """Initialise the weights of a multilayer perceptron, the last layer scaled."""
    result = []
    for num_in, num_out in itertools.pairwise(sizes):
        matrix = rng.normal(size=(num_in, num_out)) / num_in**0.5
        result.append({"w": jnp.asarray(matrix, jnp.float32), "b": jnp.zeros(num_out)})
    result[-1]["w"] *= last_scale
    return result


def apply_mlp(weights: list[Weights], inputs: Array) -> Array:
    """Apply a multilayer perceptron to f32[n]."""
    for layer in weights[:-1]:
        inputs = jnp.tanh(inputs @ layer["w"] + layer["b"])
    return inputs @ weights[-1]["w"] + weights[-1]["b"]


class Rollout(NamedTuple):
    """Transitions of a rollout, leaves [STEPS, NUM_ENVS, …]."""

    inputs: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    is_over: Array
    is_success: Array


def loss(weights: Weights, batch: tuple[Array, ...]) -> Array:
    """Compute PPO's loss: clipped surrogate, value error and entropy bonus, f32[]."""
    inputs, action, old_log_probability, advantage, target = batch
    logits = jax.nn.log_softmax(jax.vmap(apply_mlp, (None, 0))(weights["actor"], inputs))
    ratio = jnp.exp(jnp.take_along_axis(logits, action[:, None], 1)[:, 0] - old_log_probability)
    surrogate = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage)
    value = jax.vmap(apply_mlp, (None, 0))(weights["critic"], inputs)[:, 0]
    entropy = -jnp.sum(jnp.exp(logits) * logits, axis=1)
    return jnp.mean(-surrogate + 0.5 * (value - target) ** 2 - ENTROPY_COST * entropy)


def make_update(params: EnvironmentParams, optimizer: Any) -> Callable[..., Any]:
    """Build the compiled training step: a rollout, then epochs of minibatch updates."""
    step = jax.vmap(functional.step_and_reset, in_axes=(0, 0, 0, None))

    def collect(carry: Any, key: Array) -> tuple[Any, Rollout]:
        weights, state, inputs = carry
        action_key, step_key = jax.random.split(key)
        logits = jax.nn.log_softmax(jax.vmap(apply_mlp, (None, 0))(weights["actor"], inputs))
        action = jax.random.categorical(action_key, logits)
        keys = jax.random.split(step_key, NUM_ENVS)
        observation, state, reward, is_over, info = step(keys, state, ACTIONS[action], params)
        value = jax.vmap(apply_mlp, (None, 0))(weights["critic"], inputs)[:, 0]
        log_prob = jnp.take_along_axis(logits, action[:, None], 1)[:, 0]
        data = Rollout(inputs, action, log_prob, value, reward, is_over, info.is_success)
        return (weights, state, jax.vmap(features)(observation)), data

    def gae(carry: tuple[Array, Array], t: Rollout) -> tuple[tuple[Array, Array], Array]:
        advantage, value = carry
        discount = DISCOUNT * ~t.is_over
        advantage = t.reward + discount * (value + GAE_LAMBDA * advantage) - t.value
        return (advantage, t.value), advantage

    def minibatch_step(carry: Any, batch: tuple[Array, ...]) -> tuple[Any, None]:
        weights, opt_state = carry
        updates, opt_state = optimizer.update(jax.grad(loss)(weights, batch), opt_state)
        return (optax.apply_updates(weights, updates), opt_state), None

    @jax.jit
    def update(key: Array, weights: Weights, opt_state: Any, state: Any, inputs: Array) -> Any:
        play_key, shuffle_key = jax.random.split(key)
        (_, state, inputs), data = jax.lax.scan(
            collect, (weights, state, inputs), jax.random.split(play_key, STEPS)
        )
        last_value = jax.vmap(apply_mlp, (None, 0))(weights["critic"], inputs)[:, 0]
        init = (jnp.zeros(NUM_ENVS), last_value)
        _, advantage = jax.lax.scan(gae, init, data, reverse=True)
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        leaves = data.inputs, data.action, data.log_probability, scaled, advantage + data.value
        batch = tuple(leaf.reshape(NUM_ENVS * STEPS, *leaf.shape[2:]) for leaf in leaves)
        keys = jax.random.split(shuffle_key, EPOCHS)
        order = jax.vmap(lambda key: jax.random.permutation(key, NUM_ENVS * STEPS))(keys)
        order = order.reshape(EPOCHS * MINIBATCHES, -1)
        minibatches = tuple(leaf[order] for leaf in batch)
        (weights, opt_state), _ = jax.lax.scan(minibatch_step, (weights, opt_state), minibatches)
        success_rate = data.is_success.sum() / jnp.maximum(data.is_over.sum(), 1)
        return weights, opt_state, state, inputs, success_rate

    return update


def train(params: EnvironmentParams, minutes: float) -> tuple[Weights, int]:
    """Train from scratch for a number of minutes; returns the weights and the number of steps."""
    rng = np.random.default_rng(0)
    pool = draw_pool(jax.random.key(1), params.worlds)
    params = replace(params, worlds=pool, shaping=jnp.float32(0.05))
    reset = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
    observation, state = reset(jax.random.split(jax.random.key(2), NUM_ENVS), params)
    inputs = jax.vmap(features)(observation)
    num_inputs = inputs.shape[1]
    weights = {
        "actor": init_mlp(rng, [num_inputs, HIDDEN, HIDDEN, len(ACTIONS)], 0.01),
        "critic": init_mlp(rng, [num_inputs, HIDDEN, HIDDEN, 1], 1.0),
    }
    optimizer = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(LEARNING_RATE, eps=1e-5))
    opt, update = optimizer.init(weights), make_update(params, optimizer)
    key, count, start = jax.random.key(3), 0, time.monotonic()
    while time.monotonic() - start < 60.0 * minutes:
        key, update_key = jax.random.split(key)
        weights, opt, state, inputs, rate = update(update_key, weights, opt, state, inputs)
        count += 1
        if count % 20 == 0:
            secs = time.monotonic() - start
            print(
                f"{secs:5.0f} s, {count * NUM_ENVS * STEPS:,} steps: {100 * rate:.0f} %", flush=True
            )
    return weights, count * NUM_ENVS * STEPS


def evaluate(policy: Policy, tasks: Any, params: EnvironmentParams) -> tuple[float, float]:
    """Run an agent once in the world of each task: success in per cent, mean distance in metres."""

    def episode(key: Array, scenario: Any) -> tuple[Array, Array]:
        single = replace(params, worlds=jax.tree.map(lambda leaf: leaf[None], scenario))
        reset_key, rest = jax.random.split(key)
        obs, state = functional.reset(reset_key, single)

        def advance(carry: Any, key_: Array) -> tuple[Any, None]:
            obs, state, is_over, is_success = carry
            action_key, step_key = jax.random.split(key_)
            action = ACTIONS[policy(action_key, obs)]
            next_obs, next_state, _, ends, info = functional.step(step_key, state, action, single)
            frozen = jax.tree.map(
                lambda old, new: jnp.where(is_over, old, new), (obs, state), (next_obs, next_state)
            )
            is_success |= ~is_over & info.is_success
            return (*frozen, is_over | ends, is_success), None

        false = jnp.bool_(False)
        final, _ = jax.lax.scan(advance, (obs, state, false, false), jax.random.split(rest, 120))
        return final[3], final[1].world.distance

    count = tasks.scenario.goal_index.shape[0]
    result = jax.jit(jax.vmap(episode))(jax.random.split(jax.random.key(7), count), tasks.scenario)
    return 100.0 * float(result[0].mean()), float(result[1].mean())


def main(minutes: str = "10", world: str = "1H1C", relation: str = "behind") -> dict[str, Any]:
    """Train, and compare in 256 test worlds; success in per cent, mean distance in metres."""
    keep_compiled_programs()
    params = functional.default_params(world=world, relation=relation)
    tasks = make_tasks(Cell(world=world, relation=relation, seed=2), 256)
    weights, num_steps = train(params, float(minutes))

    def greedy(key: Array, observation: Array) -> Array:
        return jnp.argmax(apply_mlp(weights["actor"], features(observation)))

    def uniform(key: Array, observation: Array) -> Array:
        return jax.random.randint(key, (), 0, len(ACTIONS))

    agents = {"random": uniform, "scripted": scripted_agent, f"PPO, {num_steps:,} steps": greedy}
    results = {name: evaluate(policy, tasks, params) for name, policy in agents.items()}
    instructions = ground_sentences([SENTENCES[relation]]).instructions
    for name in ("faithful", "informed"):
        row = summarize(run_policy(name, tasks, instructions), known_distances(tasks))
        results[name] = row.success_rate, row.distance_mean
    for name, (rate, metres) in results.items():
        print(f"{name:<24}{rate:6.1f} % {metres:6.2f} m")
    return results


if __name__ == "__main__":
    main(*sys.argv[1:])
