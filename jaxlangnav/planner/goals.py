"""Goals of the behaviors, weighed over particles (first two sums of eq. 11).

Particles agree on observed objects and differ in their hypotheses, so the P × N goals of all
particles are gathered into one goal per observed object and one hypothesised goal per particle
before any distance is computed.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import AT, Behavior
from jaxlangnav.pytree import pytree
from jaxlangnav.relations import RelationModel, robot_frame, to_map, viewer_frame
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.particle import SemanticMap


@pytree
class Goals:
    """Where the robot may be asked to go, with probabilities over particles and behaviors."""

    object_x: Array  # f32[O + 1] metres, map frame: goal place at each observed object; robot last
    object_y: Array  # f32[O + 1]
    object_mass: Array  # f32[O + 1] probability that it is the goal
    object_accepted: Array  # f32[O + 1] probability that it fits as well as any other
    object_confirmed: Array  # f32[O + 1] … and that what it is placed against has been observed
    is_object: Array  # bool[O + 1]
    hypothesis_x: Array  # f32[P] metres: goal place of each particle's hypothesised goal
    hypothesis_y: Array  # f32[P]
    hypothesis_mass: Array  # f32[P]


def region_offset(
    relations: RelationModel,
    relation: Array,
    x: Array,
    y: Array,
    viewer: Array,
    is_robot: Array,
    metres: Array,
) -> tuple[Array, Array]:
    """Compute the place of a goal region relative to its object.

    Limits: without metres told it is the typical place of the relation.

    Args:
        relations: prepared relations.
        relation: i32[...], region index in [0, 7); AT is the object itself.
        x: f32[...], object, metres, map frame.
        y: f32[...], metres.
        viewer: f32[3], pose at the utterance.
        is_robot: bool[...], the object is the robot.
        metres: f32[], told from the object to the place; 0: none.
    """
    seen, own = viewer_frame(viewer[0], viewer[1], x, y), robot_frame(viewer[2])
    safe = jnp.minimum(relation, AT - 1)
    distance = jnp.where(metres > 0.0, metres, jnp.exp(relations.log_distance)[safe])
    along = distance * relations.axis_along[safe]
    lateral = distance * relations.axis_lateral[safe]
    # A region all round ("near") is entered from the viewer's side.
    is_ring = relations.concentration[safe] <= 0.0
    along = jnp.where(is_ring, -distance, along)
    lateral = jnp.where(is_ring, 0.0, lateral)
    seen_x, seen_y = to_map(seen, along, lateral)
    own_x, own_y = to_map(own, along, lateral)
    offset_x, offset_y = jnp.where(is_robot, own_x, seen_x), jnp.where(is_robot, own_y, seen_y)
    return jnp.where(relation == AT, 0.0, offset_x), jnp.where(relation == AT, 0.0, offset_y)


def reassign_distractor_mass(mass: Array, particles: SemanticMap) -> Array:
    """Give the goal mass on bystanders to what each particle's words refer to.

        m′_r = m_r + Σ_b min(m_b, m_r),    m′_b = m_b − min(m_b, m_r)

    The behavior model goes by what things are called, and shares the goal between all that bear the
    name. But a particle *is* a statement of what the words mean. So in each particle a bystander b,
    observed and not referred to, yields to the likeliest goal r among the referents, no more than r
    itself has: of "the other cone" the thing referred to is not the goal, and claims nothing.

    Limits: nothing referred to is a goal, nothing moves; the sum over slots stays the same.

    Args:
        mass: f32[N + 1, P] goal probability of each slot: observed, hypothesised, the robot.
        particles: leaves [..., P].
    """
    num_objects = particles.object_type.shape[0]
    slots = jnp.arange(num_objects)[:, None, None]
    is_meant = jnp.any(particles.referent[None] == slots, axis=1)  # [O, P]
    is_robot = jnp.zeros((1, is_meant.shape[1]), bool)
    is_referent = jnp.concatenate([is_meant, particles.is_hypothesised, is_robot])
    is_bystander = jnp.concatenate([~is_meant, jnp.zeros_like(is_referent[num_objects:])])
    own = jnp.where(is_referent, mass, 0.0)
    first = jnp.arange(mass.shape[0])[:, None] == jnp.argmax(own, axis=0)[None, :]
    claimed = jnp.where(is_bystander, jnp.minimum(mass, jnp.max(own, axis=0)[None, :]), 0.0)
    return mass - claimed + jnp.where(first, jnp.sum(claimed, axis=0)[None, :], 0.0)


def _fits(behavior: Behavior, particles: SemanticMap, weight: Array) -> Array:
    """Weigh how well each slot fits the sentence as its goal, f32[N + 1, P]."""
    fits = jnp.sum(behavior.goal, axis=0) * weight[None, :]
    if not particles.existence.shape[0]:
        return fits
    # The words say that what they refer to exists.
    real = jnp.where(particles.is_meant, 1.0, particles.existence)
    return fits * jnp.concatenate([real, jnp.ones_like(fits[real.shape[0] :])])


def gather(
    belief: ParticleBelief,
    behavior: Behavior,
    relations: RelationModel,
    has_open: Array,
    metres: Array,
) -> Goals:
    """Gather the goals of all particles.

    ``has_open``, bool[M, P], are the mentions tied to something not seen (``relevance``); metres,
    f32[], are told from a region's object to the goal place, 0 where none are.
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    num_objects = particles.object_type.shape[0]
    fits = _fits(behavior, particles, weight)
    mass = reassign_distractor_mass(fits, particles)
    # Where the likeliest region of each slot is entered.
    viewer = [jnp.broadcast_to(belief.viewer[axis], (1, weight.shape[0])) for axis in (0, 1)]
    x = jnp.concatenate([particles.mean_x[:num_objects], particles.hypothesis_x, viewer[0]])
    y = jnp.concatenate([particles.mean_y[:num_objects], particles.hypothesis_y, viewer[1]])
    region, last = jnp.argmax(behavior.goal, axis=0), x.shape[0] - 1
    is_robot = (jnp.arange(x.shape[0]) == last)[:, None]
    offset_x, offset_y = region_offset(relations, region, x, y, belief.viewer, is_robot, metres)
    x, y = x + offset_x, y + offset_y
    known = jnp.append(jnp.arange(num_objects), last)
    on_known, on_hypotheses = mass[known], mass[num_objects:-1]
    total = jnp.sum(on_known, axis=1)
    # Objects without goal mass keep their plain weighted mean as a place to go to.
    share = jnp.where(total[:, None] > 1e-6, on_known, weight[None, :])
    share = share / jnp.sum(share, axis=1, keepdims=True)
    # What fits, in its particle, as well as any other will do: of two hydrants alike either.
    best_fit = jnp.max(behavior.goal, axis=(0, 1))
    fit = fits[known] / jnp.maximum(weight * best_fit, 1e-9)[None, :]
    accepted = fit * (weight * jnp.minimum(jnp.sum(behavior.goal, axis=(0, 1)), 1.0))[None, :]
    # It is confirmed unless it is meant in relation to something not seen.
    slots = jnp.arange(num_objects + 1)[:, None, None]
    is_confirmed = ~jnp.any((particles.referent[None] == slots) & has_open[None], axis=1)
    best = jnp.argmax(on_hypotheses, axis=0)[None, :] == jnp.arange(on_hypotheses.shape[0])[:, None]
    is_seen = jnp.any(particles.is_observed & (weight > 0)[None, :], axis=1)
    return Goals(
        object_x=jnp.sum(share * x[known], axis=1),
        object_y=jnp.sum(share * y[known], axis=1),
        object_mass=total,
        object_accepted=jnp.sum(accepted, axis=1),
        object_confirmed=jnp.sum(accepted * is_confirmed, axis=1),
        is_object=jnp.append(is_seen, total[-1] > 1e-3),
        hypothesis_x=jnp.sum(jnp.where(best, x[num_objects:-1], 0.0), axis=0),
        hypothesis_y=jnp.sum(jnp.where(best, y[num_objects:-1], 0.0), axis=0),
        hypothesis_mass=jnp.sum(on_hypotheses, axis=0),
    )
