"""Where a decision cycle's time goes: its parts compiled alone, on the same beliefs."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

from jaxlangnav.episode import EpisodeState, Task, advance, begin, observe
from jaxlangnav.experiments.devices import LANES
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_clause_behaviors
from jaxlangnav.speed.measuring import POLICY, Measurement, entry, measure

_STEPS = 5
"""Cycles run before the parts are timed: some things are seen, some words are refuted."""
_CALLS = 20
"""Calls of a part in one measurement."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Part:
    """What a part of a cycle takes, for one lane."""

    name: str
    seconds: float
    """CPU seconds."""
    operations: float
    """Floating-point operations, by XLA's own analysis; a loop's body counts once."""
    memory: float
    """Bytes that its operations read and write, by the same analysis."""

    def without(self, other: "Part") -> "Part":
        """Take off what belongs to another part."""
        return Part(
            name=self.name,
            seconds=self.seconds - other.seconds,
            operations=self.operations - other.operations,
            memory=self.memory - other.memory,
        )


def measure_parts(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    repetitions: int,
) -> list[Part]:
    """Measure a cycle and its parts in one batch of lanes.

    Args:
        tasks: leaves [E, …], at least as many as lanes.
        instructions: leaves [I, …].
        params: the navigator's numbers.
        repetitions: how often; the medians count.

    Returns:
        The whole cycle, the sensor, the filter, behavior in every particle.
    """
    config = navigator_config(POLICY)
    first = jax.tree.map(lambda leaf: leaf[:LANES], tasks)
    progress = jax.vmap(lambda task: begin(task, instructions, config=config))(first)
    cycle = _compile(lambda one: advance(one, params=params, config=config)[0], progress)
    for _ in range(_STEPS):
        progress = cycle(progress)
    whole = _part("the cycle", cycle, progress, repetitions)
    sensor = _part("the sensor", _compile(observe, progress), progress, repetitions)
    # The filter's part has to look as well; the sensor has been counted already.
    filtering = _compile(lambda one: _filter(one, params), progress)
    filtered = _part("the filter", filtering, progress, repetitions).without(sensor)
    inference = _compile(_infer, progress)
    inferred = _part("behavior in every particle", inference, progress, repetitions)
    return [whole, sensor, filtered, inferred]


def share_entries(parts: list[Part]) -> list[Measurement]:
    """Turn measured parts into entries.

    Args:
        parts: of ``measure_parts``.

    Returns:
        The whole cycle, then one entry per part, its share of the whole in percent; planner and
        motion are what is left over. Compiled alone a part may be slower than within the whole.
    """
    whole, *inner = parts
    entries = [entry("one cycle of one lane", 1e6 * whole.seconds, "µs CPU")]
    rest = whole.seconds
    for part in inner:
        rest -= part.seconds
        entries.append(entry(f"share of {part.name}", 100.0 * part.seconds / whole.seconds, "%"))
    name = "share of planner, motion and the rest"
    return [*entries, entry(name, 100.0 * rest / whole.seconds, "%")]


def _filter(progress: EpisodeState, params: NavigatorParams) -> Any:
    """Sense and run the filter as a cycle does."""
    state = progress.navigator
    key = jax.random.fold_in(progress.task.key, progress.steps)
    return semantic_filter.step(
        key,
        state.belief,
        state.instruction.readings,
        observe(progress),
        params=params.map,
        is_sparse=True,
    )


def _infer(progress: EpisodeState) -> Any:
    """Infer behaviors as a cycle does."""
    state = progress.navigator
    return infer_clause_behaviors(
        state.belief.particles, state.instruction, state.clause, state.previous_goal
    )


def _compile(part: Callable[[EpisodeState], Any], progress: EpisodeState) -> Any:
    """Compile a part for all lanes."""
    return jax.jit(jax.vmap(part)).lower(progress).compile()


def _part(name: str, part: Any, progress: EpisodeState, repetitions: int) -> Part:
    """Time one call of a part on all lanes, and ask XLA what it has to do."""
    jax.block_until_ready(part(progress))

    def calls() -> Any:
        return [part(progress) for _ in range(_CALLS)][-1]

    analysis = part.cost_analysis() or {}
    return Part(
        name=name,
        seconds=measure(calls, repetitions).cpu / _CALLS / LANES,
        operations=float(analysis.get("flops", 0.0)) / LANES,
        memory=float(analysis.get("bytes accessed", 0.0)) / LANES,
    )
