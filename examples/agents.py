"""Agents on the same worlds: random, scripted, PPO trained here, and the policies that ship.

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
    cell,
    ground_sentences,
    known_distances,
    make_tasks,
)
from jaxlangnav.pytree import replace

LANES, STEPS, EPOCHS, MINIBATCHES = 512, 64, 4, 8
DISCOUNT, TRACE, CLIP, ENTROPY, RATE = 0.99, 0.95, 0.2, 0.01, 7e-4
HIDDEN = 128
ACTIONS = jnp.asarray(DISCRETE_ACTIONS)
Weights = dict[str, Any]
Choose = Callable[[Array, Array], Array]  # key, observation → index into ``DISCRETE_ACTIONS``


def parts(observation: Array) -> tuple[Array, Array, Array]:
    """Take apart what memory holds: known bool[2], their offset f32[2, 2] along the map, cells."""
    known = observation[VIEW_SIZE : VIEW_SIZE + 6].reshape(2, 3)
    return known[:, 0] > 0.5, to_map(known[:, 1:], observation), observation[VIEW_SIZE + 6 :]


def to_map(places: Array, observation: Array) -> Array:
    """Turn places of the robot's frame, f32[n, 2], to the map's axes, in which it steps."""
    cosine, sine = observation[2], observation[3]
    return places @ jnp.array([[cosine, sine], [-sine, cosine]])


def features(observation: Array) -> Array:
    """Scale an observation and turn it to the map's axes, f32[n]."""
    is_known, offset, cells = parts(observation)
    seen = observation[9 + COMMAND_SIZE : VIEW_SIZE].reshape(-1, 5)
    found = [seen[:, [0, 3, 4]], to_map(seen[:, 1:3], observation) / 5.0, is_known, offset / 5.0]
    pose = [observation[:2] / 10.0, observation[4:8] / 10.0, observation[9 : 9 + COMMAND_SIZE]]
    return jnp.concatenate([jnp.ravel(one).astype(jnp.float32) for one in (*pose, *found, cells)])


def scripted_agent(key: Array, observation: Array) -> Array:
    """Go to the goal's type where it has been seen, else to the nearest cell not looked at."""
    is_known, offset, cells = parts(observation)
    x_min, x_max, y_min, y_max = observation[4:8]
    middle = (jnp.arange(NUM_CELLS) + 0.5) / NUM_CELLS
    y, x = jnp.meshgrid(
        y_min + middle * (y_max - y_min), x_min + middle * (x_max - x_min), indexing="ij"
    )
    away = jnp.stack([x.ravel() - observation[0], y.ravel() - observation[1]], axis=1)
    metres = jnp.where(cells > 0.5, jnp.inf, jnp.hypot(away[:, 0], away[:, 1]))
    way = jnp.where(is_known[0], offset[0], away[jnp.argmin(metres)])
    is_there = is_known[0] & (jnp.hypot(way[0], way[1]) < 1.0)
    return jnp.where(is_there, 0, 1 + jnp.argmax(ACTIONS[1:, :2] @ way))


def layers(random: np.random.Generator, sizes: list[int], last: float) -> list[Weights]:
    """Draw the weights of a perceptron, the last layer scaled."""
    found = []
    for wide, narrow in itertools.pairwise(sizes):
        matrix = random.normal(size=(wide, narrow)) / wide**0.5
        found.append({"w": jnp.asarray(matrix, jnp.float32), "b": jnp.zeros(narrow)})
    found[-1]["w"] *= last
    return found


def perceive(weights: list[Weights], inputs: Array) -> Array:
    """Run a perceptron on f32[n]."""
    for one in weights[:-1]:
        inputs = jnp.tanh(inputs @ one["w"] + one["b"])
    return inputs @ weights[-1]["w"] + weights[-1]["b"]


class Rollout(NamedTuple):
    """What was seen and done, leaves [STEPS, LANES, …]."""

    inputs: Array
    action: Array
    log_probability: Array
    value: Array
    reward: Array
    is_over: Array
    is_success: Array


def loss(weights: Weights, batch: tuple[Array, ...]) -> Array:
    """The clipped surrogate, the critic's error and the entropy, f32[]."""
    inputs, action, before, advantage, target = batch
    logits = jax.nn.log_softmax(jax.vmap(perceive, (None, 0))(weights["actor"], inputs))
    ratio = jnp.exp(jnp.take_along_axis(logits, action[:, None], 1)[:, 0] - before)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage)
    value = jax.vmap(perceive, (None, 0))(weights["critic"], inputs)[:, 0]
    entropy = -jnp.sum(jnp.exp(logits) * logits, axis=1)
    return jnp.mean(-gain + 0.5 * (value - target) ** 2 - ENTROPY * entropy)


