"""What goes wrong is counted, and the episode goes on or ends with a reason (section 3.2).

Particle filters like to die in silence. Here each way of dying is provoked in the middle of whole
episodes, between the world and the navigator: weights that are all zero, sensors that report NaN,
detections that contradict each other, and more objects than the map has slots.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import navigator
from jaxlangnav.episode import EpisodeResult, EpisodeState, Task, add_counts, begin, finish
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Observation
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, NavigatorState
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.world.sensor import sense

FAULTS = ("none", "zero weights", "NaN", "contradiction", "more objects than slots")
"""What is provoked; an index into this tuple is a fault."""
UNPROVOKED, ZERO_WEIGHTS, NOT_A_NUMBER, CONTRADICTORY, OVERFLOW = range(len(FAULTS))
FIRST, LAST = 2, 5
"""Decision cycles in which the fault lasts, both included."""
PROVOKED_STEPS = 60


@pytree
class ProvokedResult:
    """How episodes with a fault ended; leaves lead with E."""

    result: EpisodeResult
    statuses: Array  # i32[T] bits of each cycle: 1 degenerate, 2 overflow, 4 contradiction, 8 fault
    is_sound: Array  # bool[] all weights and places were finite in every cycle


def corrupt(fault: Array, key: Array, step: Array, observation: Observation) -> Observation:
    """Break an observation.

    Args:
        fault: i32[], index into ``FAULTS``.
        key: random key.
        step: i32[], decision cycle.
        observation: what the sensor has seen.

    Returns:
        The same outside of the fault's cycles.
    """
    is_on = (step >= FIRST) & (step <= LAST)
    number = observation.detection_type.shape[0]
    range_key, turn_key, type_key = jax.random.split(key, 3)
    distance = 0.5 + 2.0 * jax.random.uniform(range_key, (number,))
    turn = jax.random.uniform(turn_key, (number,), minval=-jnp.pi, maxval=jnp.pi)
    kind = jax.random.randint(type_key, (number,), 0, 2)
    # Contradiction: two things that are elsewhere at every look. Overflow: all detections new.
    is_false = (fault == OVERFLOW) | ((fault == CONTRADICTORY) & (jnp.arange(number) < 2))
    is_false = is_false & is_on
    is_broken = (fault == NOT_A_NUMBER) & is_on
    pose = jnp.where(is_broken & (step == LAST), jnp.nan, observation.pose)
    distance = jnp.where(is_false, distance, observation.detection_range)
    turn = jnp.where(is_false, turn, observation.detection_bearing)
    return replace(
        observation,
        pose=pose,
        detection_type=jnp.where(is_false, kind, observation.detection_type),
        detection_range=jnp.where(is_broken, jnp.nan, distance),
        detection_bearing=jnp.where(is_broken, jnp.nan, turn),
        is_detection=observation.is_detection | is_false | is_broken,
    )


def _kill(fault: Array, step: Array, state: NavigatorState) -> NavigatorState:
    """Take all weight from all particles, once."""
    is_dead = (fault == ZERO_WEIGHTS) & (step == FIRST)
    weight = jnp.where(is_dead, -jnp.inf, state.belief.log_weight)
    return replace(state, belief=replace(state.belief, log_weight=weight))


@functools.partial(jax.jit, static_argnames=("config", "max_steps"))
def run_provoked(
    fault: Array,
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = PROVOKED_STEPS,
) -> ProvokedResult:
    """Run episodes in which a fault is provoked.

    Args:
        fault: i32[], index into ``FAULTS``; traced.
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: T, cycles until a time-out.

    Returns:
        Results and statuses, leaves [E, …].
    """

    def cycle(progress: EpisodeState) -> tuple[EpisodeState, Array, Array]:
        task, step = progress.task, progress.steps
        keys = jax.random.split(jax.random.fold_in(task.key, step), 4)
        observation = sense(keys[0], progress.world, task.scenario, task.sensor)
        observation = corrupt(fault, keys[3], step, observation)
        state = _kill(fault, step, progress.navigator)
        state, action, info = navigator.step(
            keys[1], state, observation, params=params, config=config
        )
        world = task.body.move(keys[2], progress.world, action, task.motion)
        after = replace(add_counts(progress, info), navigator=state, world=world)
        belief = state.belief
        status = (
            1 * (after.counts["degenerate"] > progress.counts["degenerate"])
            + 2 * (after.counts["overflow"] > progress.counts["overflow"])
            + 4 * (after.counts["contradictions"] > progress.counts["contradictions"])
            + 8 * (after.counts["faults"] > progress.counts["faults"])
        )
        floats = (belief.log_weight, belief.particles.mean_x, belief.particles.mean_y, action.step)
        is_sound = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in floats]))
        return after, status.astype(jnp.int32), is_sound

    def body(progress: EpisodeState, _: None) -> tuple[EpisodeState, tuple[Array, Array]]:
        is_over = progress.navigator.is_done
        after, status, is_sound = cycle(progress)
        # The task holds a key, which is never chosen between: it stays the same.
        after = replace(after, task=None)
        before = replace(progress, task=None)
        kept = jax.tree.map(lambda old, new: jnp.where(is_over, old, new), before, after)
        return replace(kept, task=progress.task), (
            jnp.where(is_over, 0, status),
            is_over | is_sound,
        )

    def one(task: Task) -> ProvokedResult:
        start = begin(task, instructions, config=config)
        last, (statuses, is_sound) = jax.lax.scan(body, start, None, length=max_steps)
        return ProvokedResult(result=finish(last), statuses=statuses, is_sound=jnp.all(is_sound))

    return jax.vmap(one)(tasks)
