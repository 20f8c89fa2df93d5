"""Behavior inference in one particle (section 3.3): the device kernel of the DCG.

Words are gone (``program``); what is left per particle is look-ups by type, adds and k-best. Sets
of objects are bit masks, so joining children, and finding what lies in their regions, are a few
integer operations. The beam is four hypotheses wide, and the four best sets of independent
factors have a closed form: none, the smallest margin flipped, the second smallest, and the
cheaper of the third smallest and the two smallest together.

Written for one particle; the navigator maps it over particles with the particle axis last.
Equal sets that rest on different child hypotheses stay apart in the beam.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.program import NEVER, NUM_CHILDREN, NUM_SLOTS, BehaviorProgram
from jaxlangnav.messages import NONE, ROBOT, Behavior, BehaviorWorld

BEAM = 4
_DEAD = 1e6
"""Cost of a hypothesis that does not exist."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (2, 0), (3, 0))
"""Pairs of two sorted lists of four among which the four best sums are."""


class Scene(NamedTuple):
    """A particle's objects as bits."""

    type_row: Array  # f32[16, N] one-hot type
    previous: Array  # f32[N]
    robot: Array  # f32[N]
    is_object: Array  # bool[N]
    lies: Array  # i32[14, N] per table and landmark, the objects that lie there


class Beam(NamedTuple):
    """Hypotheses of the phrases inferred so far; sets of objects as bits."""

    objects: Array  # i32[H, 4]
    regions: Array  # i32[H, L, 4]
    constraints: Array  # i32[H, 4]
    lies: Array  # i32[H, 4] objects that lie in the expressed regions
    cost: Array  # f32[H, 4] −log-probability, ascending


class Joined(NamedTuple):
    """Four best combinations of the child hypotheses of a phrase."""

    objects: Array  # i32[4]
    same: Array  # i32[L, 4] children's regions in the phrase's own slots
    touched: Array  # i32[4] objects of any child symbol
    near: Array  # i32[4] children's regions in the relation of the constraint slot
    kept: Array  # i32[4] children's constraints
    lies: Array  # i32[4] objects in the regions of every restricting child
    cost: Array  # f32[4]


def _bits(mask: Array, size: int) -> Array:
    """Spread bit masks i32[..., 4] to f32[..., 4, size]."""
    return ((mask[..., None] >> jnp.arange(size, dtype=jnp.int32)) & 1).astype(jnp.float32)


def _to_mask(flags: Array) -> Array:
    """Gather booleans bool[..., N] to bit masks i32[...]."""
    weight = jnp.left_shift(jnp.int32(1), jnp.arange(flags.shape[-1], dtype=jnp.int32))
    return jnp.sum(jnp.where(flags, weight, 0), axis=-1)


def _smallest(cost: Array, count: int) -> tuple[list[Array], list[Array]]:
    """Find the smallest of nonnegative costs f32[..., n ≤ 64] and where they stand.

    The index rides in the low bits of the number, so that one minimum finds both.
    """
    size = cost.shape[-1]
    low = (1 << (size - 1).bit_length()) - 1
    bits = jax.lax.bitcast_convert_type(cost, jnp.int32)
    packed = (bits & ~low) | jnp.arange(size, dtype=jnp.int32)
    values, places = [], []
    for _ in range(count):
        least = jnp.min(packed, axis=-1)
        packed = jnp.where(packed == least[..., None], jnp.iinfo(jnp.int32).max, packed)
        values.append(jax.lax.bitcast_convert_type(least & ~low, jnp.float32))
        places.append(least & low)
    return values, places


def _pick(values: Array, index: Array) -> Array:
    """Read ``values[..., index]`` over a last axis of four, by comparison."""
    parts = [jnp.where(index == i, values[..., i : i + 1], 0) for i in range(BEAM)]
    return parts[0] + parts[1] + parts[2] + parts[3]


