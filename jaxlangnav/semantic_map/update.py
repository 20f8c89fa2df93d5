"""Kalman update on detections, and likelihood of missed objects (section 3.2, eq. 8).

Everything takes one particle, or all of them with the particle axis last ("…" in shapes).
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics import gaussian
from jaxlangnav.numerics.batching import lookup
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.association import Association
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.terrain import RANGING, SensorModel
from jaxlangnav.terrain.view import View, eye_of


def condition(
    particle: SemanticMap,
    association: Association,
    sensor: SensorParams,
    model: SensorModel = RANGING,
) -> SemanticMap:
    """Condition the Gaussian on the associated detections: exact, one scalar update for each.

        x_o = x_robot + z_o + N(0, R)   for a new object o, which has a flat prior,
        z_o = x_o − x_robot + N(0, R)   for one that is known

    Limits: R → ∞ leaves known objects unchanged; a first detection places the object at
    robot + offset.

    Args:
        particle: one particle.
        association: from ``associate``.
        sensor: the detector's specification.
        model: observation model.
    """
    num_objects = particle.object_type.shape[0]
    is_new = _append_robot(association.is_new)
    offset_x, offset_y = association.offset_x, association.offset_y
    variance = model.variance(offset_x, offset_y, sensor)
    variance = _append_robot(jnp.broadcast_to(variance, offset_x.shape))
    joint = gaussian.Moments(particle.covariance, particle.mean_x, particle.mean_y)
    joint = gaussian.add_coordinates(
        joint, num_objects, is_new, _append_robot(offset_x), _append_robot(offset_y), variance
    )
    offset_pairs, is_known = [(o, num_objects) for o in range(num_objects)], ~association.is_new
    joint = gaussian.condition_offsets(
        joint, offset_pairs, association.is_hit & is_known, offset_x, offset_y, variance
    )
    # A root of NONE is no slot: a hypothesis without an anchor does not move.
    shift_x = lookup((joint.mean_x - particle.mean_x)[:num_objects], particle.root)
    shift_y = lookup((joint.mean_y - particle.mean_y)[:num_objects], particle.root)
    return replace(
        particle,
        object_type=association.object_type,
        covariance=joint.covariance,
        mean_x=joint.mean_x,
        mean_y=joint.mean_y,
        existence=association.existence,
        hypothesis_x=particle.hypothesis_x + shift_x,
        hypothesis_y=particle.hypothesis_y + shift_y,
    )


def _append_robot(values: Array) -> Array:
    """Append a zero, or false, for the robot to values of the objects."""
    return jnp.concatenate([values, jnp.zeros_like(values[:1])])


def log_absence(
    particle: SemanticMap,
    is_hit: Array,
    heading: Array,
    softness: Array,
    sensor: SensorParams,
    view: View,
    model: SensorModel = RANGING,
) -> tuple[Array, Array, Array]:
    """Compute the likelihood of missed objects: negative information (eq. 8).

        Σ_o log(1 − p_d v_o r_o),   r' = r (1 − p_d v) / (1 − p_d v r)

    over the objects not detected, v the fraction in view and r the existence probability, 1 in
    particles without one.

    Args:
        particle: one particle, after conditioning.
        is_hit: bool[O, ...], detected objects.
        heading: f32[] or f32[1, ...], radians.
        softness: f32[], metres over which an object's position is uncertain.
        sensor: range, field of view, detection probability.
        view: lines of sight.
        model: observation model of the detector.

    Returns:
        f32[...] for observed objects, and f32[M, ...] for each hypothesis (0 where there is none);
        and the updated existence probabilities, as in the particle.
    """
    num_objects = particle.object_type.shape[0]
    x = jnp.concatenate([particle.mean_x[:num_objects], particle.hypothesis_x])
    y = jnp.concatenate([particle.mean_y[:num_objects], particle.hypothesis_y])
    robot_x, robot_y = particle.mean_x[num_objects:], particle.mean_y[num_objects:]
    eye = eye_of(robot_x, robot_y, heading, sensor)
    prob_detected = model.report_probability(view, eye, x, y, softness, sensor)
    is_missed = jnp.concatenate([particle.is_observed & ~is_hit, particle.is_hypothesised])
    existence = particle.existence
    if existence.shape[0]:
        prob = prob_detected[:num_objects]
        posterior = existence * (1.0 - prob) / (1.0 - prob * existence)
        prob_detected = jnp.concatenate([prob * existence, prob_detected[num_objects:]])
        existence = jnp.where(is_missed[:num_objects], posterior, existence)
    log_miss = jnp.where(is_missed, jnp.log1p(-prob_detected), 0.0)
    return jnp.sum(log_miss[:num_objects], axis=0), log_miss[num_objects:], existence
