"""Unreferenced objects (bystanders): one shared list of objects of unmentioned types (ours).

The number of groundings of a relation is quadratic in the objects of a particle. So objects of
types that the task does not mention are stored in one list for all particles. If a later sentence
mentions their type, they are inserted into every particle (``exchange``); objects that are no
longer mentioned return to the list.

Limits: with capacity B = 0 the list is not used, and every object enters the particles.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.messages import NONE, Observation
from jaxlangnav.numerics.batching import append_axes, select_row
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.particle import SemanticMap, clear

_MAX_DEVIATIONS = 5.0  # standard deviations within which two sightings of one type are one object
_EXISTENCE = 0.95  # existence probability of an object inserted from the list


@pytree
class Bystanders:
    """Objects of unmentioned types, shared by all particles; B entries."""

    object_type: Array  # i32[B] type code, or index if detected here; NONE in empty entries
    x: Array  # f32[B] metres, map frame
    y: Array  # f32[B]
    variance: Array  # f32[B] m², both axes

    @property
    def is_filled(self) -> Array:
        """Which entries are filled, bool[B]."""
        return self.object_type != NONE


def no_bystanders(size: int) -> Bystanders:
    """Build an empty list with capacity for ``size`` objects."""
    zero = jnp.zeros(size, jnp.float32)
    return Bystanders(object_type=jnp.full(size, NONE, jnp.int32), x=zero, y=zero, variance=zero)


def is_named_type(object_type: Array, named: Array) -> Array:
    """Test which types i32[...] the task mentions, bool[...]; false for NONE."""
    label = label_of(object_type)
    return (label >= 0) & jnp.take(named, jnp.maximum(label, 0), mode="clip")


def split_by_type(observation: Observation, named: Array) -> tuple[Observation, Observation]:
    """Split detections into those of types that the task mentions, bool[T], and all others."""
    is_named = is_named_type(observation.detection_type, named)
    is_detection = observation.is_detection
    mentioned = replace(observation, is_detection=is_detection & is_named)
    return mentioned, replace(observation, is_detection=is_detection & ~is_named)


def add_bystanders(
    bystanders: Bystanders, observation: Observation, robot: tuple[Array, Array, Array]
) -> tuple[Bystanders, Array]:
    """Add detections to the list: update the position of a listed object, or add a new one.

    Args:
        bystanders: before the observation.
        observation: detections, after gating, of types not named.
        robot: f32[] each, x, y in metres, map frame, and the variance of either in m².

    Returns:
        The updated list, and i32[], the number of detections that did not fit.
    """
    bearing = observation.pose[2] + observation.detection_bearing
    noise = observation.sensor.noise
    sightings = Bystanders(
        object_type=jnp.where(observation.is_detection, observation.detection_type, NONE),
        x=robot[0] + observation.detection_range * jnp.cos(bearing),
        y=robot[1] + observation.detection_range * jnp.sin(bearing),
        variance=jnp.broadcast_to(noise * noise + robot[2] + 1e-4, bearing.shape),
    )
    bystanders, is_lost = jax.lax.scan(_add, bystanders, sightings)
    return bystanders, jnp.sum(is_lost)


def _add(listed: Bystanders, sighting: Bystanders) -> tuple[Bystanders, Array]:
    """Add one sighting, leaves [], if there is one; i32[], 1 if the list was full."""
    squared = (listed.x - sighting.x) ** 2 + (listed.y - sighting.y) ** 2
    is_near = squared <= _MAX_DEVIATIONS**2 * (listed.variance + sighting.variance)
    # A detection has no attributes, what comes from the particles may have some.
    old, new = listed.object_type, sighting.object_type
    is_candidate = ((old == new) | (label_of(old) == new) | (old == label_of(new))) & is_near
    nearest = jnp.argmin(jnp.where(is_candidate, squared, jnp.inf))
    free_slot = jnp.argmax(~listed.is_filled)
    is_listed, has_room = jnp.any(is_candidate), jnp.any(~listed.is_filled)
    is_target = jnp.arange(listed.x.shape[0]) == jnp.where(is_listed, nearest, free_slot)
    is_target = is_target & sighting.is_filled & (is_listed | has_room)
    gain = jnp.where(is_listed, listed.variance / (listed.variance + sighting.variance), 1.0)
    updated = Bystanders(
        object_type=jnp.where(is_target, jnp.maximum(old, new), old),
        x=jnp.where(is_target, listed.x + gain * (sighting.x - listed.x), listed.x),
        y=jnp.where(is_target, listed.y + gain * (sighting.y - listed.y), listed.y),
        variance=jnp.where(is_target, gain * sighting.variance, listed.variance),
    )
    return updated, (sighting.is_filled & ~is_listed & ~has_room).astype(jnp.int32)


_State = tuple[SemanticMap, Bystanders]


def exchange(
    particles: SemanticMap, listed: Bystanders, named: Array, log_weight: Array, is_new: Array
) -> tuple[SemanticMap, Bystanders]:
    """Exchange objects between particles and list after a new sentence.

    Objects in the particles that the task no longer mentions go to the list, as in the likeliest
    particle; listed ones that it mentions enter every particle, uncorrelated with the rest. The
    words are re-grounded afterwards, so no referent is a slot that has changed.

    Args:
        particles: leaves [..., P].
        listed: the list.
        named: bool[T], types that the task mentions.
        log_weight: f32[P].
        is_new: bool[], there is a new sentence that has not been grounded yet.
    """
    likeliest = jnp.argmax(log_weight)

    def list_slot(slot: Array, state: _State) -> _State:
        maps, listed = state
        leaves = maps.object_type, maps.mean_x, maps.mean_y, jnp.diagonal(maps.covariance).T
        object_type, x, y, variance = (select_row(leaf, slot)[likeliest] for leaf in leaves)
        object_type = jnp.where(is_named_type(object_type, named), NONE, object_type)
        sighting = Bystanders(object_type=object_type, x=x, y=y, variance=variance)
        return maps, _add(listed, sighting)[0]

    def clear_slots(_: Array, state: _State) -> _State:
        maps, listed = state
        return clear(maps, maps.is_observed & ~is_named_type(maps.object_type, named)), listed

    def insert_next(_: Array, state: _State) -> _State:
        maps, listed = state
        is_named = is_named_type(listed.object_type, named)
        chosen = jnp.argmax(is_named)
        is_possible = jnp.any(is_named) & jnp.any(maps.object_type == NONE)
        is_moved = (jnp.arange(listed.x.shape[0]) == chosen) & is_possible
        remaining = replace(listed, object_type=jnp.where(is_moved, NONE, listed.object_type))
        return _insert(maps, select_row(listed, chosen), is_possible), remaining

    # In most steps neither loop has an iteration.
    rounds = jnp.where(is_new, particles.object_type.shape[0], 0)
    state = jax.lax.fori_loop(0, rounds, list_slot, (particles, listed))
    state = jax.lax.fori_loop(0, jnp.where(is_new, 1, 0), clear_slots, state)
    rounds = jnp.where(is_new, jnp.sum(is_named_type(listed.object_type, named)), 0)
    return jax.lax.fori_loop(0, rounds, insert_next, state)


def _insert(particles: SemanticMap, sighting: Bystanders, is_possible: Array) -> SemanticMap:
    """Insert one listed object, leaves [], into the first free slot of every particle."""
    num_objects = particles.object_type.shape[0]
    slots = append_axes(jnp.arange(num_objects), particles.object_type.ndim)
    free_slot = jnp.min(jnp.where(particles.object_type == NONE, slots, num_objects), axis=0)
    is_slot = (slots == free_slot[None]) & is_possible
    is_entry = jnp.concatenate([is_slot, jnp.zeros_like(is_slot[:1])])
    is_diagonal = append_axes(jnp.eye(num_objects + 1, dtype=bool), particles.covariance.ndim)
    covariance = jnp.where(is_entry[:, None] | is_entry[None], 0.0, particles.covariance)
    existence = particles.existence
    return replace(
        particles,
        object_type=jnp.where(is_slot, sighting.object_type, particles.object_type),
        covariance=jnp.where(is_diagonal & is_entry[:, None], sighting.variance, covariance),
        mean_x=jnp.where(is_entry, sighting.x, particles.mean_x),
        mean_y=jnp.where(is_entry, sighting.y, particles.mean_y),
        existence=jnp.where(is_slot, _EXISTENCE, existence) if existence.shape[0] else existence,
    )