def _scene(world: BehaviorWorld) -> Scene:
    """Turn a world into bits."""
    size = world.object_type.shape[0]
    num_types = 16
    row = jnp.where(world.object_type == ROBOT, num_types - 1, world.object_type)
    type_row = (row[None, :] == jnp.arange(num_types, dtype=row.dtype)[:, None]) & world.is_object
    both = jnp.concatenate([world.is_related, world.is_superlative]) & world.is_object[:, None]
    weight = jnp.left_shift(jnp.int32(1), jnp.arange(size, dtype=jnp.int32))
    related = jnp.sum(jnp.where(both, weight[:, None], 0), axis=1)
    itself = jnp.where(world.is_object, weight, 0)
    nothing = jnp.zeros_like(itself)
    return Scene(
        type_row=type_row.astype(jnp.float32),
        previous=world.is_previous.astype(jnp.float32),
        robot=(world.object_type == ROBOT).astype(jnp.float32),
        is_object=world.is_object,
        lies=jnp.concatenate([related, itself[None], nothing[None]]),
    )


def _child(program: BehaviorProgram, beam: Beam, phrase: Array, k: int) -> Joined:
    """Read the hypotheses of a phrase's k-th child as if it were the only one."""
    child = program.child[phrase, k]
    exists = child != NONE
    row = jnp.maximum(child, 0)
    objects, regions = beam.objects[row], beam.regions[row]

    def in_slot(slot: Array) -> Array:
        values = [jnp.where(slot == s, regions[s], 0) for s in range(NUM_SLOTS)]
        return values[0] + values[1]

    constraint = program.constraint_from[phrase, k]
    first = jnp.where(jnp.arange(BEAM) == 0, 0.0, _DEAD).astype(jnp.float32)
    limits = program.is_restrictor[phrase, k] & exists
    joined = Joined(
        objects=objects,
        same=jnp.stack([in_slot(program.region_from[phrase, k, s]) for s in range(NUM_SLOTS)]),
        touched=objects | regions[0] | regions[1],
        near=in_slot(program.constraint_region[phrase, k]),
        kept=jnp.where(constraint == NONE, 0, beam.constraints[row]),
        lies=jnp.where(limits, beam.lies[row], -1),
        cost=jnp.where(exists, beam.cost[row], first),
    )
    gone = {
        name: jnp.where(exists, value, 0)
        for name, value in joined._asdict().items()
        if name not in ("lies", "cost")
    }
    return joined._replace(**gone)


def _combine(left: Joined, right: Joined) -> Joined:
    """Keep the four best combinations of two sorted lists of hypotheses, exactly."""
    cost = jnp.stack([left.cost[i] + right.cost[j] for i, j in _PAIRS])
    values, places = _smallest(cost, BEAM)
    place = jnp.stack(places)
    i = sum(jnp.where(place == n, pair[0], 0) for n, pair in enumerate(_PAIRS))
    j = sum(jnp.where(place == n, pair[1], 0) for n, pair in enumerate(_PAIRS))
    joined = {
        name: _pick(getattr(left, name), i) | _pick(getattr(right, name), j)
        for name in ("objects", "same", "touched", "near", "kept")
    }
    lies = _pick(left.lies, i) & _pick(right.lies, j)
    return Joined(**joined, lies=lies, cost=jnp.stack(values))


def _join(program: BehaviorProgram, beam: Beam, phrase: Array) -> Joined:
    """Combine the hypotheses of all children of a phrase."""
    joined = _child(program, beam, phrase, 0)
    for k in range(1, NUM_CHILDREN):
        joined = _combine(joined, _child(program, beam, phrase, k))
    return joined


def _object_odds(program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array) -> Array:
    """Evaluate the log-odds of the objects, f32[4, N]."""
    size = scene.robot.shape[0]
    base = jnp.sum(program.object_base[phrase][:, None] * scene.type_row, axis=0)
    own = jnp.sum(program.own[phrase][:, None] * scene.type_row, axis=0)
    base = base + program.object_previous[phrase] * own * scene.previous
    inside, lies = _bits(joined.objects, size), _bits(joined.lies, size)
    there = (
        program.object_inside[phrase]
        + program.object_lies[phrase] * lies
        + program.object_outside[phrase] * (1.0 - lies)
    )
    odds = (
        base[None]
        + inside * there
        + program.object_absent[phrase] * (1.0 - inside)
        + program.object_own_lies[phrase] * own[None] * lies
    )
    return jnp.where(scene.is_object[None], odds, NEVER)


