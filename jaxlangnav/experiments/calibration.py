"""Is what the robot believes as probable as it says? Closed-loop calibration, step by step.

At every decision the belief is held against the truth, which only this module may do:
- events "this observed object is the goal", one for each object of the goal's type, with the
  probability the planner works with: Brier score and expected calibration error (ECE);
- the density of the goal's place, from all particles: negative log-likelihood at the true place,
  and whether the region of highest density that holds 90 % contains it.

The belief's map drifts with the odometry, so places are compared relative to the robot.
Sums of several steps and episodes may be added; one step says nothing.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import MAX_STEPS, Progress, Task, advance, begin
from jaxlangnav.experiments.monte_carlo import map_pieces
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams
from jaxlangnav.planner.goals import Goals
from jaxlangnav.pytree import pytree

NUM_BINS = 10
LANES = 64
"""Episodes of one call; all wait for the slowest."""
BANDWIDTH = 1.0
"""Metres, of the kernel that turns particles into a density."""
SAME = 0.75
"""Metres within which an observed object is the true one."""
_MOST_POINTS = 64
"""Particles that make up the density: its cost grows with their square."""


@pytree
class Tally:
    """Sums over steps, to be added up over episodes."""

    steps: Array  # f32[]
    covered: Array  # f32[] steps at which the 90 % region held the true place
    negative_log_likelihood: Array  # f32[] nats, density per square metre
    squared_error: Array  # f32[] of the events' probabilities
    bin_events: Array  # f32[NUM_BINS] events by their probability
    bin_probability: Array  # f32[NUM_BINS]
    bin_outcome: Array  # f32[NUM_BINS]


def nothing() -> Tally:
    """Build the sum over no steps."""
    zero, bins = jnp.float32(0.0), jnp.zeros(NUM_BINS, jnp.float32)
    return Tally(
        steps=zero,
        covered=zero,
        negative_log_likelihood=zero,
        squared_error=zero,
        bin_events=bins,
        bin_probability=bins,
        bin_outcome=bins,
    )


def goal_region(
    x: Array, y: Array, mass: Array, is_atom: Array, true_x: Array, true_y: Array
) -> tuple[Array, Array]:
    """Judge a density of the goal's place, made of weighted points.

    A point that is a sample does not count in the density at its own place; so if the truth is
    one more sample of the same law, its rank among them is uniform. Atoms are objects that have
    been seen: the probability is really there.

    Args:
        x: f32[n], metres.
        y: f32[n], metres.
        mass: f32[n], probability of each point.
        is_atom: bool[n], seen objects.
        true_x: f32[], metres.
        true_y: f32[], metres.

    Returns:
        bool[], whether the region of highest density that holds 90 % contains the truth, and
        f32[], the log-density there, per square metre.
    """
    mass = mass / jnp.maximum(jnp.sum(mass), 1e-9)

    def kernel(at_x: Array, at_y: Array, from_x: Array, from_y: Array) -> Array:
        squared = (at_x - from_x) ** 2 + (at_y - from_y) ** 2
        return jnp.exp(-0.5 * squared / BANDWIDTH**2)

    at_points = kernel(x[:, None], y[:, None], x[None, :], y[None, :]) @ mass
    at_points = at_points - jnp.where(is_atom, 0.0, mass)
    at_truth = kernel(x, y, true_x[None], true_y[None]) @ mass
    # A rounding error of slack: a truth that stands on an atom must count as being there.
    below = jnp.sum(jnp.where(at_points > at_truth * (1.0 + 1e-4) + 1e-12, mass, 0.0))
    scale = 2.0 * jnp.pi * BANDWIDTH**2
    return below <= 0.9, jnp.log(jnp.maximum(at_truth / scale, 1e-12))


def _points(goals: Goals) -> tuple[Array, Array, Array, Array]:
    """Collect seen objects and a selection of the particles' hypotheses."""
    number = goals.hypothesis_x.shape[0]
    chosen = np.linspace(0, number - 1, min(number, _MOST_POINTS)).astype(int)
    hypothesis = goals.hypothesis_mass[chosen]
    scale = jnp.sum(goals.hypothesis_mass) / jnp.maximum(jnp.sum(hypothesis), 1e-9)
    is_object = jnp.arange(goals.object_x.shape[0] + len(chosen)) < goals.object_x.shape[0]
    return (
        jnp.concatenate([goals.object_x, goals.hypothesis_x[chosen]]),
        jnp.concatenate([goals.object_y, goals.hypothesis_y[chosen]]),
        jnp.concatenate([goals.object_mass, hypothesis * scale]),
        is_object,
    )


