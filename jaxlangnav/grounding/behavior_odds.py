"""Log-odds of behavior symbols in the particles (eq. 4, section 3.3), given the children's sets.

The device version of ``behavior_properties``: leaves of a clause are [..., E, 1], those of worlds
[..., E, P]; episodes and particles are lanes. A ``phrase`` is one of a clause: its fields have lost
their first axis.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.program import LOG_NEVER, CompiledClause
from jaxlangnav.inputs.object_types import is_type, label_of
from jaxlangnav.messages import NONE, ROBOT, BehaviorWorld
from jaxlangnav.numerics.batching import lookup


class ObjectSets(NamedTuple):
    """Sets of each particle's objects as bit masks."""

    object_type: Array  # i32[N, E, P]
    previous: Array  # i32[3, E, P] the previous goal; others of its type; those of other types
    robot: Array  # i32[E, P]
    all_objects: Array  # i32[E, P]
    in_region: Array  # i32[T, N, E, P] objects in the region, by the clause's tables and landmark


class Combinations(NamedTuple):
    """Four best combinations of the child hypotheses of a phrase."""

    sets: Array  # i32[4, 5 + L, E, P], united where children are combined: the children's objects;
    # objects of any child symbol; the children's constraints; objects that are in no region of some
    # restricting child; the children's regions in the phrase's own slots, and in the relation of
    # the constraint slot
    cost: Array  # f32[4, E, P]


_OBJECTS, _MENTIONED, _CONSTRAINTS, _EXCLUDED, _SLOTS, _AVOIDED = 0, 1, 2, 3, slice(4, -1), -1
"""Indices into ``Combinations.sets``."""


def build_object_sets(clause: CompiledClause, world: BehaviorWorld) -> ObjectSets:
    """Encode worlds as bit masks; leaves of the world are [..., E, P]."""
    is_object, object_type = world.is_object, world.object_type
    bits = jnp.where(is_object, _bit_of_each(object_type.shape[0], 3), 0)
    all_objects = jnp.sum(bits, axis=0)
    edges = jnp.concatenate([world.is_related, world.is_superlative, world.is_ordinal])
    figures = jnp.sum(jnp.where(edges, bits[None, :, None], 0), axis=1)
    figures = jnp.append(figures, bits[None], axis=0)  # [18 + 1, N, E, P]: the last table is "at"
    previous = world.is_previous & is_object
    last_type = jnp.max(jnp.where(previous, object_type, NONE - 9), axis=0)
    same_type = (label_of(object_type) == label_of(last_type)[None]) & is_object
    is_robot = (object_type == ROBOT) & is_object
    goal, others, robot = to_mask(jnp.stack([previous, same_type & ~previous, is_robot]))
    rest = jnp.where(goal != 0, all_objects & ~(goal | others), 0)
    return ObjectSets(
        object_type=object_type,
        previous=jnp.stack([goal, others, rest]),
        robot=robot,
        all_objects=all_objects,
        in_region=lookup(figures, _per_object(clause.table, is_object)),
    )


def _per_object(index: Array, objects: Array) -> Array:
    """Broadcast indices over objects: i32[n, E, 1] to i32[n, N, E, P]."""
    return jnp.broadcast_to(index[:, None], (index.shape[0], *objects.shape))


def _named(phrase: CompiledClause, scene: ObjectSets) -> Array:
    """Find the objects of the types that the words name, i32[E, P]."""
    named = is_type(scene.object_type[None], phrase.named_types[:, None])  # [W, N, E, P]
    return to_mask(functools.reduce(jnp.logical_or, named)) & scene.all_objects


def object_odds(phrase: CompiledClause, scene: ObjectSets, given: Combinations, size: int) -> Array:
    """Evaluate the log-odds of the objects, f32[4, N, E, P]."""
    named_mask = _named(phrase, scene)
    is_named, terms = _is_in(named_mask, size), phrase.objects
    always, named, unnamed, child, located, elsewhere, no_child, named_located, *earlier = terms
    base = jnp.where(is_named, always + named, always + unnamed)
    base = base + jnp.where(_is_in(named_mask & scene.previous[0], size), earlier[0], 0.0)
    for n in range(3):
        base = base + jnp.where(_is_in(scene.previous[n], size), earlier[1 + n], 0.0)
    base = base + jnp.where(scene.previous[0] == 0, earlier[4], 0.0)[None]
    base = jnp.where(_is_in(scene.all_objects, size), base, LOG_NEVER)
    objects, excluded = given.sets[:, _OBJECTS], given.sets[:, _EXCLUDED]
    in_child, is_located = _is_in(objects, size), ~_is_in(excluded, size)
    child_odds = child + jnp.where(is_located, located, elsewhere)
    named_odds = jnp.where(is_named[None] & is_located, named_located, 0.0)
    return base[None] + named_odds + jnp.where(in_child, child_odds, no_child)


