"""Closed-loop calibration of the belief: ECE, Brier score, NLL and coverage of 90 % regions.

At every decision the belief is compared with the ground truth, which only this module may use:
- events "this observed object is the goal", one for each of the goal's type in most maps, with the
  probability that the planner uses, and with that of the map (the weight of particles in which the
  sentence refers to it): Brier score and expected calibration error (ECE);
- the density of the goal's position, from all particles: negative log-likelihood (NLL) at the true
  position, and whether the 90 % highest-density region contains it.

The belief's map drifts with odometry, so positions are compared relative to the robot. A stop
depends only on observations, so ending an episode there introduces no bias.
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

BANDWIDTH = 1.0  # metres, of the kernel density over the particles' hypotheses
_MIN_VARIANCE = 1e-4  # square metres; lower bound of the variance of an object's position
_LOG_FLOOR = 1e-12  # per square metre
NUM_BINS = 10
MATCH_RADIUS = 0.75
"""Metres within which an observed object matches the true one, if none is nearer."""
STAGES = (0, 5, 10, 15, 20, 30)  # first decision cycle of each stage with separate scores
_KEY_INDEX = 78
"""Folded into a cycle's key for calibration; world and navigator use smaller indices."""
_MAX_POINTS = 64  # particles of the kernel density, whose cost is quadratic in them


@pytree
class GoalDensity:
    """Belief over the goal's position: a Gaussian per observed object, and point hypotheses."""

    objects: Array  # f32[2, O] metres, map frame
    object_mass: Array  # f32[O] probability of being the goal
    object_variance: Array  # f32[O] square metres per axis, relative to the robot
    hypotheses: Array  # f32[2, H] metres, map frame
    hypothesis_mass: Array  # f32[H] probability of being the goal


def _hpd_level(density: GoalDensity, truth: Array) -> tuple[Array, Array]:
    """Compute the credible level of the smallest HPD region with ``truth``, f32[2]; log-density."""
    #     level = Σ_h m_h [f₋ₕ(x_h) > t] + Σ_o m_o (1 − (t − b_o) / p_o),    t = f(truth)
    # with f the mixture of Gaussians about observed objects (peak m_o / 2π s_o = p_o over the
    # background b_o) and of kernels about hypotheses. A hypothesis is one sample, and is left out
    # of the density at its position (f₋ₕ), as are its copies: so if the truth is one more sample
    # of the same distribution, ``level`` is uniform between 0 and 1.
    scale = 1.0 / jnp.maximum(jnp.sum(density.object_mass) + jnp.sum(density.hypothesis_mass), 1e-9)
    mass_o, mass_h = density.object_mass * scale, density.hypothesis_mass * scale
    variance = jnp.maximum(density.object_variance, _MIN_VARIANCE)

    def kernels(centers: Array, variance: Array, points: Array) -> Array:
        dx, dy = points[:, :, None] - centers[:, None]
        return jnp.exp(gaussian.log_normal_isotropic(dx, dy, variance))

    hypotheses = functools.partial(kernels, density.hypotheses, jnp.float32(BANDWIDTH**2))
    objects = functools.partial(kernels, density.objects, variance[None])
    point = truth[:, None]
    at_truth = (hypotheses(point) @ mass_h + objects(point) @ mass_o)[0]
    kde = hypotheses(density.hypotheses)
    is_copy = kde > (1.0 - 1e-6) / (2.0 * jnp.pi * BANDWIDTH**2)
    at_hypotheses = jnp.where(is_copy, 0.0, kde) @ mass_h + objects(density.hypotheses) @ mass_o
    is_self = jnp.eye(mass_o.shape[0], dtype=bool)
    background = jnp.where(is_self, 0.0, objects(density.objects)) @ mass_o
    background = hypotheses(density.objects) @ mass_h + background
    peak = mass_o / (2.0 * jnp.pi * variance)
    denser = 1.0 - jnp.clip((at_truth - background) / jnp.maximum(peak, 1e-20), 0.0, 1.0)
    level = jnp.sum(jnp.where(at_hypotheses > at_truth, mass_h, 0.0)) + jnp.sum(mass_o * denser)
    return level, jnp.log(jnp.maximum(at_truth, _LOG_FLOOR))


@pytree
class Reliability:
    """Sums over events, binned by probability; leaves may lead with stages and episodes."""

    events: Array  # f32[NUM_BINS] number of events
    probability: Array  # f32[NUM_BINS] sum of their predicted probabilities
    outcome: Array  # f32[NUM_BINS] number of them that are true
    squared_error: Array  # f32[] sum over all bins, as in the Brier score


@pytree
class Tally:
    """Calibration sums over steps, additive over episodes; leaves lead with stages ``STAGES``."""

    steps: Array  # f32[S] number of steps
    covered: Array  # f32[S] steps at which the 90 % region contained the goal
    rank: Array  # f32[S, NUM_BINS] steps by the mass of higher density than the truth
    negative_log_likelihood: Array  # f32[S] nats, density per square metre
    planner: Reliability  # by the probability that the planner uses
    map: Reliability  # by the weight of particles in which the sentence refers to the object


