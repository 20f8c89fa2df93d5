"""Log-odds of behavior symbols in the particles (eq. 4, section 3.3), given the children's sets.

The device twin of ``behavior_features``: leaves of a program are [..., E, 1], those of worlds
[..., E, P]; episodes and particles are lanes.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.bits import iota, is_in, to_mask
from jaxlangnav.grounding.program import (
    AT_TABLE,
    NEVER,
    NUM_SLOTS,
    NUM_TABLES,
    NUM_TYPES,
    BehaviorProgram,
)
from jaxlangnav.grounding.symbols import NUM_RELATIONS
from jaxlangnav.messages import NONE, ROBOT, BehaviorWorld


class Scene(NamedTuple):
    """The particles' objects as bits."""

    types: Array  # i32[16, E, P] per type, the objects of it
    previous: Array  # i32[3, E, P] the previous goal; others of its type; those of other types
    robot: Array  # i32[E, P]
    everything: Array  # i32[E, P]
    lies: Array  # i32[T, N, E, P] per table of the program and landmark, the objects there


class Joined(NamedTuple):
    """Four best combinations of the child hypotheses of a phrase."""

    objects: Array  # i32[4, E, P]
    same: tuple[Array, ...]  # L times i32[4, E, P], children's regions in the phrase's own slots
    touched: Array  # i32[4, E, P] objects of any child symbol
    near: Array  # i32[4, E, P] children's regions in the relation of the constraint slot
    kept: Array  # i32[4, E, P] children's constraints
    lies: Array  # i32[4, E, P] objects in the regions of every restricting child
    cost: Array  # f32[4, E, P]


def build_scene(program: BehaviorProgram, world: BehaviorWorld) -> Scene:
    """Turn worlds into bits; leaves of the world are [..., E, P]."""
    is_object = world.is_object
    row = jnp.where(world.object_type == ROBOT, NUM_TYPES, world.object_type)
    types = [to_mask((row == t) & is_object) for t in range(NUM_TYPES + 1)]
    itself = jnp.where(is_object, jnp.left_shift(jnp.int32(1), iota(row.shape[0], 3)), 0)
    everything = jnp.sum(itself, axis=0)
    figures = itself[None, :, None]
    related = jnp.sum(jnp.where(world.is_related, figures, 0), axis=1)
    extreme = jnp.sum(jnp.where(world.is_superlative, figures, 0), axis=1)
    later = jnp.sum(jnp.where(world.is_later, figures, 0), axis=1)
    tables = []
    for n in range(NUM_TABLES):
        kind, relation = program.table[n] // NUM_RELATIONS, program.table[n] % NUM_RELATIONS
        chosen = jnp.zeros_like(itself)
        for r in range(NUM_RELATIONS):
            ranked = jnp.where(kind == 1, extreme[r], later[r])
            chosen = chosen | jnp.where(relation == r, jnp.where(kind == 0, related[r], ranked), 0)
        tables.append(jnp.where(kind == AT_TABLE // NUM_RELATIONS, itself, chosen))
    previous = world.is_previous & is_object
    last_type = jnp.max(jnp.where(previous, world.object_type, NONE - 9), axis=0)
    alike = (world.object_type == last_type[None]) & is_object
    goal, others = to_mask(previous), to_mask(alike & ~previous)
    rest = jnp.where(goal != 0, everything & ~(goal | others), 0)
    return Scene(
        types=jnp.stack(types),
        previous=jnp.stack([goal, others, rest]),
        robot=types[NUM_TYPES],
        everything=everything,
        lies=jnp.stack(tables),
    )


def _own(program: BehaviorProgram, scene: Scene, phrase: Array) -> Array:
    """Find the objects of the types that the words name, i32[E, P]."""
    return jnp.sum(jnp.where(program.own[phrase], scene.types, 0), axis=0)


def object_odds(
    program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array, size: int
) -> Array:
    """Evaluate the log-odds of the objects, f32[4, N, E, P]."""
    own_mask = _own(program, scene, phrase)
    own = is_in(own_mask, size)
    weight = program.object_previous[phrase]
    base = jnp.where(own, program.object_named[phrase], program.object_unnamed[phrase])
    base = base + jnp.where(is_in(own_mask & scene.previous[0], size), weight[0], 0.0)
    for n in range(3):
        base = base + jnp.where(is_in(scene.previous[n], size), weight[1 + n], 0.0)
    base = base + jnp.where(scene.previous[0] == 0, weight[4], 0.0)[None]
    base = jnp.where(is_in(scene.everything, size), base, NEVER)
    inside, lies = is_in(joined.objects, size), is_in(joined.lies, size)
    there = program.object_inside[phrase] + jnp.where(
        lies, program.object_lies[phrase], program.object_outside[phrase]
    )
    named = jnp.where(own[None] & lies, program.object_own_lies[phrase], 0.0)
    return base[None] + named + jnp.where(inside, there, program.object_absent[phrase])


def region_odds(
    program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array, size: int
) -> Array:
    """Evaluate the log-odds of the regions (goals of a verb phrase), f32[4, L, N, E, P]."""
    own = is_in(_own(program, scene, phrase), size)
    robot = is_in(scene.robot, size)
    is_object = is_in(scene.everything, size)
    inside = is_in(joined.objects, size)
    rows = []
    for s in range(NUM_SLOTS):
        same = is_in(joined.same[s], size)
        base = program.region_base[phrase, s] + jnp.where(own, program.region_own[phrase, s], 0.0)
        base = base + jnp.where(robot, program.region_robot[phrase, s], 0.0)
        base = jnp.where(is_object, base, NEVER)
        rows.append(
            base[None]
            + jnp.where(inside, program.region_inside[phrase, s], 0.0)
            + jnp.where(same, program.region_same[phrase, s], 0.0)
            + jnp.where(inside | same, 0.0, program.region_absent[phrase, s])
        )
    return jnp.stack(rows, axis=1)


def constraint_odds(
    program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array, size: int
) -> Array:
    """Evaluate the log-odds of the constraints in their slot, f32[4, N, E, P]."""
    base = jnp.where(is_in(scene.everything, size), program.constraint_base[phrase], NEVER)
    kept, touched = is_in(joined.kept, size), is_in(joined.touched, size)
    new = jnp.where(kept, 0.0, program.constraint_new[phrase])
    return (
        base[None]
        + jnp.where(is_in(joined.near, size), program.constraint_same[phrase], 0.0)
        + jnp.where(is_in(joined.objects, size), program.constraint_inside[phrase], 0.0)
        + jnp.where(
            touched,
            program.constraint_touched[phrase] + new,
            program.constraint_untouched[phrase],
        )
        + jnp.where(kept, program.constraint_kept[phrase], 0.0)
    )


def lying_in(program: BehaviorProgram, scene: Scene, regions: list[Array], phrase: Array) -> Array:
    """Find the objects that lie in the expressed regions, i32[4, E, P]."""
    size = scene.lies.shape[1]
    found = jnp.zeros_like(regions[0])
    for s in range(NUM_SLOTS):
        table = jnp.zeros_like(scene.lies[0])
        for n in range(NUM_TABLES):
            table = table | jnp.where(program.region_table[phrase, s] == n, scene.lies[n], 0)
        for j in range(size):
            found = found | jnp.where((regions[s] >> j) & 1 == 1, table[j][None], 0)
    return found
