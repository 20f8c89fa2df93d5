"""Proposal and update for detections: which object is this? (section 3.2, eq. 7b).

Each detection is grounded in an existing object of its type or in a new one, drawn from the exact
conditional distribution, so that the weight is the predictive probability of the detections.

Everything takes one particle, or all of them with the particle axis last ("…" in shapes).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, SensorParams
from jaxlangnav.numerics import categorical, gaussian
from jaxlangnav.numerics.batching import column, pick
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.coverage import share_in_view
from jaxlangnav.semantic_map.particle import SemanticMap, positions

MIN_NOISE = 0.01
"""Metres; a sensor without noise is taken to be this good, so that no division is by zero."""
LOG_SURPRISE = -30.0
"""Least log-weight of a detection where nothing can be: surprised, never dead."""


class Detections(NamedTuple):
    """Detections of one observation in map axes, relative to the robot."""

    object_type: Array  # i32[D]
    offset_x: Array  # f32[D] metres, map axes
    offset_y: Array  # f32[D]
    log_new: Array  # f32[D] log density of a not yet seen object there, 1/m²
    is_detection: Array  # bool[D]


class Association(NamedTuple):
    """How one particle grounded the detections."""

    object_type: Array  # i32[O, ...] types, new objects entered
    is_hit: Array  # bool[O, ...] detected in this observation
    is_new: Array  # bool[O, ...] entered in this observation
    offset_x: Array  # f32[O, ...] measured offset where hit
    offset_y: Array  # f32[O, ...]
    log_weight: Array  # f32[...] log predictive probability
    overflow: Array  # i32[...] detections that found no free slot


def associate(
    particle: SemanticMap,
    detections: Detections,
    uniform: Array,
    noise_variance: Array,
    growth: Array | float = 0.0,
) -> Association:
    """Ground each detection in an existing object or in a new one (eq. 7b).

        p(z_j is o) ∝ N(z_j; x_o − x_robot, S_o),   p(z_j is new) ∝ λ m(z_j)

    with S from the joint covariance of robot and object, λ = α / A the density of objects not yet
    seen and m the probability of having missed one there. An object is detected at most once.

    Args:
        particle: one particle, after the motion.
        detections: f32[D] each.
        uniform: f32[D, ...], uniform draws in [0, 1).
        noise_variance: f32[], R, square metres per axis.
        growth: f32[], by how much more of λ each thing of the type that is held makes it (κ / α).

    Returns:
        The grounding and its weight.
    """
    num_objects = particle.object_type.shape[0]
    own = jnp.stack([particle.covariance[slot, slot] for slot in range(num_objects)])
    robot = particle.covariance[num_objects]
    spread = own + robot[num_objects:] - 2.0 * robot[:num_objects]
    spread = jnp.maximum(spread, 0.0) + noise_variance
    predicted_x = particle.mean_x[:num_objects] - particle.mean_x[num_objects:]
    predicted_y = particle.mean_y[:num_objects] - particle.mean_y[num_objects:]
    slots = column(jnp.arange(num_objects), particle.object_type.ndim)

    def ground(so_far: Association, one: tuple[Detections, Array]) -> tuple[Association, None]:
        """Ground one detection, given how those before it are grounded."""
        (z_type, z_x, z_y, log_new, present), chance = one
        object_type, is_hit, is_new, offset_x, offset_y, log_weight, overflow = so_far
        log_existing = gaussian.log_normal_isotropic(z_x - predicted_x, z_y - predicted_y, spread)
        may_be = (object_type == z_type) & ~is_hit
        number = jnp.sum(object_type == z_type, axis=0)
        log_new = (log_new + jnp.log1p(growth * number))[None]
        choices = jnp.concatenate([jnp.where(may_be, log_existing, -jnp.inf), log_new])
        choice, log_total = categorical.draw(choices, chance)
        free = jnp.min(jnp.where(object_type == NONE, slots, num_objects), axis=0)
        wants_new = choice == num_objects
        slot = jnp.where(wants_new, free, choice)
        entry = (slots == slot[None]) & present
        return Association(
            object_type=jnp.where(entry, z_type, object_type),
            is_hit=is_hit | entry,
            is_new=is_new | (entry & wants_new[None]),
            offset_x=jnp.where(entry, z_x, offset_x),
            offset_y=jnp.where(entry, z_y, offset_y),
            log_weight=log_weight + jnp.where(present, log_total, 0.0),
            overflow=overflow + (present & (slot == num_objects)).astype(jnp.int32),
        ), None

    nobody, nowhere = jnp.zeros(predicted_x.shape, bool), jnp.zeros_like(predicted_x)
    before = Association(
        object_type=particle.object_type,
        is_hit=nobody,
        is_new=nobody,
        offset_x=nowhere,
        offset_y=nowhere,
        log_weight=nowhere[0],
        overflow=jnp.zeros(nowhere.shape[1:], jnp.int32),
    )
    return jax.lax.scan(ground, before, (detections, uniform))[0]


def condition(
    particle: SemanticMap, association: Association, noise_variance: Array
) -> SemanticMap:
    """Condition the Gaussian on the grounded detections: exact, one scalar update for each.

        x_o = x_robot + z_o + N(0, R)   for a new object o, which has a flat prior,
        z_o = x_o − x_robot + N(0, R)   for one that is known

    Limits: R → ∞ leaves known objects unchanged; a first detection places the object at
    robot + offset.

    Args:
        particle: one particle.
        association: from ``associate``.
        noise_variance: f32[], R, square metres per axis.

    Returns:
        The particle with new objects entered and the rest corrected.
    """
    num_objects, ndim = particle.object_type.shape[0], particle.object_type.ndim
    is_new = _with_robot(association.is_new)
    offset_x, offset_y = association.offset_x, association.offset_y
    variance = column(jnp.broadcast_to(noise_variance, (num_objects + 1,)), ndim)
    joint = gaussian.Moments(particle.covariance, particle.mean_x, particle.mean_y)
    joint = gaussian.enter(
        joint, num_objects, is_new, _with_robot(offset_x), _with_robot(offset_y), variance
    )
    joint = gaussian.condition(
        joint,
        [(slot, num_objects) for slot in range(num_objects)],
        association.is_hit & ~association.is_new,
        offset_x,
        offset_y,
        variance,
    )
    # A root of NONE is no slot: a hypothesis on the ground does not move.
    moved_x, moved_y = (
        pick((after - before)[:num_objects], particle.root)
        for after, before in ((joint.mean_x, particle.mean_x), (joint.mean_y, particle.mean_y))
    )
    return replace(
        particle,
        object_type=association.object_type,
        covariance=joint.covariance,
        mean_x=joint.mean_x,
        mean_y=joint.mean_y,
        hypothesis_x=particle.hypothesis_x + moved_x,
        hypothesis_y=particle.hypothesis_y + moved_y,
    )


def _with_robot(values: Array) -> Array:
    """Append a zero, or false, for the robot to what is known of the objects."""
    return jnp.concatenate([values, jnp.zeros_like(values[:1])])


def log_absence(
    particle: SemanticMap,
    is_hit: Array,
    heading: Array,
    softness: Array,
    sensor: SensorParams,
) -> tuple[Array, Array]:
    """Weigh what was not seen: negative observations (eq. 8).

        Σ_o log(1 − p_d v_o)   over the objects not detected, v the share in view

    Args:
        particle: one particle, after conditioning.
        is_hit: bool[O, ...], detected objects.
        heading: f32[], radians.
        softness: f32[], metres over which an object's position is uncertain.
        sensor: range, field of view, detection probability.

    Returns:
        f32[...] for observed objects, and f32[M, ...] for each hypothesis (0 where there is none).
    """
    num_objects = particle.object_type.shape[0]
    x, y = positions(particle)
    in_view = share_in_view(
        x - particle.mean_x[num_objects:],
        y - particle.mean_y[num_objects:],
        heading,
        softness,
        sensor,
    )
    probability = jnp.minimum(sensor.detection_probability, 0.999)
    is_missed = jnp.concatenate([particle.is_observed & ~is_hit, particle.is_hypothesised])
    log_missed = jnp.where(is_missed, jnp.log1p(-probability * in_view), 0.0)
    return jnp.sum(log_missed[:num_objects], axis=0), log_missed[num_objects:]
