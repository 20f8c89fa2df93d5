"""QMDP values of candidate waypoints (section 3.4, eq. 11 and 12)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.goals import Goals


def values(node_x: Array, node_y: Array, goals: Goals, discount: Array) -> Array:
    """Compute the expected discounted value of standing at each node.

        V(a) = Σ_i Σ_j γ^{d(a, g_ij)} p(β_j | S_i) p(S_i)      (eq. 11, 12)

    Limits: γ → 1 gives the total goal mass everywhere; a node on the only goal has value 1.

    Args:
        node_x: f32[A], metres, map frame.
        node_y: f32[A], metres.
        goals: weighed goals.
        discount: f32[], γ per metre, in (0, 1).

    Returns:
        f32[A].
    """
    x = jnp.concatenate([goals.object_x, goals.hypothesis_x])
    y = jnp.concatenate([goals.object_y, goals.hypothesis_y])
    mass = jnp.concatenate([goals.object_mass, goals.hypothesis_mass])
    distance = jnp.sqrt(
        (node_x[:, None] - x[None, :]) ** 2 + (node_y[:, None] - y[None, :]) ** 2 + 1e-9
    )
    return jnp.sum(mass[None, :] * jnp.exp(jnp.log(discount) * distance), axis=1)


def mass_within(x: Array, y: Array, goals: Goals, radius: Array) -> tuple[Array, Array]:
    """Compute the goal probability within a radius of a place.

    Args:
        x: f32[], metres, map frame.
        y: f32[], metres.
        goals: weighed goals.
        radius: f32[], metres.

    Returns:
        f32[], the probability that the goal, or an object that fits as well, is there; and f32[],
        the same for the best confirmed object alone.
    """
    near = (goals.object_x - x) ** 2 + (goals.object_y - y) ** 2 <= radius * radius
    near_hypothesis = (goals.hypothesis_x - x) ** 2 + (goals.hypothesis_y - y) ** 2 <= (
        radius * radius
    )
    confirmed = jnp.max(jnp.where(near, goals.object_confirmed, 0.0))
    accepted = jnp.max(jnp.where(near, goals.object_accepted, 0.0))
    shared = jnp.sum(jnp.where(near, goals.object_mass, 0.0)) + jnp.sum(
        jnp.where(near_hypothesis, goals.hypothesis_mass, 0.0)
    )
    return jnp.maximum(accepted, shared), confirmed
