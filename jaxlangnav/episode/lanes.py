"""Batches of episodes in a fixed number of ``vmap`` lanes, refilled as episodes end.

In ``run_batch`` a lane whose episode has ended takes the next one, so that the slowest episode does
not hold the rest. An episode's result depends only on its key, never on its index in the batch.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.episode import MAX_STEPS, Task, advance, begin, finish
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.pytree import pytree, replace, strong_types


class EpisodeProgram(NamedTuple):
    """The functions that lanes run, by default a plain episode's; static under ``jit``."""

    begin: Callable[..., Any]  # as ``begin``: initial state from a task and the instructions
    advance: Callable[..., Any]  # as ``advance``: next state, and outputs that are ignored
    finish: Callable[[Any], Any]  # as ``finish``: result of the final state
    episode_state: Callable[[Any], Any]
    """Selects the ``EpisodeState`` in a state, or another record that counts its ``steps``."""
    is_done: Callable[[Any], Array]
    """Selects from a state whether the episode has ended, time-outs aside."""


EPISODE = EpisodeProgram(
    begin=begin,
    advance=advance,
    finish=finish,
    episode_state=lambda state: state,
    is_done=operator.attrgetter("navigator.is_done"),
)


@pytree
class _Lanes:
    """Carry of the refilled loop; L lanes."""

    state: Any  # of the program; leaves [L, …]
    episode: Array  # i32[L] task index of each lane; ``count`` once none is left
    next_episode: Array  # i32[] task index that the next free lane takes
    results: Any  # of the program; leaves [E, …]


def run_batch(
    tasks: Task,
    instructions: Any,
    *,
    params: Any,
    config: NavigatorConfig,
    num_lanes: int = 32,
    max_steps: int = MAX_STEPS,
    count: Array | int | None = None,
    program: EpisodeProgram = EPISODE,
) -> Any:
    """Run many episodes in lanes that are refilled as episodes end.

    Args:
        tasks: leaves [E, …]; scalar sensor and motion parameters are shared.
        instructions: leaves [I, …], or what else ``program.begin`` takes.
        params: the navigator's parameters, or what else ``program.advance`` takes; shared, traced.
        config: capacities and policy.
        num_lanes: L, episodes that run at once.
        max_steps: cycles until a time-out.
        count: i32[], how many of the tasks to run; the rest is padding whose results are zero.
            All by default.
        program: functions of the episode; ``EPISODE`` by default.

    Returns:
        Results, leaves [E, …], in the order of the tasks: an ``EpisodeResult``, or what
        ``program.finish`` returns.
    """
    chex.assert_rank([tasks.key, tasks.instruction_index, tasks.scenario.start], [1, 1, 2])
    num_tasks = tasks.instruction_index.shape[0] if count is None else count
    tasks, instructions, params, num_tasks = strong_types((tasks, instructions, params, num_tasks))
    shape = tasks.instruction_index.shape[:1]
    per_task = {name: getattr(tasks, name) for name in ("sensor", "motion", "assumed_sensor")}
    per_task = jax.tree.map(lambda x: x if x.ndim else jnp.broadcast_to(x, shape), per_task)
    tasks = replace(tasks, **per_task)
    return _run_batch(tasks, instructions, params, num_tasks, config, num_lanes, max_steps, program)


@functools.partial(jax.jit, static_argnames=("config", "num_lanes", "max_steps", "program"))
def _run_batch(
    tasks: Task,
    instructions: Any,
    params: Any,
    count: Array,
    config: NavigatorConfig,
    num_lanes: int,
    max_steps: int,
    program: EpisodeProgram,
) -> Any:
    """Compiled part of ``run_batch``; the arrays are strongly typed."""
    capacity = tasks.instruction_index.shape[0]
    num_tasks = jnp.minimum(count, capacity).astype(jnp.int32)

    def load(episode: Array) -> Any:
        task = jax.tree.map(lambda leaf: leaf[jnp.clip(episode, 0, capacity - 1)], tasks)
        return program.begin(task, instructions, config=config)

    def body(lanes: _Lanes) -> _Lanes:
        advance = functools.partial(program.advance, params=params, config=config)
        state, *_ = jax.vmap(advance)(lanes.state)
        is_finished = program.is_done(state) | (program.episode_state(state).steps >= max_steps)
        is_finished = is_finished & (lanes.episode < num_tasks)
        row = jnp.where(is_finished, lanes.episode, capacity)  # an index of E is dropped
        results = jax.tree.map(
            lambda store, value: store.at[row].set(value, mode="drop"),
            lanes.results,
            jax.vmap(program.finish)(state),
        )
        index = lanes.next_episode + jnp.cumsum(is_finished) - 1
        episode = jnp.where(is_finished, jnp.minimum(index, num_tasks), lanes.episode)

        def where(is_new: Array, new: Any, old: Any) -> Any:
            return jax.tree.map(functools.partial(jnp.where, is_new), new, old)

        return _Lanes(
            state=jax.vmap(where)(is_finished, jax.vmap(load)(episode), state),
            episode=episode.astype(jnp.int32),
            next_episode=lanes.next_episode + jnp.sum(is_finished),
            results=results,
        )

    lane = jnp.arange(num_lanes, dtype=jnp.int32)
    state = jax.vmap(load)(lane)
    shape = jax.eval_shape(program.finish, jax.tree.map(lambda leaf: leaf[0], state))
    results = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), shape)
    lanes = _Lanes(
        state=state,
        episode=jnp.minimum(lane, num_tasks),
        next_episode=jnp.int32(num_lanes),
        results=results,
    )
    return jax.lax.while_loop(lambda lanes: jnp.any(lanes.episode < num_tasks), body, lanes).results