def region_odds(phrase: CompiledClause, scene: ObjectSets, given: Combinations, size: int) -> Array:
    """Evaluate the log-odds of the regions (goals of a verb phrase), f32[4, L, N, E, P]."""
    in_child = _is_in(given.sets[:, _OBJECTS], size)[:, None]
    region_in_child = _is_in(given.sets[:, _SLOTS], size)
    base, child, child_region, neither, named, robot = phrase.regions[:, :, None]
    base = base + jnp.where(_is_in(_named(phrase, scene), size), named, 0.0)
    base = base + jnp.where(_is_in(scene.robot, size), robot, 0.0)
    base = jnp.where(_is_in(scene.all_objects, size), base, LOG_NEVER)
    return (
        base[None]
        + jnp.where(in_child, child, 0.0)
        + jnp.where(region_in_child, child_region, 0.0)
        + jnp.where(in_child | region_in_child, 0.0, neither)
    )


def constraint_odds(
    phrase: CompiledClause, scene: ObjectSets, given: Combinations, size: int
) -> Array:
    """Evaluate the log-odds of the constraints, f32[4, N, E, P], of the phrase's one relation."""
    base, child_region, child, mention, no_mention, repeated, first = phrase.constraints
    base = jnp.where(_is_in(scene.all_objects, size), base, LOG_NEVER)
    in_child, is_mentioned, is_repeated, region_in_child = (
        _is_in(given.sets[:, i], size) for i in (_OBJECTS, _MENTIONED, _CONSTRAINTS, _AVOIDED)
    )
    return (
        base[None]
        + jnp.where(region_in_child, child_region, 0.0)
        + jnp.where(in_child, child, 0.0)
        + jnp.where(is_mentioned, mention + jnp.where(is_repeated, 0.0, first), no_mention)
        + jnp.where(is_repeated, repeated, 0.0)
    )


def objects_in(phrase: CompiledClause, scene: ObjectSets, regions: Array) -> Array:
    """Find the objects in the expressed regions, i32[4, L, E, P] to i32[4, E, P]."""
    table = lookup(scene.in_region, _per_object(phrase.region_table, scene.in_region[0]))
    is_region = _is_in(regions, scene.in_region.shape[1])  # [4, L, N, E, P]
    return jax.lax.reduce_or(jnp.where(is_region, table[None], 0), axes=(1, 2))


# ---------------------------------------------------------------- sets of objects as bit masks
# Two lane axes stand last, episodes E and particles P; N is the axis before them.


def iota(size: int, ndim: int) -> np.ndarray:
    """Build indices along the axis before the two lane axes, i32[1, ..., size, 1, 1], static."""
    return np.arange(size, dtype=np.int32).reshape(*(1,) * (ndim - 3), size, 1, 1)


def _bit_of_each(size: int, ndim: int) -> np.ndarray:
    """Build the bit of each object along that axis, i32[1, ..., size ≤ 31, 1, 1]."""
    return np.left_shift(np.int32(1), iota(size, ndim))


def _is_in(mask: Array, size: int) -> Array:
    """Unpack bit masks i32[..., E, P] to bool[..., size, E, P]."""
    return (mask[..., None, :, :] & _bit_of_each(size, mask.ndim + 1)) != 0


def to_mask(flags: Array) -> Array:
    """Pack bool[..., N, E, P] into bit masks i32[..., E, P]."""
    return jnp.sum(jnp.where(flags, _bit_of_each(flags.shape[-3], flags.ndim), 0), axis=-3)


def smallest_with_index(cost: Array, count: int) -> tuple[list[Array], list[Array]]:
    """Find the ``count`` smallest nonnegative costs f32[..., n ≤ 128, E, P] and their indices.

    The index replaces the lowest bits of the float, so that one minimum yields both and equal costs
    stay apart; costs are rounded down by them, at n = 128 by less than 2e-5 of their value.
    """
    size = cost.shape[-3]
    low = (1 << (size - 1).bit_length()) - 1
    packed = (jax.lax.bitcast_convert_type(cost, jnp.int32) & ~low) | iota(size, cost.ndim)
    lowest = jnp.min(packed, axis=-3)
    minima = [lowest]
    for _ in range(count - 1):
        rest = jnp.where(packed > lowest[..., None, :, :], packed, jnp.iinfo(jnp.int32).max)
        lowest = jnp.min(rest, axis=-3)
        minima.append(lowest)
    values = [jax.lax.bitcast_convert_type(value & ~low, jnp.float32) for value in minima]
    return values, [value & low for value in minima]


def take_of_beam(values: Array, index: Array) -> Array:
    """Gather from a beam of 4: i32[4, ..., E, P] at i32[m, ..., E, P] → i32[m, ..., E, P]."""
    odd = (index & 1) == 1
    low_part = jnp.where(odd, values[1:2], values[0:1])
    return jnp.where(index >= 2, jnp.where(odd, values[3:4], values[2:3]), low_part)
