"""Is what the robot believes as probable as it says? Closed-loop calibration, step by step.

At every decision the belief is held against the truth, which only this module may do:
- events "this observed object is the goal", one for each of the goal's type in most maps, with the
  probability the planner works with, and with that of the map (the share of particles in which the
  words refer to it): Brier score and expected calibration error (ECE);
- the density of the goal's place, from all particles: negative log-likelihood at the true place,
  and whether the region of highest density that holds 90 % contains it.

The belief's map drifts with the odometry, so places are compared relative to the robot. A stop is
decided from what the robot has seen, so ending an episode at it biases nothing.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import EpisodeState
from jaxlangnav.messages import NONE, Readings
from jaxlangnav.navigator import NavigatorInfo
from jaxlangnav.numerics import gaussian
from jaxlangnav.planner.goals import Goals
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import Coverage, cell_size

BANDWIDTH = 1.0  # metres, of the kernel that turns the particles' hypotheses into a density
_MIN_VARIANCE = 1e-4
"""Square metres; a place that is known better than this counts as known this well."""
_LOG_FLOOR = 1e-12  # per square metre
NUM_BINS = 10
SAME_DISTANCE = 0.75
"""Metres within which an observed object is the true one, if none of its type is nearer."""
STAGES = (0, 5, 10, 15, 20, 30)  # first decision cycle of each stage that scores are kept for
_JUDGING = 78
"""Folded into a cycle's key for the judge; beyond the keys that world and navigator take."""
_MOST_POINTS = 64  # particles that make up the density: its cost grows with their square


@pytree
class GoalDensity:
    """Where the goal is believed to be: a Gaussian per seen object, and the hypotheses."""

    objects: Array  # f32[2, O] metres, map frame
    object_mass: Array  # f32[O] probability that it is the goal
    object_variance: Array  # f32[O] square metres per axis, of its place relative to the robot
    hypotheses: Array  # f32[2, H] metres, map frame
    hypothesis_mass: Array  # f32[H]


def _goal_region(density: GoalDensity, truth: Array) -> tuple[Array, Array]:
    """Find the probability of all places that are likelier than the true one, f32[2]."""
    #     below = Σ_h m_h [f₋ₕ(x_h) > t] + Σ_o m_o (1 − (t − b_o) / p_o),    t = f(truth)
    # with f the mixture of Gaussians about seen objects (peak m_o / 2π s_o = p_o over the
    # background b_o) and of kernels about hypotheses. A hypothesis is one draw, and does not count
    # in the density at its own place (f₋ₕ), nor do its copies: so if the truth is one more draw of
    # the same law, ``below`` is uniform between 0 and 1.
    total = jnp.sum(density.object_mass) + jnp.sum(density.hypothesis_mass)
    scale = 1.0 / jnp.maximum(total, 1e-9)
    seen, open_mass = density.object_mass * scale, density.hypothesis_mass * scale
    variance = jnp.maximum(density.object_variance, _MIN_VARIANCE)

    def kernels(of: Array, variance: Array, places: Array) -> Array:
        dx, dy = places[:, :, None] - of[:, None]
        return jnp.exp(gaussian.log_normal_isotropic(dx, dy, variance))

    hypotheses = functools.partial(kernels, density.hypotheses, jnp.float32(BANDWIDTH**2))
    objects = functools.partial(kernels, density.objects, variance[None])
    place = truth[:, None]
    at_truth = (hypotheses(place) @ open_mass + objects(place) @ seen)[0]
    own = hypotheses(density.hypotheses)
    is_copy = own > (1.0 - 1e-6) / (2.0 * jnp.pi * BANDWIDTH**2)
    at_hypotheses = jnp.where(is_copy, 0.0, own) @ open_mass + objects(density.hypotheses) @ seen
    is_self = jnp.eye(seen.shape[0], dtype=bool)
    background = jnp.where(is_self, 0.0, objects(density.objects)) @ seen
    background = hypotheses(density.objects) @ open_mass + background
    peak = seen / (2.0 * jnp.pi * variance)
    share = 1.0 - jnp.clip((at_truth - background) / jnp.maximum(peak, 1e-20), 0.0, 1.0)
    below = jnp.sum(jnp.where(at_hypotheses > at_truth, open_mass, 0.0)) + jnp.sum(seen * share)
    return below, jnp.log(jnp.maximum(at_truth, _LOG_FLOOR))


@pytree
class Reliability:
    """Sums over events, by their probability; leaves may lead with stages and episodes."""

    events: Array  # f32[NUM_BINS]
    probability: Array  # f32[NUM_BINS]
    outcome: Array  # f32[NUM_BINS]
    squared_error: Array  # f32[]


@pytree
class Tally:
    """Sums over steps, to be added up over episodes; leaves lead with the stages of ``STAGES``."""

    steps: Array  # f32[S]
    covered: Array  # f32[S] steps at which the 90 % region held the true place
    rank: Array  # f32[S, NUM_BINS] steps by the share of the density that is likelier than truth
    negative_log_likelihood: Array  # f32[S] nats, density per square metre
    planner: Reliability  # by the probability that the planner works with
    map: Reliability  # by the share of particles in which the words refer to the object


