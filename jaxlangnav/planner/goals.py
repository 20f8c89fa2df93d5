"""Goal distribution, marginalised over particles and behaviors (first two sums of eq. 11).

Particles agree on observed objects and differ in their hypotheses, so the P × N goals of all
particles are reduced to one goal per observed object and one hypothesised goal per particle
before any distance is computed.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import AT, Behavior
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import RelationModel, robot_frame, to_map, viewer_frame
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.terrain import Eye, View

MIN_GOAL_PROB = 0.01
"""Minimum probability of an object to be a goal, that is to end a search or to allow a stop."""


@pytree
class Goals:
    """Goal positions with their probabilities over particles and behaviors."""

    object_x: Array  # f32[O + 1] metres, map frame: goal at each observed object; robot last
    object_y: Array  # f32[O + 1]
    object_mass: Array  # f32[O + 1] probability that it is the goal
    object_accepted: Array  # f32[O + 1] probability that it fits as well as any other
    object_confirmed: Array  # f32[O + 1] … and that its landmarks have been observed
    is_object: Array  # bool[O + 1] valid entry: an observed object; the robot if it may be the goal
    hypothesis_x: Array  # f32[P] metres: position of each particle's hypothesised goal
    hypothesis_y: Array  # f32[P]
    hypothesis_mass: Array  # f32[P] probability that it is the goal


def region_offset(
    relations: RelationModel,
    relation: Array,
    x: Array,
    y: Array,
    viewer: Array,
    is_robot: Array,
    metres: Array,
) -> tuple[Array, Array]:
    """Compute the position of a goal region relative to its object.

    Limits: without a stated distance it is the median distance of the relation.

    Args:
        relations: prepared relations.
        relation: i32[...], region index in [0, 7); AT is the object itself.
        x: f32[...], object, metres, map frame.
        y: f32[...], metres.
        viewer: f32[3], pose at the utterance.
        is_robot: bool[...], the object is the robot.
        metres: f32[], stated distance from the object; 0: none.
    """
    viewer_axes, robot_axes = viewer_frame(viewer[0], viewer[1], x, y), robot_frame(viewer[2])
    row = jnp.minimum(relation, AT - 1)
    distance = jnp.where(metres > 0.0, metres, jnp.exp(relations.log_distance)[row])
    along = distance * relations.axis_along[row]
    lateral = distance * relations.axis_lateral[row]
    # An annular region ("near") is entered from the viewer's side.
    is_ring = relations.concentration[row] <= 0.0
    along = jnp.where(is_ring, -distance, along)
    lateral = jnp.where(is_ring, 0.0, lateral)
    view_x, view_y = to_map(viewer_axes, along, lateral)
    body_x, body_y = to_map(robot_axes, along, lateral)
    offset_x, offset_y = (jnp.where(is_robot, body_x, view_x), jnp.where(is_robot, body_y, view_y))
    return jnp.where(relation == AT, 0.0, offset_x), jnp.where(relation == AT, 0.0, offset_y)


def reassign_distractor_mass(mass: Array, particles: SemanticMap) -> Array:
    """Move goal mass from distractors to each particle's referent.

        m′_r = m_r + Σ_b min(m_b, m_r),    m′_b = m_b − min(m_b, m_r)

    The behavior model sees types only, and distributes the goal over all objects of the type. But
    each particle asserts what the words refer to. So in each particle a distractor b, observed and
    not a referent, gives mass to the likeliest goal r among the referents, at most as much as r
    has: for "the other cone" the cone referred to is not the goal, and gets nothing.

    Limits: if no referent is a goal, nothing moves; the sum over slots stays the same.

    Args:
        mass: f32[N + 1, P] goal probability of each slot: observed, hypothesised, the robot.
        particles: leaves [..., P].
    """
    num_objects = particles.object_type.shape[0]
    slots = jnp.arange(num_objects)[:, None, None]
    is_meant = jnp.any(particles.referent[None] == slots, axis=1)  # [O, P]
    is_robot = jnp.zeros((1, is_meant.shape[1]), bool)
    is_referent = jnp.concatenate([is_meant, particles.is_hypothesised, is_robot])
    is_distractor = jnp.concatenate([~is_meant, jnp.zeros_like(is_referent[num_objects:])])
    goal_mass = jnp.where(is_referent, mass, 0.0)
    is_best = jnp.arange(mass.shape[0])[:, None] == jnp.argmax(goal_mass, axis=0)[None, :]
    moved = jnp.where(is_distractor, jnp.minimum(mass, jnp.max(goal_mass, axis=0)[None, :]), 0.0)
    return mass - moved + jnp.where(is_best, jnp.sum(moved, axis=0)[None, :], 0.0)


def _fit_weights(behavior: Behavior, particles: SemanticMap, weight: Array) -> Array:
    """Compute the weight of each slot as the goal of the sentence, f32[N + 1, P]."""
    weights = jnp.sum(behavior.goal, axis=0) * weight[None, :]
    if not particles.existence.shape[0]:
        return weights
    # The words imply that their referents exist.
    existence = jnp.where(particles.is_referent, 1.0, particles.existence)
    return weights * jnp.concatenate([existence, jnp.ones_like(weights[existence.shape[0] :])])


def gather(
    belief: ParticleBelief,
    behavior: Behavior,
    relations: RelationModel,
    has_unseen: Array,
    metres: Array,
) -> Goals:
    """Compute the goal distribution over all particles.

    ``has_unseen``, bool[M, P], marks mentions related to an unseen object (``relevance``); metres,
    f32[], is the stated distance from a region's object to the goal, 0 if none.
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    num_objects = particles.object_type.shape[0]
    weights = _fit_weights(behavior, particles, weight)
    mass = reassign_distractor_mass(weights, particles)
    # Entry point of the likeliest region of each slot.
    viewer = [jnp.broadcast_to(belief.viewer[axis], (1, weight.shape[0])) for axis in (0, 1)]
    x = jnp.concatenate([particles.mean_x[:num_objects], particles.hypothesis_x, viewer[0]])
    y = jnp.concatenate([particles.mean_y[:num_objects], particles.hypothesis_y, viewer[1]])
    region, robot_slot = jnp.argmax(behavior.goal, axis=0), x.shape[0] - 1
    is_robot = (jnp.arange(x.shape[0]) == robot_slot)[:, None]
    offset_x, offset_y = region_offset(relations, region, x, y, belief.viewer, is_robot, metres)
    x, y = x + offset_x, y + offset_y
    idx = jnp.append(jnp.arange(num_objects), robot_slot)  # observed slots and the robot
    slot_mass, hypo_mass = mass[idx], mass[num_objects:-1]
    total = jnp.sum(slot_mass, axis=1)
    # Objects without goal mass have their weighted mean position as goal position.
    frac = jnp.where(total[:, None] > 1e-6, slot_mass, weight[None, :])
    frac = frac / jnp.sum(frac, axis=1, keepdims=True)
    # An object that fits, in its particle, as well as any other is accepted: either of two equals.
    fit = weights[idx] / jnp.maximum(weight * jnp.max(behavior.goal, axis=(0, 1)), 1e-9)[None, :]
    accepted = fit * (weight * jnp.minimum(jnp.sum(behavior.goal, axis=(0, 1)), 1.0))[None, :]
    # It is confirmed unless a mention of it is related to an unseen object.
    slots = jnp.arange(num_objects + 1)[:, None, None]
    is_confirmed = ~jnp.any((particles.referent[None] == slots) & has_unseen[None], axis=1)
    is_best = jnp.argmax(hypo_mass, axis=0)[None, :] == jnp.arange(hypo_mass.shape[0])[:, None]
    is_observed = jnp.any(particles.is_observed & (weight > 0)[None, :], axis=1)
    return Goals(
        object_x=jnp.sum(frac * x[idx], axis=1),
        object_y=jnp.sum(frac * y[idx], axis=1),
        object_mass=total,
        object_accepted=jnp.sum(accepted, axis=1),
        object_confirmed=jnp.sum(accepted * is_confirmed, axis=1),
        is_object=jnp.append(is_observed, total[-1] > 1e-3),
        hypothesis_x=jnp.sum(jnp.where(is_best, x[num_objects:-1], 0.0), axis=0),
        hypothesis_y=jnp.sum(jnp.where(is_best, y[num_objects:-1], 0.0), axis=0),
        hypothesis_mass=jnp.sum(hypo_mass, axis=0),
    )


def has_goal(goals: Goals, x: Array, y: Array, radius: Array, view: View) -> Array:
    """Test whether an observed object that may be the goal is near and in view, bool[]."""
    is_near = view.sees(Eye(x, y, radius), goals.object_x, goals.object_y)
    accepted = jnp.where(is_near, goals.object_accepted, 0.0)
    return jnp.any(goals.is_object & jnp.isfinite(accepted) & (accepted >= MIN_GOAL_PROB))
