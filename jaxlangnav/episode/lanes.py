"""Many episodes in refilled lanes.

``run_batch`` keeps a fixed number of lanes busy: a lane whose episode has ended takes the next one,
so that the slowest episode does not hold the rest. An episode's result depends on its own key only,
never on its place in the batch.
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
    """What lanes run: an episode, or one with more kept of it; part of the compiled program."""

    begin: Callable[..., Any]  # as ``begin``: a state from a task and the instructions
    advance: Callable[..., Any]  # as ``advance``: the next state, and something that is not used
    finish: Callable[[Any], Any]  # as ``finish``: the result of a state
    progress: Callable[[Any], Any]
    """Takes the episode out of a state, or what else counts its ``steps``."""
    is_done: Callable[[Any], Array] = operator.attrgetter("progress.navigator.is_done")
    """Takes out of a state whether it is over, even before time is."""


EPISODE = EpisodeProgram(
    begin=begin,
    advance=advance,
    finish=finish,
    progress=lambda progress: progress,
    is_done=operator.attrgetter("navigator.is_done"),
)


@pytree
class _Lanes:
    """Carry of the refilled loop; L lanes."""

    state: Any  # of the course; leaves [L, …]
    episode: Array  # i32[L] which task a lane runs; E once there is none left
    next_episode: Array  # i32[]
    results: Any  # of the course; leaves [E, …]


def run_batch(
    tasks: Task,
    instructions: Any,
    *,
    params: Any,
    config: NavigatorConfig,
    num_lanes: int = 32,
    max_steps: int = MAX_STEPS,
    count: Array | int | None = None,
    course: EpisodeProgram = EPISODE,
) -> Any:
    """Run many episodes in lanes that are refilled as episodes end.

    Args:
        tasks: leaves [E, …]; a number of sensor or motion may be one for all.
        instructions: leaves [I, …], or what else the course begins with.
        params: the navigator's numbers, or what else the course goes on by; shared, traced.
        config: sizes and policy.
        num_lanes: L, episodes under way at once.
        max_steps: cycles until a time-out.
        count: i32[], how many of the tasks to run; the rest is padding whose results are zero.
            All by default.
        course: what is kept of an episode; its result by default.

    Returns:
        Results, leaves [E, …], in the order of the tasks: an ``EpisodeResult``, or what the course
        finishes with.
    """
    chex.assert_rank([tasks.key, tasks.instruction_index, tasks.scenario.start], [1, 1, 2])
    number = tasks.instruction_index.shape[0] if count is None else count
    tasks, instructions, params, number = strong_types((tasks, instructions, params, number))
    episodes = tasks.instruction_index.shape[:1]
    own = {name: getattr(tasks, name) for name in ("sensor", "motion", "told")}
    own = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, episodes) if leaf.ndim == 0 else leaf, own
    )
    return _run_batch(
        replace(tasks, **own),
        instructions,
        params=params,
        count=number,
        config=config,
        num_lanes=num_lanes,
        max_steps=max_steps,
        course=course,
    )


@functools.partial(jax.jit, static_argnames=("config", "num_lanes", "max_steps", "course"))
def _run_batch(
    tasks: Task,
    instructions: Any,
    *,
    params: Any,
    count: Array,
    config: NavigatorConfig,
    num_lanes: int,
    max_steps: int,
    course: EpisodeProgram,
) -> Any:
    """Run a batch whose arrays have types of their own, see ``run_batch``."""
    capacity = tasks.instruction_index.shape[0]
    number = jnp.minimum(count, capacity).astype(jnp.int32)

    def load(episode: Array) -> Any:
        task = jax.tree.map(lambda leaf: leaf[jnp.clip(episode, 0, capacity - 1)], tasks)
        return course.begin(task, instructions, config=config)

    def body(lanes: _Lanes) -> _Lanes:
        advance = functools.partial(course.advance, params=params, config=config)
        state, _ = jax.vmap(advance)(lanes.state)
        is_over = course.is_done(state) | (course.progress(state).steps >= max_steps)
        is_over = is_over & (lanes.episode < number)
        target = jnp.where(is_over, lanes.episode, capacity)  # an index of E is dropped
        results = jax.tree.map(
            lambda store, value: store.at[target].set(value, mode="drop"),
            lanes.results,
            jax.vmap(course.finish)(state),
        )
        order = lanes.next_episode + jnp.cumsum(is_over) - 1
        episode = jnp.where(is_over, jnp.minimum(order, number), lanes.episode)

        def take(is_new: Array, new: Any, old: Any) -> Any:
            return jax.tree.map(functools.partial(jnp.where, is_new), new, old)

        return _Lanes(
            state=jax.vmap(take)(is_over, jax.vmap(load)(episode), state),
            episode=episode.astype(jnp.int32),
            next_episode=lanes.next_episode + jnp.sum(is_over),
            results=results,
        )

    first = jnp.arange(num_lanes, dtype=jnp.int32)
    state = jax.vmap(load)(first)
    shape = jax.eval_shape(course.finish, jax.tree.map(lambda leaf: leaf[0], state))
    results = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), shape)
    lanes = _Lanes(
        state=state,
        episode=jnp.minimum(first, number),
        next_episode=jnp.int32(num_lanes),
        results=results,
    )
    return jax.lax.while_loop(lambda one: jnp.any(one.episode < number), body, lanes).results
