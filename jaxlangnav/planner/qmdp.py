"""QMDP values of candidate waypoints (section 3.4, eq. 11 and 12)."""

import chex
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.goals import Goals
from jaxlangnav.terrain import OPEN, Eye, Travel, View


def values(
    node_x: Array, node_y: Array, goals: Goals, discount: Array, travel: Travel = OPEN.travel
) -> Array:
    """Compute the QMDP value, expected and discounted, of each node, f32[A].

        V(a) = Σ_i Σ_j γ^{d(a, g_ij)} p(β_j | S_i) p(S_i)      (eq. 11, 12)

    Limits: γ → 1 gives the total goal mass everywhere; a node on the only goal has value 1.

    Args:
        node_x: f32[A], metres, map frame.
        node_y: f32[A], metres.
        goals: goal distribution.
        discount: f32[], γ per metre, in (0, 1).
        travel: travel distances d.
    """
    chex.assert_rank([node_x, node_y, discount], [1, 1, 0])
    chex.assert_equal_shape([goals.object_x, goals.object_y, goals.object_mass])
    chex.assert_equal_shape([goals.hypothesis_x, goals.hypothesis_y, goals.hypothesis_mass])
    x = jnp.concatenate([goals.object_x, goals.hypothesis_x])
    y = jnp.concatenate([goals.object_y, goals.hypothesis_y])
    mass = jnp.concatenate([goals.object_mass, goals.hypothesis_mass])
    distance = travel.metres(node_x[:, None], node_y[:, None], x[None, :], y[None, :])
    return jnp.sum(mass[None, :] * jnp.exp(jnp.log(discount) * distance), axis=1)


def mass_within(
    x: Array, y: Array, goals: Goals, radius: Array, view: View = OPEN.view
) -> tuple[Array, Array]:
    """Compute the goal probability within a radius of a position, with a line of sight.

    f32[], the probability that the goal, or an object that fits as well, is there; and f32[], the
    same for the best confirmed object alone. An object behind a wall does not count.
    """
    eye = Eye(x, y, radius)
    is_near = view.sees(eye, goals.object_x, goals.object_y)
    is_near_hypothesis = view.sees(eye, goals.hypothesis_x, goals.hypothesis_y)
    confirmed = jnp.max(jnp.where(is_near, goals.object_confirmed, 0.0))
    accepted = jnp.max(jnp.where(is_near, goals.object_accepted, 0.0))
    total = jnp.sum(jnp.where(is_near, goals.object_mass, 0.0))
    total = total + jnp.sum(jnp.where(is_near_hypothesis, goals.hypothesis_mass, 0.0))
    return jnp.maximum(accepted, total), confirmed
