"""Where a decision cycle's time goes: its parts compiled alone, on the same beliefs."""

from collections.abc import Callable
from typing import Any

import jax

from jaxlangnav import navigator
from jaxlangnav.episode import Progress, Task, advance, begin
from jaxlangnav.experiments.measuring import POLICY, Entry, entry, measure
from jaxlangnav.experiments.monte_carlo import LANES
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.world.sensor import sense

_STEPS = 5
"""Cycles run before the parts are timed: some things are seen, some words are refuted."""
_CALLS = 20
"""Calls of a part in one measurement."""


def shares(
    tasks: Task, instructions: Instruction, *, params: NavigatorParams, repetitions: int
) -> list[Entry]:
    """Measure the parts of a cycle in one batch of lanes.

    Args:
        tasks: leaves [E, …], at least as many as lanes.
        instructions: leaves [I, …].
        params: the navigator's numbers.
        repetitions: how often; the medians count.

    Returns:
        One entry per part, its share of the whole cycle in percent; planner and motion are what
        is left over. Compiled alone a part may be slower than within the whole.
    """
    config = navigator_config(POLICY)
    first = jax.tree.map(lambda leaf: leaf[:LANES], tasks)
    progress = jax.vmap(lambda task: begin(task, instructions, config=config))(first)
    cycle = jax.jit(jax.vmap(lambda one: advance(one, params=params, config=config)[0]))
    for _ in range(_STEPS):
        progress = cycle(progress)
    parts: dict[str, Callable[[Progress], Any]] = {
        "the sensor": _look,
        "the filter": lambda one: _filter(one, params),
        "behavior in every particle": lambda one: navigator.infer_behaviors(one.navigator),
    }
    whole = _seconds(cycle, progress, repetitions)
    entries = [entry("one cycle of one lane", 1e6 * whole / LANES, "µs CPU")]
    rest = whole
    for name, part in parts.items():
        spent = _seconds(jax.jit(jax.vmap(part)), progress, repetitions)
        # The filter's part has to look as well; the sensor has been counted already.
        if name == "the filter":
            spent -= whole - rest
        rest -= spent
        entries.append(entry(f"share of {name}", 100.0 * spent / whole, "%"))
    entries.append(entry("share of planner, motion and the rest", 100.0 * rest / whole, "%"))
    return entries


def _look(progress: Progress) -> Any:
    """Sense as a cycle does."""
    key = jax.random.fold_in(progress.task.key, progress.steps)
    return sense(key, progress.world, progress.task.scenario, progress.task.sensor)


def _filter(progress: Progress, params: NavigatorParams) -> Any:
    """Sense and run the filter as a cycle does."""
    state = progress.navigator
    key = jax.random.fold_in(progress.task.key, progress.steps)
    observation = _look(progress)
    return semantic_filter.step(
        key, state.belief, state.instruction.readings, observation, params=params.map
    )


def _seconds(part: Callable[[Progress], Any], progress: Progress, repetitions: int) -> float:
    """Time one call of a part on all lanes, CPU seconds."""
    jax.block_until_ready(part(progress))

    def calls() -> Any:
        return [part(progress) for _ in range(_CALLS)][-1]

    return measure(calls, repetitions).cpu / _CALLS
