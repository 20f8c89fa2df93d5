"""What hardly exists is forgotten, so that false detections do not fill the map (ours)."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.semantic_map.particle import SemanticMap, clear

LEAST_EXISTENCE, LEAST_WORTH = 1e-4, 0.02
"""Probability below which a thing that was detected is taken not to exist, and forgotten; and where
hardly a slot is free. What is forgotten takes its detections with it, but the looks that missed it
stay: a thing forgotten too soon would have to be detected more often than it can be."""
_SPARE_SLOTS = 2
"""Slots that are kept free, if need be, by forgetting what is least likely to exist."""


def forget(particles: SemanticMap) -> tuple[SemanticMap, Array]:
    """Empty the slots of what hardly exists, in all particles: slots stay of one thing.

    Args:
        particles: leaves [..., P], which hold ``existence``.

    Returns:
        The particles, and bool[P], whose words refer to such a thing.
    """
    is_held = particles.is_observed
    likeliest = jnp.max(jnp.where(is_held, particles.existence, 0.0), axis=-1, keepdims=True)
    is_taken = jnp.any(is_held, axis=-1, keepdims=True)
    is_crowded = jnp.sum(is_taken) > is_taken.shape[0] - _SPARE_SLOTS
    least = jnp.argmin(jnp.where(is_taken, likeliest, jnp.inf))
    is_least = (jnp.arange(is_taken.shape[0])[:, None] == least) & is_crowded
    limit = jnp.where(is_least, LEAST_WORTH, LEAST_EXISTENCE)
    is_gone = is_held & (likeliest < limit)
    is_lost = jnp.any(is_gone & particles.is_meant, axis=0)
    # Most looks empty none.
    rounds = jnp.any(is_gone).astype(jnp.int32)
    kept = jax.lax.fori_loop(0, rounds, lambda _, held: clear(held, is_gone), particles)
    return kept, is_lost
