"""Relations learned from episodes that nobody has labelled (section 3.2, eq. 7a).

An episode leaves a map behind, and the sentence that was said in it. Under other relations the
sentence would have been more or less probable, given that map and where the robot has looked:
``episode_evidence.log_words``. Its maximum over many episodes is the relation as people used it;
which of the seen things was meant, or whether it was never seen, is summed over.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from jaxlangnav.episode import EpisodeResult, Task, complete, finish
from jaxlangnav.experiments.episode_evidence import WordsEvidence, log_words_of, remember
from jaxlangnav.experiments.monte_carlo import map_pieces
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import RelationParams
from jaxlangnav.semantic_map.params import MapParams

LANES = 64
"""Episodes of one call; all wait for the slowest."""
NUM_READINGS = 1
"""Readings of a sentence that are held against an episode: the likeliest."""


@pytree
class EpisodeFit:
    """A relation fitted to episodes; the four parameters of one word."""

    params: RelationParams
    standard_error: Array  # f32[4] of log distance, its spread, axis, concentration
    log_evidence: Array  # f32[I + 1] of all episodes, before and after every iteration


@functools.partial(jax.jit, static_argnames=("config", "max_steps"))
def _run(
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int,
) -> tuple[EpisodeResult, WordsEvidence]:
    """Run episodes to their ends, leaves [E, …]."""

    def one(task: Task) -> tuple[EpisodeResult, WordsEvidence]:
        last = complete(task, instructions, params=params, config=config, max_steps=max_steps)
        readings = last.navigator.instruction.readings
        kept = remember(last.navigator.belief, readings, num_readings=NUM_READINGS)
        return finish(last), kept

    return jax.vmap(one)(tasks)


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
    return map_pieces(
        lambda piece, _: _run(
            piece, instructions, params=params, config=config, max_steps=max_steps
        ),
        tasks,
        capacity=LANES,
    )


def _with(params: RelationParams, relation: int, free: Array) -> RelationParams:
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
        num_iterations: I.

    Returns:
        The fit. Standard errors are of the curvature at its end.

    Raises:
        ValueError: the relation has no direction to begin with.
    """
    if float(init.concentration[relation]) <= 0.0:
        raise ValueError("only a relation with a direction (concentration > 0) can be fitted")
    number = jnp.float32(episodes.area.shape[0])

    def loss(free: Array) -> Array:
        return -log_words_of(episodes, _with(init, relation, free), params) / number

    optimizer = optax.lbfgs()
    evaluate = optax.value_and_grad_from_state(loss)

    @jax.jit
    def iterate(free: Array, state: optax.OptState) -> tuple[Array, optax.OptState, Array]:
        value, slope = evaluate(free, state=state)
        update, state = optimizer.update(slope, state, free, value=value, grad=slope, value_fn=loss)
        return jnp.asarray(optax.apply_updates(free, update)), state, jnp.asarray(value)

    free = jnp.stack(
        [
            init.log_distance[relation],
            jnp.log(init.log_distance_sd[relation]),
            init.axis[relation],
            jnp.log(init.concentration[relation]),
        ]
    )
    state, trace = optimizer.init(free), []
    for _ in range(num_iterations):
        free, state, value = iterate(free, state)
        trace.append(-float(value) * float(number))
    trace.append(-float(jax.jit(loss)(free)) * float(number))
    return EpisodeFit(
        params=_with(init, relation, free),
        standard_error=_errors(jax.jit(jax.grad(loss)), free, float(number)),
        log_evidence=jnp.asarray(trace, jnp.float32),
    )


def _errors(gradient: Callable[[Array], Array], free: Array, number: float) -> Array:
    """Compute standard errors from differences of the gradient, f32[4]."""
    step, size = 1e-2, free.shape[0]
    rows = [
        np.asarray(gradient(free + step * unit) - gradient(free - step * unit)) / (2 * step)
        for unit in jnp.eye(size)
    ]
    curvature = 0.5 * number * (np.stack(rows) + np.stack(rows).T)
    covariance = np.linalg.pinv(curvature.astype(np.float64), hermitian=True)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Spread and concentration were fitted as logarithms.
    scale = np.array([1.0, float(jnp.exp(free[1])), 1.0, float(jnp.exp(free[3]))])
    return jnp.asarray(error * scale, jnp.float32)