def make_update(params: EnvironmentParams, search: Any) -> Callable[..., Any]:
    """Build the compiled step of training: play, then improve."""
    step = jax.vmap(functional.step_and_reset, in_axes=(0, 0, 0, None))

    def play(carry: Any, key: Array) -> tuple[Any, Rollout]:
        weights, state, inputs = carry
        pick, move = jax.random.split(key)
        logits = jax.nn.log_softmax(jax.vmap(perceive, (None, 0))(weights["actor"], inputs))
        action = jax.random.categorical(pick, logits)
        keys = jax.random.split(move, LANES)
        seen, state, reward, is_over, info = step(keys, state, ACTIONS[action], params)
        value = jax.vmap(perceive, (None, 0))(weights["critic"], inputs)[:, 0]
        chosen = jnp.take_along_axis(logits, action[:, None], 1)[:, 0]
        done = Rollout(inputs, action, chosen, value, reward, is_over, info.is_success)
        return (weights, state, jax.vmap(features)(seen)), done

    def trace(after: tuple[Array, Array], one: Rollout) -> tuple[tuple[Array, Array], Array]:
        advantage, value = after
        goes_on = DISCOUNT * ~one.is_over
        advantage = one.reward + goes_on * (value + TRACE * advantage) - one.value
        return (advantage, one.value), advantage

    def improve(carry: Any, batch: tuple[Array, ...]) -> tuple[Any, None]:
        weights, memory = carry
        change, memory = search.update(jax.grad(loss)(weights, batch), memory)
        return (optax.apply_updates(weights, change), memory), None

    @jax.jit
    def update(key: Array, weights: Weights, memory: Any, state: Any, inputs: Array) -> Any:
        play_key, mix_key = jax.random.split(key)
        (_, state, inputs), done = jax.lax.scan(
            play, (weights, state, inputs), jax.random.split(play_key, STEPS)
        )
        last = jax.vmap(perceive, (None, 0))(weights["critic"], inputs)[:, 0]
        begin = (jnp.zeros(LANES), last)
        _, advantage = jax.lax.scan(trace, begin, done, reverse=True)
        scaled = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        known = done.inputs, done.action, done.log_probability, scaled, advantage + done.value
        batch = tuple(leaf.reshape(LANES * STEPS, *leaf.shape[2:]) for leaf in known)
        keys = jax.random.split(mix_key, EPOCHS)
        order = jax.vmap(lambda one: jax.random.permutation(one, LANES * STEPS))(keys)
        order = order.reshape(EPOCHS * MINIBATCHES, -1)
        mixed = tuple(leaf[order] for leaf in batch)
        (weights, memory), _ = jax.lax.scan(improve, (weights, memory), mixed)
        rate = done.is_success.sum() / jnp.maximum(done.is_over.sum(), 1)
        return weights, memory, state, inputs, rate

    return update


def train(params: EnvironmentParams, minutes: float) -> tuple[Weights, int]:
    """Train for so long, from scratch; the weights, and the number of steps taken."""
    random = np.random.default_rng(0)
    pool = draw_pool(jax.random.key(1), params.worlds)
    params = replace(params, worlds=pool, shaping=jnp.float32(0.05))
    reset = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
    seen, state = reset(jax.random.split(jax.random.key(2), LANES), params)
    inputs = jax.vmap(features)(seen)
    size = inputs.shape[1]
    weights = {
        "actor": layers(random, [size, HIDDEN, HIDDEN, len(ACTIONS)], 0.01),
        "critic": layers(random, [size, HIDDEN, HIDDEN, 1], 1.0),
    }
    search = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(RATE, eps=1e-5))
    memory, update = search.init(weights), make_update(params, search)
    key, number, start = jax.random.key(3), 0, time.monotonic()
    while time.monotonic() - start < 60.0 * minutes:
        key, one = jax.random.split(key)
        weights, memory, state, inputs, rate = update(one, weights, memory, state, inputs)
        number += 1
        if number % 20 == 0:
            gone = time.monotonic() - start
            print(
                f"{gone:5.0f} s, {number * LANES * STEPS:,} steps: {100 * rate:.0f} %", flush=True
            )
    return weights, number * LANES * STEPS


def evaluate(choose: Choose, tasks: Any, params: EnvironmentParams) -> tuple[float, float]:
    """Run an agent once in the world of each task: success in per cent, mean metres."""

    def episode(key: Array, scenario: Any) -> tuple[Array, Array]:
        own = replace(params, worlds=jax.tree.map(lambda leaf: leaf[None], scenario))
        first, rest = jax.random.split(key)
        seen, state = functional.reset(first, own)

        def advance(carry: Any, one: Array) -> tuple[Any, None]:
            seen, state, is_over, is_success = carry
            pick, move = jax.random.split(one)
            action = ACTIONS[choose(pick, seen)]
            now, after, _, ends, info = functional.step(move, state, action, own)
            kept = jax.tree.map(
                lambda old, new: jnp.where(is_over, old, new), (seen, state), (now, after)
            )
            is_success |= ~is_over & info.is_success
            return (*kept, is_over | ends, is_success), None

        no = jnp.bool_(False)
        end, _ = jax.lax.scan(advance, (seen, state, no, no), jax.random.split(rest, 120))
        return end[3], end[1].world.distance

    number = tasks.scenario.goal_index.shape[0]
    found = jax.jit(jax.vmap(episode))(jax.random.split(jax.random.key(7), number), tasks.scenario)
    return 100.0 * float(found[0].mean()), float(found[1].mean())


def main(minutes: str = "10", world: str = "1H1C", relation: str = "behind") -> dict[str, Any]:
    """Train in some worlds, and compare in 256 others; success in per cent, mean metres."""
    keep_compiled_programs()
    params = functional.default_params(world=world, relation=relation)
    tasks = make_tasks(cell(world, relation, 0, 3.0, 256, seed=2))
    weights, number = train(params, float(minutes))

    def greedy(key: Array, observation: Array) -> Array:
        return jnp.argmax(perceive(weights["actor"], features(observation)))

    def any_action(key: Array, observation: Array) -> Array:
        return jax.random.randint(key, (), 0, len(ACTIONS))

    agents = {"random": any_action, "scripted": scripted_agent, f"PPO, {number:,} steps": greedy}
    found = {name: evaluate(choose, tasks, params) for name, choose in agents.items()}
    told = ground_sentences([SENTENCES[relation]]).instructions
    for name in ("faithful", "informed"):
        row = summarize(run_policy(name, tasks, told), known_distances(tasks))
        found[name] = row.success_rate, row.distance_mean
    for name, (rate, metres) in found.items():
        print(f"{name:<24}{rate:6.1f} % {metres:6.2f} m")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
