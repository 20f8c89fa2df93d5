"""Log-odds of behavior symbols in the particles (eq. 4, section 3.3), given the children's sets.

The device version of ``behavior_properties``: leaves of a program are [..., E, 1], those of worlds
[..., E, P]; episodes and particles are lanes. A ``row`` is a program of one phrase: its fields
have lost their first axis.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.program import LOG_NEVER, BehaviorProgram
from jaxlangnav.inputs.object_types import is_type, label_of
from jaxlangnav.messages import NONE, ROBOT, BehaviorWorld
from jaxlangnav.numerics.batching import lookup


class ObjectSets(NamedTuple):
    """Sets of each particle's objects as bit masks."""

    kind: Array  # i32[N, E, P] types of the objects
    previous: Array  # i32[3, E, P] the previous goal; others of its type; those of other types
    robot: Array  # i32[E, P]
    everything: Array  # i32[E, P]
    lies: Array  # i32[T, N, E, P] objects in the region, by the program's tables and landmark


class Combinations(NamedTuple):
    """Four best combinations of the child hypotheses of a phrase."""

    sets: Array  # i32[4, 5 + L, E, P], united where children are combined: the children's objects;
    # objects of any child symbol; the children's constraints; objects that are in no region of some
    # restricting child; the children's regions in the phrase's own slots, and in the relation of
    # the constraint slot
    cost: Array  # f32[4, E, P]


_OBJECTS, _TOUCHED, _KEPT, _OUTSIDE, _SLOTS, _NEAR = 0, 1, 2, 3, slice(4, -1), -1
"""Indices into ``Combinations.sets``."""


def build_object_sets(program: BehaviorProgram, world: BehaviorWorld) -> ObjectSets:
    """Encode worlds as bit masks; leaves of the world are [..., E, P]."""
    is_object, kind = world.is_object, world.object_type
    itself = jnp.where(is_object, _bit_of_each(kind.shape[0], 3), 0)
    everything = jnp.sum(itself, axis=0)
    edges = jnp.concatenate([world.is_related, world.is_superlative, world.is_later])
    figures = jnp.sum(jnp.where(edges, itself[None, :, None], 0), axis=1)
    figures = jnp.append(figures, itself[None], axis=0)  # [18 + 1, N, E, P]: the last table is "at"
    previous = world.is_previous & is_object
    last_type = jnp.max(jnp.where(previous, kind, NONE - 9), axis=0)
    same_type = (label_of(kind) == label_of(last_type)[None]) & is_object
    is_robot = (kind == ROBOT) & is_object
    goal, others, robot = to_mask(jnp.stack([previous, same_type & ~previous, is_robot]))
    rest = jnp.where(goal != 0, everything & ~(goal | others), 0)
    return ObjectSets(
        kind=kind,
        previous=jnp.stack([goal, others, rest]),
        robot=robot,
        everything=everything,
        lies=lookup(figures, _per_object(program.table, is_object)),
    )


def _per_object(index: Array, objects: Array) -> Array:
    """Broadcast indices over objects: i32[n, E, 1] to i32[n, N, E, P]."""
    return jnp.broadcast_to(index[:, None], (index.shape[0], *objects.shape))


def _named(row: BehaviorProgram, scene: ObjectSets) -> Array:
    """Find the objects of the types that the words name, i32[E, P]."""
    named = is_type(scene.kind[None], row.own[:, None])  # [W, N, E, P]
    return to_mask(functools.reduce(jnp.logical_or, named)) & scene.everything


def object_odds(row: BehaviorProgram, scene: ObjectSets, joined: Combinations, size: int) -> Array:
    """Evaluate the log-odds of the objects, f32[4, N, E, P]."""
    named_mask = _named(row, scene)
    own = _is_in(named_mask, size)
    always, named, other, expressed, there, elsewhere, absent, named_there, *previous = row.objects
    base = jnp.where(own, always + named, always + other)
    base = base + jnp.where(_is_in(named_mask & scene.previous[0], size), previous[0], 0.0)
    for n in range(3):
        base = base + jnp.where(_is_in(scene.previous[n], size), previous[1 + n], 0.0)
    base = base + jnp.where(scene.previous[0] == 0, previous[4], 0.0)[None]
    base = jnp.where(_is_in(scene.everything, size), base, LOG_NEVER)
    objects, outside = joined.sets[:, _OBJECTS], joined.sets[:, _OUTSIDE]
    inside, lies = _is_in(objects, size), ~_is_in(outside, size)
    given = expressed + jnp.where(lies, there, elsewhere)
    own_there = jnp.where(own[None] & lies, named_there, 0.0)
    return base[None] + own_there + jnp.where(inside, given, absent)


def region_odds(row: BehaviorProgram, scene: ObjectSets, joined: Combinations, size: int) -> Array:
    """Evaluate the log-odds of the regions (goals of a verb phrase), f32[4, L, N, E, P]."""
    inside = _is_in(joined.sets[:, _OBJECTS], size)[:, None]
    same = _is_in(joined.sets[:, _SLOTS], size)
    base, expressed, same_region, absent, named_odds, robot = row.regions[:, :, None]
    base = base + jnp.where(_is_in(_named(row, scene), size), named_odds, 0.0)
    base = base + jnp.where(_is_in(scene.robot, size), robot, 0.0)
    base = jnp.where(_is_in(scene.everything, size), base, LOG_NEVER)
    return (
        base[None]
        + jnp.where(inside, expressed, 0.0)
        + jnp.where(same, same_region, 0.0)
        + jnp.where(inside | same, 0.0, absent)
    )


def constraint_odds(
    row: BehaviorProgram, scene: ObjectSets, joined: Combinations, size: int
) -> Array:
    """Evaluate the log-odds of the constraints, f32[4, N, E, P], of the row's one relation."""
    base, same_region, inside, part, untouched, repeated, first = row.constraints
    base = jnp.where(_is_in(scene.everything, size), base, LOG_NEVER)
    objects, touched, kept, near = (
        _is_in(joined.sets[:, index], size) for index in (_OBJECTS, _TOUCHED, _KEPT, _NEAR)
    )
    return (
        base[None]
        + jnp.where(near, same_region, 0.0)
        + jnp.where(objects, inside, 0.0)
        + jnp.where(touched, part + jnp.where(kept, 0.0, first), untouched)
        + jnp.where(kept, repeated, 0.0)
    )


def lying_in(row: BehaviorProgram, scene: ObjectSets, regions: Array) -> Array:
    """Find the objects that lie in the expressed regions, i32[4, L, E, P] to i32[4, E, P]."""
    table = lookup(scene.lies, _per_object(row.region_table, scene.lies[0]))
    there = jnp.where(_is_in(regions, scene.lies.shape[1]), table[None], 0)  # [4, L, N, E, P]
    return jax.lax.reduce_or(there, axes=(1, 2))


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


def smallest(cost: Array, count: int) -> tuple[list[Array], list[Array]]:
    """Find the ``count`` smallest nonnegative costs f32[..., n ≤ 64, E, P] and their indices.

    The index replaces the low bits of the float, so that one minimum yields both.
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


def pick_of_four(values: Array, index: Array) -> Array:
    """Read one of four: values i32[4, ..., E, P], index i32[m, ..., E, P] → i32[m, ..., E, P]."""
    odd = (index & 1) == 1
    low_part = jnp.where(odd, values[1:2], values[0:1])
    return jnp.where(index >= 2, jnp.where(odd, values[3:4], values[2:3]), low_part)
