"""The random numbers with which words are grounded: of all particles and relations (eq. 7a)."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.numerics import batching
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, is_led, mean_drift
from jaxlangnav.semantic_map.candidates import NUM_UNSEEN, Draws, Scene
from jaxlangnav.semantic_map.coverage import area_size, sample_unseen
from jaxlangnav.semantic_map.looking import both_ways

_STEPS = np.array([0.61803399, 0.41421356, 0.73205081, 0.64575131], np.float32)
"""Steps of additive recurrences, fractions of roots of 5, 2, 3 and 7: each fills the unit interval
evenly, the first most evenly of all, and several together the cube."""


def _unseen(belief: ParticleBelief, uniform: Array, jitter: Array) -> tuple[Scene, Array]:
    """Draw places that are unseen, f32[2, n]; with a steady drift f32[2, n, P], by its own sign."""
    coverage, log_area = belief.coverage, jnp.log(area_size(belief.coverage))
    x, y, log_unseen = sample_unseen(coverage, uniform, jitter)
    places = jnp.stack([x, y])
    if mean_drift(belief) is None:
        return Scene(coverage, jnp.int32(0), log_area, log_unseen), places
    looked, is_ours = both_ways(belief), is_led(belief)
    other = replace(coverage, log_miss=belief.other_miss)
    x, y, log_other = sample_unseen(other, uniform, jitter)
    places = jnp.where(is_ours, places[..., None], jnp.stack([x, y])[..., None])
    log_unseen = jnp.where(is_ours, log_unseen, log_other)
    return Scene(looked.coverage, looked.first_row, log_area, log_unseen), places


def draw_places(
    key: Array, belief: ParticleBelief, num_relations: int
) -> tuple[Array, Draws, Scene]:
    """Draw the random numbers of all particles and relations.

    Args:
        key: random key, consumed.
        belief: where the robot has looked.
        num_relations: J.

    Returns:
        f32[P] that decides which reading a particle takes; leaves [J, ...]; the scene.
    """
    number = belief.log_weight.shape[0]
    pool = NUM_UNSEEN * number
    reading_key, draws_key = jax.random.split(key)
    pool_key, loop_key = jax.random.split(draws_key)
    index = np.arange(num_relations)
    keys = jax.vmap(lambda one: jax.random.split(jax.random.fold_in(loop_key, one)))(index)
    keys_of_all = jnp.concatenate([jnp.stack([reading_key, pool_key]), keys[:, 0]])
    uniforms = batching.uniforms(keys_of_all, max(2 * NUM_UNSEEN, 5) * number)
    comb = uniforms[1, : 2 * pool].reshape(2, pool)
    scene, places = _unseen(belief, comb[0, 0], comb)
    steps = jnp.asarray(_STEPS[index % len(_STEPS)])
    of_all = jax.vmap(_of_relation, in_axes=(0, 0, 0, None))
    return uniforms[0, :number], of_all(uniforms[2:], keys[:, 1], steps, places), scene


def _of_relation(uniform: Array, shuffle_key: Array, step: Array, places: Array) -> Draws:
    """Draw the random numbers of one relation, for all particles; leaves [..., P]."""
    pool = places.shape[1]
    number = pool // NUM_UNSEEN
    stride = next(step for step in range(int(0.618 * number), 0, -1) if math.gcd(step, number) == 1)
    # Which place of the comb goes to which particle is random: a fixed assignment would tie
    # particles to regions. Each row is dealt over the whole comb.
    dealt = NUM_UNSEEN * (stride * np.arange(number) % number) + np.arange(NUM_UNSEEN)[:, None]
    start = jax.random.randint(shuffle_key, (), 0, pool)
    chosen = jax.lax.rem(start + dealt.astype(np.int32), pool)
    unit = batching.between(uniform[: 5 * number], 1e-6, 1.0 - 1e-6).reshape(5, number)
    normal = jax.scipy.special.ndtri(unit[:4])
    own = chosen if places.ndim == 2 else (chosen, np.arange(number))
    return Draws(
        distance=normal[:2],
        angle=normal[2:],
        # Evenly spread over the particles: what they choose stays for the episode, and with it the
        # error of independent draws. Each relation has a step of its own, or what a particle
        # chooses for one would tell what it chooses for the next.
        choice=jax.lax.rem(unit[4, 0] + step * np.arange(number, dtype=np.float32), 1.0),
        unseen_x=places[0][own],
        unseen_y=places[1][own],
    )