def empty_tally() -> Tally:
    """Build a tally of zeros."""
    stages = len(STAGES)
    zero, bins = jnp.zeros(stages, jnp.float32), jnp.zeros((stages, NUM_BINS), jnp.float32)
    zeros = Reliability(events=bins, probability=bins, outcome=bins, squared_error=zero)
    return Tally(
        steps=zero, covered=zero, rank=bins, negative_log_likelihood=zero, planner=zeros, map=zeros
    )


def _goal_density(goals: Goals, variance: Array) -> GoalDensity:
    """Collect observed objects and a subset of the particles' hypotheses."""
    count = goals.hypothesis_x.shape[0]
    idx = np.linspace(0, count - 1, min(count, _MAX_POINTS)).astype(int)
    mass = goals.hypothesis_mass[idx]
    scale = jnp.sum(goals.hypothesis_mass) / jnp.maximum(jnp.sum(mass), 1e-9)
    return GoalDensity(
        objects=jnp.stack([goals.object_x, goals.object_y])[:, :-1],
        object_mass=goals.object_mass[:-1],
        object_variance=variance,
        hypotheses=jnp.stack([goals.hypothesis_x, goals.hypothesis_y])[:, idx],
        hypothesis_mass=mass * scale,
    )


def _sample_unseen(key: Array, coverage: Coverage, count: int) -> tuple[Array, Array]:
    """Sample positions independently, in proportion to the probability of being unseen."""
    num_cells = coverage.log_miss.shape[-1]
    width, height = cell_size(coverage)
    uniform = jax.random.uniform(key, (3, count))
    cumulative = jnp.cumsum(jnp.exp(coverage.log_miss).reshape(-1))
    cell = jnp.sum(cumulative[:, None] <= uniform[:1] * cumulative[-1], axis=0)
    cell = jnp.minimum(cell, num_cells**2 - 1)
    x = coverage.area[0] + (cell % num_cells + uniform[1]) * width
    y = coverage.area[2] + (cell // num_cells + uniform[2]) * height
    return x, y


def _resample_free(key: Array, goals: Goals, belief: ParticleBelief, readings: Readings) -> Goals:
    """Resample independently the hypotheses of a goal without any spatial constraint.

    The filter stratifies them, so they repel each other: 90 % regions of a perfect belief would
    contain the truth in 94 % of cases. An unseen object's position is distributed as in the
    coverage map.
    """
    sampled_x, sampled_y = _sample_unseen(key, belief.coverage, goals.hypothesis_x.shape[0])
    reading = belief.particles.reading
    is_unrelated = (readings.relation[:, 0] == NONE) & (readings.figure[:, 0] != NONE)
    is_free = is_unrelated[reading] & (jnp.sum(readings.figure != NONE, axis=1) == 1)[reading]
    return replace(
        goals,
        hypothesis_x=jnp.where(is_free, sampled_x, goals.hypothesis_x),
        hypothesis_y=jnp.where(is_free, sampled_y, goals.hypothesis_y),
    )


def _reliability(probability: Array, outcome: Array, is_event: Array) -> Reliability:
    """Sum events into bins of their probability."""
    probability = jnp.clip(probability, 0.0, 1.0)
    bins = jnp.minimum((probability * NUM_BINS).astype(jnp.int32), NUM_BINS - 1)
    member = jax.nn.one_hot(bins, NUM_BINS) * is_event[:, None]
    return Reliability(
        events=jnp.sum(member, axis=0),
        probability=probability @ member,
        outcome=outcome @ member,
        squared_error=jnp.sum(jnp.where(is_event, (probability - outcome) ** 2, 0.0)),
    )


def _referent_mass(state: EpisodeState) -> Array:
    """Compute the weight of particles in which each object is the sentence's figure, f32[O]."""
    # The figure of a reading is that of its first relation.
    belief = state.navigator.belief
    particles, readings = belief.particles, state.navigator.instruction.readings
    mention = readings.figure[particles.reading, 0]
    is_figure = jnp.arange(particles.referent.shape[0])[:, None] == mention[None, :]
    referent = jnp.max(jnp.where(is_figure, particles.referent, NONE), axis=0)
    is_referent = referent[None, :] == jnp.arange(particles.object_type.shape[0])[:, None]
    return jnp.sum(jnp.where(is_referent, jnp.exp(belief.log_weight)[None, :], 0.0), axis=1)


def _has_type(belief: ParticleBelief, object_type: Array) -> Array:
    """Find the slots that hold an object of a type, i32[], with weight above 1/2: bool[O]."""
    # With another data association, a particle may hold another object in a slot, or the same
    # object in another slot. The type NONE of a missing goal is that of empty slots: no object.
    is_type = (belief.particles.object_type == object_type) & (object_type != NONE)
    return jnp.sum(jnp.where(is_type, jnp.exp(belief.log_weight), 0.0), axis=1) > 0.5


def matched_object(distance: Array, is_event: Array) -> Array:
    """Match the true object to an observed one, at most one: bool[O].

    ``distance``: f32[O], metres from the true one; ``is_event``: bool[O], the candidates. Clutter
    beside the goal, or a duplicate of it in the map, is not the goal.
    """
    distances = jnp.where(is_event, distance, jnp.inf)
    return (jnp.arange(distances.shape[0]) == jnp.argmin(distances)) & (distances < MATCH_RADIUS)


def tally_step(before: EpisodeState, info: NavigatorInfo, after: EpisodeState) -> Tally:
    """Compare the belief of the decision between two states of an episode with the truth.

    Limits: all zeros in a world without an intended object.
    """
    scenario, belief = before.task.scenario, after.navigator.belief
    truth = scenario.goal - before.world.position + info.robot
    goals, covariance = info.goals, belief.particles.covariance
    # Variance of objects relative to the robot: Σ_oo + Σ_rr − 2 Σ_or.
    count = covariance.shape[0] - 1
    variances = jnp.diagonal(covariance).T  # [O + 1, P]
    relative = variances[:count] + variances[count:] - 2.0 * covariance[count, :count]
    variance = jnp.sum(relative * jnp.exp(belief.log_weight)[None, :], axis=1)
    key = jax.random.fold_in(jax.random.fold_in(before.task.key, before.steps), _KEY_INDEX)
    resampled = _resample_free(key, goals, belief, before.navigator.instruction.readings)
    level, _ = _hpd_level(_goal_density(resampled, variance), truth)
    _, log_density = _hpd_level(_goal_density(goals, variance), truth)
    # Events: observed objects of the goal's type. The last entry is the robot.
    is_event = _has_type(belief, scenario.object_type[scenario.goal_index])
    distance = jnp.hypot(goals.object_x[:-1] - truth[0], goals.object_y[:-1] - truth[1])
    outcome = matched_object(distance, is_event).astype(jnp.float32)
    bin_index = jnp.clip(level * NUM_BINS, 0, NUM_BINS - 1).astype(jnp.int32)
    sums = Tally(
        steps=jnp.float32(1.0),
        covered=(level <= 0.9).astype(jnp.float32),
        rank=jax.nn.one_hot(bin_index, NUM_BINS),
        negative_log_likelihood=-log_density,
        planner=_reliability(goals.object_mass[:-1], outcome, is_event),
        map=_reliability(_referent_mass(after), outcome, is_event),
    )
    stage = jnp.sum(before.steps >= jnp.asarray(STAGES)) - 1
    is_stage = jax.nn.one_hot(stage, len(STAGES)) * (scenario.goal_index != NONE)
    return jax.tree.map(lambda leaf: is_stage.reshape(-1, *(1,) * leaf.ndim) * leaf[None], sums)


def _bin_errors(events: Reliability, suffix: str) -> dict[str, float | None]:
    """Compute ECE, its floor and Brier score of events [E, S, …]; None without events."""
    names = f"ece{suffix}", f"ece{suffix}_floor", f"brier{suffix}"
    total = float(np.sum(events.events))
    if not total:
        return dict.fromkeys(names)
    # Events of one episode are correlated: a bin's noise is estimated between episodes.
    gaps = (np.asarray(events.probability) - np.asarray(events.outcome)).sum(axis=1)
    error = float(np.abs(gaps.sum(axis=0)).sum()) / total
    floor = float(np.sqrt(2 / np.pi) * np.sqrt((gaps**2).sum(axis=0)).sum()) / total
    brier = float(np.sum(events.squared_error)) / total
    return dict(zip(names, (error, floor, brier), strict=True))


def scores(tally: Tally, stage: int | None = None) -> dict[str, float | None]:
    """Compute calibration scores of episodes, leaves [E, S, …], for one of ``STAGES`` or all.

    ``ece`` and ``brier`` (None if no object of the goal's type was ever seen) of the planner's
    probabilities, ``ece_map`` and ``brier_map`` of the map's, ``ece_floor`` and ``ece_map_floor``:
    their expectation for a perfect belief with as many episodes, ``coverage90`` in percent and its
    standard error ``coverage90_se``, ``nll`` in nats (these None if no world has a goal),
    ``calibration_events``, ``calibration_steps``.
    """
    stages = slice(None) if stage is None else slice(stage, stage + 1)
    sums = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64)[:, stages], tally)
    steps, covered = sums.steps.sum(axis=1), sums.covered.sum(axis=1)
    count = float(steps.sum())
    density: dict[str, float | None] = dict.fromkeys(("coverage90", "coverage90_se", "nll"))
    if count:
        rate = float(covered.sum()) / count
        error = float(np.sqrt(((covered - rate * steps) ** 2).sum())) / count
        nll = float(sums.negative_log_likelihood.sum()) / count
        density = {"coverage90": 100.0 * rate, "coverage90_se": 100.0 * error, "nll": nll}
    return {
        **_bin_errors(sums.planner, ""),
        **_bin_errors(sums.map, "_map"),
        **density,
        "calibration_events": float(sums.planner.events.sum()),
        "calibration_steps": count,
    }