def judge(progress: Progress, info: NavigatorInfo, after: Progress) -> Tally:
    """Hold the belief of one step against the truth.

    Args:
        progress: before the step; the robot is where the decision was made.
        info: of the decision.
        after: after the step, with the belief of the decision.

    Returns:
        The sums of this step.
    """
    scenario = progress.task.scenario
    true_x, true_y = scenario.goal - progress.world.position + info.robot
    goals = info.goals
    is_in, log_density = goal_region(*_points(goals), true_x, true_y)
    # Events: observed objects of the goal's type. The robot's entry is last and no object.
    types = jnp.max(after.navigator.belief.particles.object_type, axis=1)
    is_event = goals.is_object[:-1] & (types == scenario.object_type[scenario.goal_index])
    apart = jnp.hypot(goals.object_x[:-1] - true_x, goals.object_y[:-1] - true_y)
    outcome = (apart < SAME).astype(jnp.float32)
    probability = jnp.clip(goals.object_mass[:-1], 0.0, 1.0)
    bins = jnp.minimum((probability * NUM_BINS).astype(jnp.int32), NUM_BINS - 1)
    member = (bins[:, None] == jnp.arange(NUM_BINS)[None, :]) & is_event[:, None]
    member = member.astype(jnp.float32)
    error = jnp.where(is_event, (probability - outcome) ** 2, 0.0)
    return Tally(
        steps=jnp.float32(1.0),
        covered=is_in.astype(jnp.float32),
        negative_log_likelihood=-log_density,
        squared_error=jnp.sum(error),
        bin_events=jnp.sum(member, axis=0),
        bin_probability=probability @ member,
        bin_outcome=outcome @ member,
    )


@functools.partial(jax.jit, static_argnames=("config", "max_steps"))
def run_judged(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
) -> Tally:
    """Run episodes and judge every step.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out.

    Returns:
        Sums of each episode, leaves [E, …].
    """

    def is_running(carry: tuple[Progress, Tally]) -> Array:
        return ~carry[0].navigator.is_done & (carry[0].steps < max_steps)

    def body(carry: tuple[Progress, Tally]) -> tuple[Progress, Tally]:
        progress, tally = carry
        after, info = advance(progress, params=params, config=config)
        return after, jax.tree.map(jnp.add, tally, judge(progress, info, after))

    def one(task: Task) -> Tally:
        start = begin(task, instructions, config=config)
        return jax.lax.while_loop(is_running, body, (start, nothing()))[1]

    return jax.vmap(one)(tasks)


def tally_tasks(
    tasks: Task, instructions: Instruction, *, params: NavigatorParams, config: NavigatorConfig
) -> Tally:
    """Judge any number of episodes.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.

    Returns:
        Sums of each episode as NumPy arrays, leaves [E, …].
    """
    return map_pieces(
        lambda piece, _: run_judged(piece, instructions, params=params, config=config),
        tasks,
        capacity=LANES,
    )


def scores(tally: Tally) -> dict[str, float | None]:
    """Turn sums into scores.

    Args:
        tally: sums of episodes, leaves [E, …].

    Returns:
        ``ece`` and ``brier`` (None if no object of the goal's type was ever seen), ``coverage90``
        in percent, ``nll`` in nats, and the number of ``calibration_events``.
    """
    total = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64).sum(axis=0), tally)
    events, steps = float(total.bin_events.sum()), max(1.0, float(total.steps))
    gap = float(np.abs(total.bin_probability - total.bin_outcome).sum())
    return {
        "ece": gap / events if events else None,
        "brier": float(total.squared_error) / events if events else None,
        "coverage90": 100.0 * float(total.covered) / steps,
        "nll": float(total.negative_log_likelihood) / steps,
        "calibration_events": events,
    }
