"""Unreferenced objects: one shared map of things that no utterance has mentioned yet (ours).

The ways to ground a relation grow with the square of the things that a particle holds. So things of
types that the task does not name are kept in one list for all particles. Where a later sentence
names their type they are entered into every particle (``exchange``), and what it speaks of no more
goes back to the list.

Limits: a list of no room (B = 0) is never looked at, and everything seen enters the particles.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.messages import NONE, Observation
from jaxlangnav.numerics.batching import append_axes, select_row
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.particle import SemanticMap, clear

_DEVIATIONS = 5.0  # standard deviations within which two sightings of one type are of one thing
_REMEMBERED = 0.95  # probability that what the list holds exists, where that is in doubt


@pytree
class Bystanders:
    """Sightings of things of types not spoken of, the same for all particles; B places."""

    object_type: Array  # i32[B] type index; NONE in empty places
    x: Array  # f32[B] metres, map frame
    y: Array  # f32[B]
    variance: Array  # f32[B] m², both axes

    @property
    def is_held(self) -> Array:
        """Which places are filled, bool[B]."""
        return self.object_type != NONE


def no_bystanders(number: int) -> Bystanders:
    """Build an empty list with room for ``number`` things."""
    zero = jnp.zeros(number, jnp.float32)
    return Bystanders(object_type=jnp.full(number, NONE, jnp.int32), x=zero, y=zero, variance=zero)


def is_named_type(object_type: Array, spoken: Array) -> Array:
    """Tell of which types i32[...] the task speaks, bool[...]; of nothing it does not."""
    label = label_of(object_type)
    return (label >= 0) & jnp.take(spoken, jnp.maximum(label, 0), mode="clip")


def split_by_type(observation: Observation, spoken: Array) -> tuple[Observation, Observation]:
    """Part what is seen into what the task speaks of, bool[T], and all else."""
    is_of_task = is_named_type(observation.detection_type, spoken)
    seen = observation.is_detection
    ours = replace(observation, is_detection=seen & is_of_task)
    return ours, replace(observation, is_detection=seen & ~is_of_task)


def add_bystanders(
    known: Bystanders, observation: Observation, robot: tuple[Array, Array, Array]
) -> tuple[Bystanders, Array]:
    """Enter what is seen: a thing that is known is placed better, another one is added.

    Args:
        known: before the look.
        observation: detections, all of them sound and of types not spoken of.
        robot: f32[] each, x, y in metres, map frame, and the variance of either in m².

    Returns:
        The list after the look, and i32[], how many found no room.
    """
    bearing = observation.pose[2] + observation.detection_bearing
    noise = observation.sensor.noise
    seen = Bystanders(
        object_type=jnp.where(observation.is_detection, observation.detection_type, NONE),
        x=robot[0] + observation.detection_range * jnp.cos(bearing),
        y=robot[1] + observation.detection_range * jnp.sin(bearing),
        variance=jnp.broadcast_to(noise * noise + robot[2] + 1e-4, bearing.shape),
    )
    known, lost = jax.lax.scan(_enter, known, seen)
    return known, jnp.sum(lost)


def _enter(known: Bystanders, seen: Bystanders) -> tuple[Bystanders, Array]:
    """Enter one thing seen, leaves [], if it is one; i32[] tells whether it found no room."""
    squared = (known.x - seen.x) ** 2 + (known.y - seen.y) ** 2
    is_near = squared <= _DEVIATIONS**2 * (known.variance + seen.variance)
    may_be = (known.object_type == seen.object_type) & is_near
    places = jnp.arange(known.x.shape[0])
    nearest = jnp.argmin(jnp.where(may_be, squared, jnp.inf))
    free = jnp.argmax(~known.is_held)
    is_known, has_room = jnp.any(may_be), jnp.any(~known.is_held)
    here = places == jnp.where(is_known, nearest, free)
    here = here & seen.is_held & (is_known | has_room)
    gain = jnp.where(is_known, known.variance / (known.variance + seen.variance), 1.0)
    after = Bystanders(
        object_type=jnp.where(here, seen.object_type, known.object_type),
        x=jnp.where(here, known.x + gain * (seen.x - known.x), known.x),
        y=jnp.where(here, known.y + gain * (seen.y - known.y), known.y),
        variance=jnp.where(here, gain * seen.variance, known.variance),
    )
    return after, (seen.is_held & ~is_known & ~has_room).astype(jnp.int32)


_Both = tuple[SemanticMap, Bystanders]


def exchange(
    particles: SemanticMap, known: Bystanders, spoken: Array, log_weight: Array, is_told: Array
) -> tuple[SemanticMap, Bystanders]:
    """Exchange things between particles and list, where another sentence has been heard.

    What particles hold and the task speaks of no more goes to the list, as the likeliest of them
    has it; what the list holds and it speaks of enters every particle, as known by itself. The
    words are grounded anew afterwards, so nothing refers to a slot that has changed.

    Args:
        particles: leaves [..., P].
        known: the list.
        spoken: bool[T], types that the task speaks of.
        log_weight: f32[P].
        is_told: bool[], a sentence has been heard that nothing has been grounded of.
    """
    num_objects = particles.object_type.shape[0]
    likeliest = jnp.argmax(log_weight)

    def put_aside(slot: Array, both: _Both) -> _Both:
        held, known = both
        leaves = held.object_type, held.mean_x, held.mean_y, jnp.diagonal(held.covariance).T
        kind, x, y, spread = (select_row(one, slot)[likeliest] for one in leaves)
        kind = jnp.where(is_named_type(kind, spoken), NONE, kind)
        thing = Bystanders(object_type=kind, x=x, y=y, variance=spread)
        return held, _enter(known, thing)[0]

    def put_away(_: Array, both: _Both) -> _Both:
        held, known = both
        return clear(held, held.is_observed & ~is_named_type(held.object_type, spoken)), known

    def bring_in(_: Array, both: _Both) -> _Both:
        held, known = both
        is_meant = is_named_type(known.object_type, spoken)
        chosen = jnp.argmax(is_meant)
        is_there = jnp.any(is_meant) & jnp.any(held.object_type == NONE)
        is_taken = (jnp.arange(known.x.shape[0]) == chosen) & is_there
        left = replace(known, object_type=jnp.where(is_taken, NONE, known.object_type))
        return _hold(held, select_row(known, chosen), is_there), left

    # Nearly always no round of either loop.
    rounds = jnp.where(is_told, num_objects, 0)
    both = jax.lax.fori_loop(0, rounds, put_aside, (particles, known))
    both = jax.lax.fori_loop(0, jnp.where(is_told, 1, 0), put_away, both)
    rounds = jnp.where(is_told, jnp.sum(is_named_type(known.object_type, spoken)), 0)
    return jax.lax.fori_loop(0, rounds, bring_in, both)


def _hold(particles: SemanticMap, thing: Bystanders, is_there: Array) -> SemanticMap:
    """Enter one thing of the list, leaves [], into the first free slot of every particle."""
    num_objects = particles.object_type.shape[0]
    slots = append_axes(jnp.arange(num_objects), particles.object_type.ndim)
    free = jnp.min(jnp.where(particles.object_type == NONE, slots, num_objects), axis=0)
    is_slot = (slots == free[None]) & is_there
    here = jnp.concatenate([is_slot, jnp.zeros_like(is_slot[:1])])
    own = append_axes(jnp.eye(num_objects + 1, dtype=bool), particles.covariance.ndim)
    covariance = jnp.where(here[:, None] | here[None], 0.0, particles.covariance)
    existence = particles.existence
    return replace(
        particles,
        object_type=jnp.where(is_slot, thing.object_type, particles.object_type),
        covariance=jnp.where(own & here[:, None], thing.variance, covariance),
        mean_x=jnp.where(here, thing.x, particles.mean_x),
        mean_y=jnp.where(here, thing.y, particles.mean_y),
        existence=jnp.where(is_slot, _REMEMBERED, existence) if existence.shape[0] else existence,
    )
