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

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from jaxlangnav.episode import EpisodeResult, Task, complete, finish
from jaxlangnav.experiments.episode_evidence import WordsEvidence, log_fit_of, remember
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
FLAT = 1e-3
"""Slope of the mean evidence, nats, that counts as the top. The information of an episode on the
four free parameters is 0.3 to 9: of 128 episodes, within a fiftieth of the standard errors."""


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
        num_iterations: I, at most.

    Returns:
        The fit. Standard errors are of the curvature at its end.

    Raises:
        ValueError: the relation has no direction to begin with, or a sentence is a superlative.
    """
    if float(init.concentration[relation]) <= 0.0:
        raise ValueError("only a relation with a direction (concentration > 0) can be fitted")
    if bool(np.any(np.asarray(episodes.readings.is_superlative))):
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
    free, log_evidence, curvature = _climb(
        episodes, free, jnp.int32(relation), init, params, num_iterations=num_iterations
    )
    return EpisodeFit(
        params=_with(init, relation, free),
        standard_error=_errors(free, np.asarray(curvature, np.float64)),
        log_evidence=log_evidence,
    )


@functools.partial(jax.jit, static_argnames="num_iterations")
def _climb(
    episodes: WordsEvidence,
    free: Array,
    relation: Array,
    init: RelationParams,
    params: MapParams,
    *,
    num_iterations: int,
) -> tuple[Array, Array, Array]:
    """Climb from f32[4]: its end, the evidence f32[I + 1] on the way, the curvature f32[4, 4]."""
    number = episodes.area.shape[0]

    def loss(free: Array) -> Array:
        return -log_fit_of(episodes, _with(init, relation, free), params) / number

    optimizer = optax.lbfgs()
    evaluate = optax.value_and_grad_from_state(loss)

    def iterate(
        carry: tuple[Array, optax.OptState], _: None
    ) -> tuple[tuple[Array, optax.OptState], Array]:
        free, state = carry
        value, slope = evaluate(free, state=state)

        def go() -> tuple[Array, optax.OptState]:
            update, after = optimizer.update(
                slope, state, free, value=value, grad=slope, value_fn=loss
            )
            return jnp.asarray(optax.apply_updates(free, update)), after

        # At the top, float32 shows the line search no way up, and it tries for long.
        is_there = jnp.max(jnp.abs(jnp.asarray(slope))) < FLAT
        return jax.lax.cond(is_there, lambda: carry, go), jnp.asarray(value)

    start = free, optimizer.init(free)
    (free, _), values = jax.lax.scan(iterate, start, length=num_iterations)
    step = 1e-2

    def bend(unit: Array) -> Array:
        ahead, behind = jax.lax.map(
            jax.grad(loss), jnp.stack([free + step * unit, free - step * unit])
        )
        return (ahead - behind) / (2.0 * step)

    curvature = jax.lax.map(bend, jnp.eye(free.shape[0]))
    trace = jnp.append(values, loss(free))
    return free, -number * trace, 0.5 * number * (curvature + curvature.T)


def _errors(free: Array, curvature: np.ndarray) -> Array:
    """Compute standard errors of the parameters from the curvature f64[4, 4], f32[4]."""
    covariance = np.linalg.pinv(curvature, hermitian=True)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Spread and concentration were fitted as logarithms.
    scale = np.array([1.0, float(jnp.exp(free[1])), 1.0, float(jnp.exp(free[3]))])
    return jnp.asarray(error * scale, jnp.float32)
