"""One episode, step by step, kept for people to look at (Figures 1 and 4).

The same cycle as ``episode.run``, driven by a loop on the host so that each step can be told and
drawn. Everything is kept as NumPy arrays.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav import episode
from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Progress, Task
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams


@dataclasses.dataclass(frozen=True, kw_only=True)
class Step:
    """One decision cycle; every leaf a NumPy array."""

    index: int
    """0 for the first."""
    pose: tuple[float, float]
    """True position at which the robot sensed and decided, metres, map frame."""
    progress: Progress
    """After the cycle: belief, world, what has been visited."""
    info: NavigatorInfo
    """Why the robot did what it did."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recording:
    """An episode from the first look to the stop."""

    instruction: str
    task: Task
    steps: tuple[Step, ...]
    result: EpisodeResult

    @property
    def trajectory(self) -> list[tuple[float, float]]:
        """True positions from the start to the end, metres, map frame."""
        last = self.steps[-1].progress.world.position
        return [*(step.pose for step in self.steps), (float(last[0]), float(last[1]))]


def record(
    text: str,
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    on_step: Callable[[Step], None] | None = None,
) -> Recording:
    """Run one episode and keep every step.

    Args:
        text: the sentence, for titles.
        task: key, scenario, sentence, sensor and odometry.
        instructions: leaves [I, …]; the task names one of them.
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out.
        on_step: told of each step as it happens.

    Returns:
        The recording.

    Raises:
        ValueError: ``max_steps`` is below 1.
    """
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}, but must be at least 1")
    progress = _begin(task, instructions, config=config)
    steps: list[Step] = []
    while len(steps) < max_steps and not (steps and steps[-1].progress.navigator.is_done):
        pose = np.asarray(progress.world.position)
        progress, info = _advance(progress, params=params, config=config)
        step = Step(
            index=len(steps),
            pose=(float(pose[0]), float(pose[1])),
            progress=_to_host(progress),
            info=_to_host(info),
        )
        steps.append(step)
        if on_step is not None:
            on_step(step)
    return Recording(
        instruction=text,
        task=_to_host(task),
        steps=tuple(steps),
        result=_to_host(_finish(progress)),
    )


_begin = functools.partial(jax.jit, static_argnames="config")(episode.begin)
_advance = functools.partial(jax.jit, static_argnames="config")(episode.advance)
_finish = jax.jit(episode.finish)


def _to_host(record: Any) -> Any:
    """Copy a record's arrays to NumPy; typed keys become their data."""

    def leaf(value: Any) -> np.ndarray:
        if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            return np.asarray(jax.random.key_data(value))
        return np.asarray(value)

    return jax.tree.map(leaf, record)