def _region_odds(program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array) -> Array:
    """Evaluate the log-odds of the regions (goals of a verb phrase) in the slots, f32[L, 4, N]."""
    size = scene.robot.shape[0]
    own = jnp.sum(program.own[phrase][:, None] * scene.type_row, axis=0)
    inside = _bits(joined.objects, size)
    rows = []
    for s in range(NUM_SLOTS):
        same = _bits(joined.same[s], size)
        base = program.region_base[phrase, s] + program.region_own[phrase, s] * own
        base = base + program.region_robot[phrase, s] * scene.robot
        rows.append(
            base[None]
            + program.region_inside[phrase, s] * inside
            + program.region_same[phrase, s] * same
            + program.region_absent[phrase, s] * (1.0 - inside) * (1.0 - same)
        )
    return jnp.where(scene.is_object, jnp.stack(rows), NEVER)


def _constraint_odds(
    program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array
) -> Array:
    """Evaluate the log-odds of the constraints in their slot, f32[4, N]."""
    size = scene.robot.shape[0]
    touched, kept = _bits(joined.touched, size), _bits(joined.kept, size)
    odds = (
        program.constraint_base[phrase]
        + program.constraint_same[phrase] * _bits(joined.near, size)
        + program.constraint_inside[phrase] * _bits(joined.objects, size)
        + program.constraint_touched[phrase] * touched
        + program.constraint_untouched[phrase] * (1.0 - touched)
        + program.constraint_kept[phrase] * kept
        + program.constraint_new[phrase] * touched * (1.0 - kept)
    )
    return jnp.where(scene.is_object[None], odds, NEVER)


class Sets(NamedTuple):
    """Four candidate sets of a phrase, as bits."""

    objects: Array  # i32[4]
    regions: Array  # i32[L, 4]
    constraints: Array  # i32[4]
    cost: Array  # f32[4]


def _best_sets(odds: Array, cost: Array, size: int) -> Sets:
    """Find the four best sets over the four combinations of the children.

    Args:
        odds: f32[4, (2 + L) N] log-odds of objects, regions by slot and constraints.
        cost: f32[4] of the combinations.
        size: N.

    Returns:
        The sets, best first.
    """
    margin = jnp.abs(odds)
    # Σ log(1 + e^−m) as one logarithm of a product: up to 2^60 fits float32.
    base = cost + jnp.log(jnp.prod(1.0 + jnp.exp(-margin), axis=-1))
    (m1, m2, m3), (f1, f2, f3) = _smallest(margin, 3)
    is_pair = m1 + m2 < m3
    costs = jnp.stack([base, base + m1, base + m2, base + jnp.where(is_pair, m1 + m2, m3)])
    values, places = _smallest(costs.reshape(-1), BEAM)
    place = jnp.stack(places)
    kind, combination = place >> 2, place & 3
    flip_1 = jnp.where((kind == 1) | ((kind == 3) & _pick(is_pair, combination)), 1, 0)
    flip_2 = jnp.where((kind == 2) | ((kind == 3) & _pick(is_pair, combination)), 1, 0)
    flip_3 = jnp.where((kind == 3) & ~_pick(is_pair, combination), 1, 0)
    flips = (
        (_pick(f1, combination), flip_1),
        (_pick(f2, combination), flip_2),
        (_pick(f3, combination), flip_3),
    )
    groups = _to_mask(odds.reshape(BEAM, -1, size) > 0)  # [4, 2 + L]
    chosen = []
    for g in range(groups.shape[1]):
        mask = _pick(groups[:, g], combination)
        for index, is_on in flips:
            bit = index - g * size
            hit = (bit >= 0) & (bit < size)
            mask = mask ^ jnp.where(hit, is_on << jnp.clip(bit, 0, size - 1), 0)
        chosen.append(mask)
    return Sets(chosen[0], jnp.stack(chosen[1:-1]), chosen[-1], jnp.stack(values))


def _lies(program: BehaviorProgram, scene: Scene, regions: Array, phrase: Array) -> Array:
    """Find the objects that lie in the expressed regions, i32[4]."""
    size = scene.robot.shape[0]
    found = jnp.zeros(BEAM, jnp.int32)
    for s in range(NUM_SLOTS):
        table = scene.lies[program.region_table[phrase, s]]
        for j in range(size):
            found = found | jnp.where((regions[s] >> j) & 1 == 1, table[j], 0)
    return found


