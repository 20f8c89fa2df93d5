"""Episodes that are judged step by step as they run (``calibration``)."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.episode import (
    MAX_STEPS,
    EpisodeResult,
    EpisodeState,
    Task,
    advance,
    begin,
    finish,
)
from jaxlangnav.experiments.calibration import Tally, nothing, tally_step
from jaxlangnav.experiments.monte_carlo import map_pieces, run_tasks
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.lanes import Course
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import pytree

EPISODES_AT_ONCE = 64
"""Episodes of one call; all wait for the slowest."""


@functools.partial(jax.jit, static_argnames=("config", "max_steps"))
def _run_judged(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
) -> Tally:
    """Run episodes and judge every step."""

    def is_running(carry: tuple[EpisodeState, Tally]) -> Array:
        return ~carry[0].navigator.is_done & (carry[0].steps < max_steps)

    def body(carry: tuple[EpisodeState, Tally]) -> tuple[EpisodeState, Tally]:
        progress, tally = carry
        after, info = advance(progress, params=params, config=config)
        return after, jax.tree.map(jnp.add, tally, tally_step(progress, info, after))

    def one(task: Task) -> Tally:
        start = begin(task, instructions, config=config)
        return jax.lax.while_loop(is_running, body, (start, nothing()))[1]

    return jax.vmap(one)(tasks)


def tally_tasks(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    on_progress: Callable[[int], None] | None = None,
) -> Tally:
    """Judge any number of episodes.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles that are judged.
        on_progress: called with the number of episodes just judged.

    Returns:
        Sums of each episode as NumPy arrays, leaves [E, …].
    """
    return map_pieces(
        lambda piece, _: _run_judged(
            piece, instructions, params=params, config=config, max_steps=max_steps
        ),
        tasks,
        capacity=EPISODES_AT_ONCE,
        on_progress=on_progress,
    )


@pytree
class _Judged:
    """An episode under way, and what its steps have come to."""

    progress: EpisodeState
    tally: Tally


def _begin_judged(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> _Judged:
    return _Judged(progress=begin(task, instructions, config=config), tally=nothing())


def _advance_judged(
    state: _Judged, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[_Judged, None]:
    after, info = advance(state.progress, params=params, config=config)
    one = tally_step(state.progress, info, after)
    return _Judged(progress=after, tally=jax.tree.map(jnp.add, state.tally, one)), None


def _finish_judged(state: _Judged) -> tuple[EpisodeResult, Tally]:
    return finish(state.progress), state.tally


def _progress_of(state: _Judged) -> EpisodeState:
    return state.progress


_JUDGED = Course(
    begin=_begin_judged, advance=_advance_judged, finish=_finish_judged, progress=_progress_of
)


def run_judged(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    on_progress: Callable[[int], None] | None = None,
) -> tuple[EpisodeResult, Tally]:
    """Run any number of episodes and judge every step of them, in refilled lanes.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out.
        on_progress: called with the number of episodes just run.

    Returns:
        Results and sums of each episode as NumPy arrays, leaves [E, …].
    """
    return run_tasks(
        tasks,
        instructions,
        params=params,
        config=config,
        on_progress=on_progress,
        max_steps=max_steps,
        course=_JUDGED,
    )