def nothing() -> Tally:
    """Build the sum over no steps."""
    stages = len(STAGES)
    zero, bins = jnp.zeros(stages, jnp.float32), jnp.zeros((stages, NUM_BINS), jnp.float32)
    none = Reliability(events=bins, probability=bins, outcome=bins, squared_error=zero)
    return Tally(
        steps=zero, covered=zero, rank=bins, negative_log_likelihood=zero, planner=none, map=none
    )


def _density(goals: Goals, variance: Array) -> GoalDensity:
    """Collect seen objects and a selection of the particles' hypotheses."""
    number = goals.hypothesis_x.shape[0]
    chosen = np.linspace(0, number - 1, min(number, _MOST_POINTS)).astype(int)
    hypothesis = goals.hypothesis_mass[chosen]
    scale = jnp.sum(goals.hypothesis_mass) / jnp.maximum(jnp.sum(hypothesis), 1e-9)
    return GoalDensity(
        objects=jnp.stack([goals.object_x, goals.object_y])[:, :-1],
        object_mass=goals.object_mass[:-1],
        object_variance=variance,
        hypotheses=jnp.stack([goals.hypothesis_x, goals.hypothesis_y])[:, chosen],
        hypothesis_mass=hypothesis * scale,
    )


def _draw_unseen(key: Array, coverage: Coverage, number: int) -> tuple[Array, Array]:
    """Draw places independently, in proportion to the probability of being unseen."""
    num_cells = coverage.log_miss.shape[-1]
    size_x, size_y = cell_size(coverage)
    uniform = jax.random.uniform(key, (3, number))
    ends = jnp.cumsum(jnp.exp(coverage.log_miss).reshape(-1))
    cell = jnp.sum(ends[:, None] <= uniform[:1] * ends[-1], axis=0)
    cell = jnp.minimum(cell, num_cells**2 - 1)
    x = coverage.area[0] + (cell % num_cells + uniform[1]) * size_x
    y = coverage.area[2] + (cell // num_cells + uniform[2]) * size_y
    return x, y


def _independent(key: Array, goals: Goals, belief: ParticleBelief, readings: Readings) -> Goals:
    """Draw anew, independently, hypotheses of a goal of which nothing is said but that it exists.

    The filter spreads them evenly, so that they keep apart: regions of 90 % of a perfect belief
    would hold the truth in 94 % of cases. The law of what may be anywhere unseen is the coverage
    map's.
    """
    drawn_x, drawn_y = _draw_unseen(key, belief.coverage, goals.hypothesis_x.shape[0])
    reading = belief.particles.reading
    is_free = (readings.relation[:, 0] == NONE) & (readings.figure[:, 0] != NONE)
    is_free = is_free[reading] & (jnp.sum(readings.figure != NONE, axis=1) == 1)[reading]
    return replace(
        goals,
        hypothesis_x=jnp.where(is_free, drawn_x, goals.hypothesis_x),
        hypothesis_y=jnp.where(is_free, drawn_y, goals.hypothesis_y),
    )


def _reliability(probability: Array, outcome: Array, is_event: Array) -> Reliability:
    """Sort events into bins of their probability."""
    probability = jnp.clip(probability, 0.0, 1.0)
    bins = jnp.minimum((probability * NUM_BINS).astype(jnp.int32), NUM_BINS - 1)
    is_member = (bins[:, None] == jnp.arange(NUM_BINS)[None, :]) & is_event[:, None]
    member = is_member.astype(jnp.float32)
    error = jnp.where(is_event, (probability - outcome) ** 2, 0.0)
    return Reliability(
        events=jnp.sum(member, axis=0),
        probability=probability @ member,
        outcome=outcome @ member,
        squared_error=jnp.sum(error),
    )


def _referent_mass(progress: EpisodeState) -> Array:
    """Compute the share of particles in which the sentence's figure is each object, f32[O]."""
    # The figure of a reading is that of its first relation.
    belief = progress.navigator.belief
    particles, readings = belief.particles, progress.navigator.instruction.readings
    mention = readings.figure[particles.reading, 0]
    is_it = jnp.arange(particles.referent.shape[0])[:, None] == mention[None, :]
    referent = jnp.max(jnp.where(is_it, particles.referent, NONE), axis=0)
    slots = jnp.arange(particles.object_type.shape[0])
    is_slot = referent[None, :] == slots[:, None]
    return jnp.sum(jnp.where(is_slot, jnp.exp(belief.log_weight)[None, :], 0.0), axis=1)


def _is_held_as(belief: ParticleBelief, kind: Array) -> Array:
    """Tell which slots hold a thing of a type, i32[], in most of the belief: bool[O]."""
    # Particles that took a detection for something else may hold another thing in a slot, or the
    # same thing in another slot.
    is_kind = belief.particles.object_type == kind
    return jnp.sum(jnp.where(is_kind, jnp.exp(belief.log_weight), 0.0), axis=1) > 0.5


def is_it(apart: Array, is_event: Array) -> Array:
    """Tell which observed object, bool[O] of those that may be it, is the true one: one at most.

    ``apart``: f32[O], metres from the true one; ``is_event``: bool[O], what may be it. What a
    detector invents beside the goal, or what the map holds twice of it, is not the goal.
    """
    metres = jnp.where(is_event, apart, jnp.inf)
    return (jnp.arange(metres.shape[0]) == jnp.argmin(metres)) & (metres < SAME_DISTANCE)


def tally_step(progress: EpisodeState, info: NavigatorInfo, after: EpisodeState) -> Tally:
    """Hold the belief of the decision between two states of an episode against the truth."""
    scenario, belief = progress.task.scenario, after.navigator.belief
    truth = scenario.goal - progress.world.position + info.robot
    goals, covariance = info.goals, belief.particles.covariance
    # How well objects are known relative to the robot: Σ_oo + Σ_rr − 2 Σ_or.
    number = covariance.shape[0] - 1
    own = jnp.diagonal(covariance).T  # [O + 1, P]
    relative = own[:number] + own[number:] - 2.0 * covariance[number, :number]
    variance = jnp.sum(relative * jnp.exp(belief.log_weight)[None, :], axis=1)
    key = jax.random.fold_in(jax.random.fold_in(progress.task.key, progress.steps), _JUDGING)
    drawn = _independent(key, goals, belief, progress.navigator.instruction.readings)
    below, _ = _goal_region(_density(drawn, variance), truth)
    _, log_density = _goal_region(_density(goals, variance), truth)
    # Events: observed objects of the goal's type. The robot's entry is last and no object.
    is_event = _is_held_as(belief, scenario.object_type[scenario.goal_index])
    apart = jnp.hypot(goals.object_x[:-1] - truth[0], goals.object_y[:-1] - truth[1])
    outcome = is_it(apart, is_event).astype(jnp.float32)
    decile = jnp.clip(below * NUM_BINS, 0, NUM_BINS - 1).astype(jnp.int32)
    one = Tally(
        steps=jnp.float32(1.0),
        covered=(below <= 0.9).astype(jnp.float32),
        rank=(decile == jnp.arange(NUM_BINS)).astype(jnp.float32),
        negative_log_likelihood=-log_density,
        planner=_reliability(goals.object_mass[:-1], outcome, is_event),
        map=_reliability(_referent_mass(after), outcome, is_event),
    )
    stage = jnp.sum(progress.steps >= jnp.asarray(STAGES)) - 1
    is_stage = (jnp.arange(len(STAGES)) == stage).astype(jnp.float32)
    return jax.tree.map(lambda leaf: is_stage.reshape(-1, *(1,) * leaf.ndim) * leaf[None], one)


def _error(events: Reliability) -> tuple[float | None, float | None, float | None]:
    """Compute calibration error, its floor and Brier score, events [E, S, …]; None without any."""
    number = float(np.sum(events.events))
    if not number:
        return None, None, None
    # Events of one episode hang together: what a bin's gap owes to chance is between episodes.
    gaps = (np.asarray(events.probability) - np.asarray(events.outcome)).sum(axis=1)
    error = float(np.abs(gaps.sum(axis=0)).sum()) / number
    floor = float(np.sqrt(2 / np.pi) * np.sqrt((gaps**2).sum(axis=0)).sum()) / number
    return error, floor, float(np.sum(events.squared_error)) / number


def scores(tally: Tally, stage: int | None = None) -> dict[str, float | None]:
    """Turn sums of episodes, leaves [E, S, …], into scores; of one of ``STAGES``, all if None.

    ``ece`` and ``brier`` (None if no object of the goal's type was ever seen) of the planner's
    probabilities, ``ece_map`` and ``brier_map`` of the map's, ``ece_floor`` and ``ece_map_floor``:
    what so few episodes would show if the belief were perfect, ``coverage90`` in percent and its
    standard error ``coverage90_se``, ``nll`` in nats, ``calibration_events``,
    ``calibration_steps``.
    """
    span = slice(None) if stage is None else slice(stage, stage + 1)
    part = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64)[:, span], tally)
    steps, covered = part.steps.sum(axis=1), part.covered.sum(axis=1)
    number = max(1.0, float(steps.sum()))
    share = float(covered.sum()) / number
    errors: dict[str, float | None] = {}
    for events, of in ((part.planner, ""), (part.map, "_map")):
        names = f"ece{of}", f"ece{of}_floor", f"brier{of}"
        errors |= dict(zip(names, _error(events), strict=True))
    return errors | {
        "coverage90": 100.0 * share,
        "coverage90_se": 100.0 * float(np.sqrt(((covered - share * steps) ** 2).sum())) / number,
        "nll": float(part.negative_log_likelihood.sum()) / number,
        "calibration_events": float(part.planner.events.sum()),
        "calibration_steps": float(steps.sum()),
    }
