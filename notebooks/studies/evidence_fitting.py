"""Relations learned from episodes that nobody has labelled (section 3.2, eq. 7a).

An episode leaves a map behind, and the sentence that was said in it. Under other relations that
map would have been more or less probable, given the sentence and where the robot has looked:

    θ* = argmax_θ Σ_episodes [log p(words | map, m; θ) − log Z(θ)]

(``episode_evidence.log_fit``; Z is the share of worlds drawn by θ that fit the area). Its maximum
over many episodes is the relation as people used it; which of the seen things was meant, or
whether it was never seen, is summed over.

How the robot chose its way does not enter: a policy that knows only what it has seen and heard,
under whatever relations it assumes, has the same probability under every θ.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax import Array

from jaxlangnav.episode import EpisodeResult, EpisodeState, Task, finish
from jaxlangnav.experiments.monte_carlo import run_tasks
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.episode.lanes import EPISODE
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import RelationParams
from jaxlangnav.semantic_map.params import MapParams
from studies.episode_evidence import EpisodeGroup, WordsEvidence, by_setting, log_fit_of, remember

READINGS_HELD = 1
"""Readings of a sentence that are held against an episode: the likeliest."""
FLAT = 1e-3
"""Slope of the mean evidence, nats, that counts as the top. The information of an episode on the
four free parameters is 0.3 to 9: of 128 episodes, within a fiftieth of the standard errors."""
FIRST_STEP = 0.2
"""Of the climb, log metres or radians: from afar, a step of one may end in another valley."""
LEAST_SPREAD = 0.25
"""Radial deviation in cells."""
CURVATURE_STEP = 1e-2
"""Of the difference of slopes: log metres, radians."""


@pytree
class EpisodeFit:
    """A relation fitted to episodes; the four parameters of one word."""

    params: RelationParams
    standard_error: Array  # f32[4] of log distance, its spread, axis, concentration
    log_evidence: Array  # f32[J + 1] of all episodes, before and after each of J iterations


def _remembered(last: EpisodeState) -> tuple[EpisodeResult, WordsEvidence]:
    """Keep of an episode at its end what its words can be held against."""
    readings = last.navigator.instruction.readings
    return finish(last), remember(last.navigator.belief, readings, num_readings=READINGS_HELD)


def run_and_remember(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = 40,
) -> tuple[EpisodeResult, WordsEvidence]:
    """Run episodes and keep what their words can be held against.

    Args:
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out.

    Returns:
        Results and evidence as NumPy arrays, leaves [E, …].
    """
    course = EPISODE._replace(finish=_remembered)
    return run_tasks(
        tasks, instructions, params=params, config=config, max_steps=max_steps, program=course
    )


def _with(params: RelationParams, relation: int | Array, free: Array) -> RelationParams:
    """Set one word's parameters: log distance, log spread, axis, log concentration."""
    return RelationParams(
        log_distance=params.log_distance.at[relation].set(free[0]),
        log_distance_sd=params.log_distance_sd.at[relation].set(jnp.exp(free[1])),
        axis=params.axis.at[relation].set(free[2]),
        concentration=params.concentration.at[relation].set(jnp.exp(free[3])),
    )


def fit_to_episodes(
    episodes: WordsEvidence,
    relation: int,
    init: RelationParams,
    *,
    params: MapParams,
    num_iterations: int = 30,
) -> EpisodeFit:
    """Fit one directed relation to episodes by gradient (L-BFGS).

    Args:
        episodes: leaves [E, …]; sentences that say this relation.
        relation: index into ``messages.RELATIONS``, one with a direction.
        init: relations that the fit starts from.
        params: concentration, misleading, softness of the map.
        num_iterations: J, at most.

    Returns:
        The fit. Standard errors are of the curvature at its end; infinite where it has no top
        there, as for a spread that ends at its least, a quarter of a cell of the coverage map.

    Raises:
        ValueError: the relation has no direction to begin with, or a sentence is a superlative.
    """
    if float(init.concentration[relation]) <= 0.0:
        raise ValueError("only a relation with a direction (concentration > 0) can be fitted")
    if bool(np.any(np.asarray(episodes.readings.rank) == 1)):
        raise ValueError(
            'a superlative ("nearest") depends on rivals that may not have been seen: '
            "fit to sentences without one"
        )
    free = jnp.stack(
        [
            init.log_distance[relation],
            jnp.log(init.log_distance_sd[relation]),
            init.axis[relation],
            jnp.log(init.concentration[relation]),
        ]
    )
    groups, number = by_setting(episodes), episodes.area.shape[0]

    begin = np.asarray(free, np.float64)

    def loss(step: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the mean negative evidence and its slope, as the optimizer wants them."""
        at = jnp.asarray(begin + FIRST_STEP * step, jnp.float32)
        parts = [_loss(at, group, relation, init, params) for group in groups]
        value = sum(float(one) for one, _ in parts)
        slope = np.sum([np.asarray(one, np.float64) for _, one in parts], axis=0)
        return value / number, FIRST_STEP * slope / number

    trace = [loss(np.zeros_like(begin))[0]]
    found = scipy.optimize.minimize(
        loss,
        np.zeros_like(begin),
        jac=True,
        bounds=_bounds(episodes, init, relation),
        method="L-BFGS-B",
        options={"maxiter": num_iterations, "gtol": FIRST_STEP * FLAT},
        callback=lambda intermediate_result: trace.append(float(intermediate_result.fun)),
    )
    step = CURVATURE_STEP / FIRST_STEP * np.eye(begin.size)
    bends = [loss(found.x + one)[1] - loss(found.x - one)[1] for one in step]
    curvature = number * np.array(bends) / (2.0 * CURVATURE_STEP * FIRST_STEP)
    free = jnp.asarray(begin + FIRST_STEP * found.x, jnp.float32)
    return EpisodeFit(
        params=_with(init, relation, free),
        standard_error=_errors(free, 0.5 * (curvature + curvature.T)),
        log_evidence=-number * jnp.asarray(trace, jnp.float32),
    )


def _bounds(
    episodes: WordsEvidence, init: RelationParams, relation: int
) -> list[tuple[float | None, float | None]]:
    """Keep the spread, in steps from ``init``, above what the grid can tell.

    A ring much thinner than a cell meets few of the centres, and which ones is chance.
    """
    cell = float(np.sqrt(np.mean(episodes.area) / episodes.miss.shape[-1]))
    least = LEAST_SPREAD * cell / float(jnp.exp(init.log_distance[relation]))
    down = (np.log(least) - float(jnp.log(init.log_distance_sd[relation]))) / FIRST_STEP
    return [(None, None), (min(float(down), 0.0), None), (None, None), (None, None)]


@jax.jit
def _loss(
    free: Array, group: EpisodeGroup, relation: Array, init: RelationParams, params: MapParams
) -> tuple[Array, Array]:
    """Compute the negative evidence f32[] of a group and its slope f32[4]."""
    return jax.value_and_grad(
        lambda at: -log_fit_of(group, _with(init, relation, at), params=params)
    )(free)


def _errors(free: Array, curvature: np.ndarray) -> Array:
    """Compute standard errors of the parameters from the curvature f64[4, 4], f32[4]."""
    covariance = np.linalg.pinv(curvature, hermitian=True)
    variance = np.diag(covariance)
    error = np.sqrt(np.where(variance > 0.0, variance, np.inf))
    # Spread and concentration were fitted as logarithms.
    scale = np.array([1.0, float(jnp.exp(free[1])), 1.0, float(jnp.exp(free[3]))])
    return jnp.asarray(error * scale, jnp.float32)