def _advance(program: BehaviorProgram, scene: Scene, beam: Beam, phrase: Array) -> Beam:
    """Infer one phrase from its children."""
    size = scene.robot.shape[0]
    joined = _join(program, beam, phrase)
    regions = _region_odds(program, scene, joined, phrase)
    odds = jnp.concatenate(
        [
            _object_odds(program, scene, joined, phrase)[:, None],
            jnp.moveaxis(regions, 0, 1),
            _constraint_odds(program, scene, joined, phrase)[:, None],
        ],
        axis=1,
    ).reshape(BEAM, -1)
    sets = _best_sets(odds, joined.cost, size)
    return Beam(
        objects=beam.objects.at[phrase].set(sets.objects),
        regions=beam.regions.at[phrase].set(sets.regions),
        constraints=beam.constraints.at[phrase].set(sets.constraints),
        lies=beam.lies.at[phrase].set(_lies(program, scene, sets.regions, phrase)),
        cost=beam.cost.at[phrase].set(sets.cost),
    )


def _by_relation(values: Array, relation: Array) -> Array:
    """Spread slots f32[L, N] over the seven regions, f32[7, N]."""
    hit = relation[:, None] == jnp.arange(7, dtype=relation.dtype)[None, :]
    return jnp.sum(jnp.where(hit[:, :, None], values[:, None, :], 0.0), axis=0)


def _conclude(program: BehaviorProgram, scene: Scene, joined: Joined, root: Array) -> Behavior:
    """Read the behavior off the root, averaged over the combinations of its children.

    A behavior has one goal: the probability that any goal is expressed is shared in proportion
    to the probability of each.
    """
    weight = jax.nn.softmax(-joined.cost)
    goal = jax.nn.sigmoid(_region_odds(program, scene, joined, root))
    is_any = 1.0 - jnp.prod(1.0 - goal, axis=(0, 2))
    share = is_any / jnp.maximum(jnp.sum(goal, axis=(0, 2)), 1e-9)
    constraint = jax.nn.sigmoid(_constraint_odds(program, scene, joined, root))
    return Behavior(
        action=program.action,
        mode=program.mode,
        goal=_by_relation(
            jnp.sum(goal * (share * weight)[None, :, None], axis=1), program.region_relation[root]
        ),
        constraint=_by_relation(
            jnp.sum(constraint * weight[:, None], axis=0)[None],
            program.constraint_relation[root][None],
        ),
    )


def infer_behavior(
    program: BehaviorProgram, world: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in one particle (section 3.3).

    Limits: a program of no phrases has no goal; a world without the object has goals that sum to
    nearly nothing. Empty object slots and padded phrases change nothing.

    Args:
        program: one clause.
        world: the particle's objects; at most 15 slots with the robot's.
        num_phrases: how many phrases to infer, at least those of the program: the largest of a
            batch. It is a trip count, so padding costs nothing.

    Returns:
        The behavior.
    """
    scene = _scene(world)
    height = program.child.shape[0]
    beam = Beam(
        objects=jnp.zeros((height, BEAM), jnp.int32),
        regions=jnp.zeros((height, NUM_SLOTS, BEAM), jnp.int32),
        constraints=jnp.zeros((height, BEAM), jnp.int32),
        lies=jnp.zeros((height, BEAM), jnp.int32),
        cost=jnp.zeros((height, BEAM), jnp.float32),
    )
    trips = jnp.asarray(num_phrases, jnp.int32) - 1
    beam = jax.lax.fori_loop(
        0, trips, lambda phrase, carry: _advance(program, scene, carry, phrase), beam
    )
    root = jnp.maximum(program.num_phrases - 1, 0)
    behavior = _conclude(program, scene, _join(program, beam, root), root)
    is_empty = program.num_phrases == 0
    return Behavior(
        action=behavior.action,
        mode=behavior.mode,
        goal=jnp.where(is_empty, 0.0, behavior.goal),
        constraint=jnp.where(is_empty, 0.0, behavior.constraint),
    )
