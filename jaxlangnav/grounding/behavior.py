"""Behavior inference in the particles (section 3.3): the device kernel of the DCG.

Words are gone (``program``); what is left per particle is look-ups by type, adds and k-best. Sets
of objects are bit masks, so joining children, and finding what lies in their regions, are a few
integer operations. The beam is four hypotheses wide, and the four best sets of independent
factors have a closed form: none, the smallest margin flipped, the second smallest, and the
cheaper of the third smallest and the two smallest together.

Arrays carry the particle axis **last** throughout, so that every operation is a vector operation
over particles. Equal sets that rest on different child hypotheses stay apart in the beam.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.program import (
    NEVER,
    NUM_CHILDREN,
    NUM_SLOTS,
    NUM_TYPES,
    BehaviorProgram,
)
from jaxlangnav.messages import NONE, ROBOT, Behavior, BehaviorWorld

BEAM = 4
_DEAD = 1e6
"""Cost of a hypothesis that does not exist."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (2, 0), (3, 0))
"""Pairs of two sorted lists of four among which the four best sums are."""


class Scene(NamedTuple):
    """The particles' objects as bits."""

    type_row: Array  # f32[16, N, P] one-hot type
    previous: Array  # f32[5, N, P] named and previous is read with ``own``; the rest as program
    robot: Array  # f32[N, P]
    is_object: Array  # bool[N, P]
    lies: Array  # i32[20, N, P] per table and landmark, the objects that lie there


class Beam(NamedTuple):
    """Hypotheses of the phrases inferred so far; sets of objects as bits."""

    sets: Array  # i32[H, 5, 4, P] objects, regions by slot, constraints, and what lies in regions
    cost: Array  # f32[H, 4, P] −log-probability, ascending


OBJECTS, REGIONS, CONSTRAINTS, LIES = 0, 1, 1 + NUM_SLOTS, 2 + NUM_SLOTS
"""Rows of ``Beam.sets``."""


class Joined(NamedTuple):
    """Four best combinations of the child hypotheses of a phrase."""

    sets: Array  # i32[6, 4, P] objects; regions in the phrase's own slots; all objects touched;
    # regions in the relation of the constraint slot; constraints
    lies: Array  # i32[4, P] objects in the regions of every restricting child
    cost: Array  # f32[4, P]


def _bits(mask: Array, size: int) -> Array:
    """Spread bit masks i32[..., 4, P] to f32[..., 4, size, P]."""
    place = jax.lax.broadcasted_iota(jnp.int32, (*(1,) * (mask.ndim - 1), size, 1), mask.ndim - 1)
    return ((mask[..., None, :] >> place) & 1).astype(jnp.float32)


def _smallest(cost: Array, count: int) -> tuple[list[Array], list[Array]]:
    """Find the smallest of nonnegative costs f32[..., n ≤ 64, P] and where they stand.

    The index rides in the low bits of the number, so that one minimum finds both.
    """
    size = cost.shape[-2]
    low = (1 << (size - 1).bit_length()) - 1
    bits = jax.lax.bitcast_convert_type(cost, jnp.int32)
    packed = (bits & ~low) | jax.lax.broadcasted_iota(jnp.int32, cost.shape, cost.ndim - 2)
    values, places = [], []
    least = jnp.min(packed, axis=-2)
    for n in range(count):
        values.append(jax.lax.bitcast_convert_type(least & ~low, jnp.float32))
        places.append(least & low)
        if n + 1 < count:
            rest = jnp.where(packed > least[..., None, :], packed, jnp.iinfo(jnp.int32).max)
            least = jnp.min(rest, axis=-2)
    return values, places


def _pick(values: Array, index: Array) -> Array:
    """Read one of four along the axis before the last: values [..., 4, P], index i32[m, P]."""
    index = index.reshape(*(1,) * (values.ndim - index.ndim), *index.shape)
    parts = [jnp.where(index == i, values[..., i : i + 1, :], 0) for i in range(BEAM)]
    return (parts[0] | parts[1]) | (parts[2] | parts[3])


def _scene(world: BehaviorWorld) -> Scene:
    """Turn worlds into bits."""
    size = world.object_type.shape[0]
    is_object = world.is_object
    row = jnp.where(world.object_type == ROBOT, NUM_TYPES, world.object_type)
    types = jnp.arange(NUM_TYPES + 1, dtype=row.dtype)[:, None, None]
    type_row = ((row[None] == types) & is_object[None]).astype(jnp.float32)
    weight = jnp.left_shift(jnp.int32(1), jnp.arange(size, dtype=jnp.int32))[:, None]
    itself = jnp.where(is_object, weight, 0)
    related = jnp.sum(jnp.where(world.is_related, itself[None, :, None], 0), axis=1)
    extreme = jnp.sum(jnp.where(world.is_superlative, itself[None, :, None], 0), axis=1)
    everything = jnp.sum(itself, axis=0)
    # The nothing-table comes after "at"; "not the extreme" is of use where ranks are meant.
    lies = jnp.concatenate(
        [
            related,
            extreme,
            everything[None, None] & ~extreme,
            itself[None],
            jnp.zeros_like(itself)[None],
        ]
    )
    previous = world.is_previous & is_object
    has_previous = jnp.any(previous, axis=0)
    last_type = jnp.max(jnp.where(previous, world.object_type, NONE - 9), axis=0)[None]
    alike = (world.object_type == last_type) & is_object
    return Scene(
        type_row=type_row,
        previous=jnp.stack(
            [
                previous,
                previous,
                alike & ~previous,
                ~alike & has_previous[None],
                jnp.broadcast_to(~has_previous[None], alike.shape),
            ]
        ).astype(jnp.float32),
        robot=(world.object_type == ROBOT).astype(jnp.float32),
        is_object=is_object,
        lies=lies,
    )


def _child(program: BehaviorProgram, beam: Beam, phrase: Array, k: int) -> Joined:
    """Read the hypotheses of a phrase's k-th child as if it were the only one."""
    child = program.child[phrase, k]
    exists = child != NONE
    row = jnp.maximum(child, 0)
    sets = jnp.where(exists, beam.sets[row], 0)
    regions = sets[REGIONS : REGIONS + NUM_SLOTS]

    def in_slot(slot: Array) -> Array:
        found = [jnp.where(slot == s, regions[s], 0) for s in range(NUM_SLOTS)]
        return found[0] | found[1]

    touched = sets[OBJECTS] | regions[0] | regions[1]
    kept = jnp.where(program.constraint_from[phrase, k] == NONE, 0, sets[CONSTRAINTS])
    limits = program.is_restrictor[phrase, k] & exists
    first = jnp.where(jnp.arange(BEAM) == 0, 0.0, _DEAD).astype(jnp.float32)[:, None]
    return Joined(
        sets=jnp.stack(
            [
                sets[OBJECTS],
                *(in_slot(program.region_from[phrase, k, s]) for s in range(NUM_SLOTS)),
                touched,
                in_slot(program.constraint_region[phrase, k]),
                kept,
            ]
        ),
        lies=jnp.where(limits, sets[LIES], -1),
        cost=jnp.where(exists, beam.cost[row], first),
    )


def _combine(left: Joined, right: Joined) -> Joined:
    """Keep the four best combinations of two sorted lists of hypotheses, exactly."""
    cost = jnp.stack([left.cost[i] + right.cost[j] for i, j in _PAIRS])
    values, places = _smallest(cost, BEAM)
    place = jnp.stack(places)
    i = sum(jnp.where(place == n, pair[0], 0) for n, pair in enumerate(_PAIRS))
    j = sum(jnp.where(place == n, pair[1], 0) for n, pair in enumerate(_PAIRS))
    return Joined(
        sets=_pick(left.sets, i) | _pick(right.sets, j),
        lies=_pick(left.lies, i) & _pick(right.lies, j),
        cost=jnp.stack(values),
    )


def _join(program: BehaviorProgram, beam: Beam, phrase: Array) -> Joined:
    """Combine the hypotheses of all children of a phrase."""
    joined = _child(program, beam, phrase, 0)
    for k in range(1, NUM_CHILDREN):
        joined = _combine(joined, _child(program, beam, phrase, k))
    return joined


def _own(program: BehaviorProgram, scene: Scene, phrase: Array) -> Array:
    """Find the objects of the types that the words name, f32[N, P]."""
    return jnp.sum(program.own[phrase][:, None, None] * scene.type_row, axis=0)


def _object_odds(program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array) -> Array:
    """Evaluate the log-odds of the objects, f32[4, N, P]."""
    size = scene.robot.shape[0]
    base = jnp.sum(program.object_base[phrase][:, None, None] * scene.type_row, axis=0)
    own = _own(program, scene, phrase)
    base = base + program.object_previous[phrase, 0] * own * scene.previous[0]
    for n in range(1, 5):
        base = base + program.object_previous[phrase, n] * scene.previous[n]
    inside, lies = _bits(joined.sets[0], size), _bits(joined.lies, size)
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
    """Evaluate the log-odds of the regions (goals of a verb phrase), f32[4, L, N, P]."""
    size = scene.robot.shape[0]
    own = _own(program, scene, phrase)
    inside = _bits(joined.sets[0], size)
    rows = []
    for s in range(NUM_SLOTS):
        same = _bits(joined.sets[1 + s], size)
        base = program.region_base[phrase, s] + program.region_own[phrase, s] * own
        base = base + program.region_robot[phrase, s] * scene.robot
        rows.append(
            base[None]
            + program.region_inside[phrase, s] * inside
            + program.region_same[phrase, s] * same
            + program.region_absent[phrase, s] * (1.0 - inside) * (1.0 - same)
        )
    return jnp.where(scene.is_object[None, None], jnp.stack(rows, axis=1), NEVER)


def _constraint_odds(
    program: BehaviorProgram, scene: Scene, joined: Joined, phrase: Array
) -> Array:
    """Evaluate the log-odds of the constraints in their slot, f32[4, N, P]."""
    size = scene.robot.shape[0]
    touched, near, kept = (_bits(joined.sets[1 + NUM_SLOTS + n], size) for n in range(3))
    odds = (
        program.constraint_base[phrase]
        + program.constraint_same[phrase] * near
        + program.constraint_inside[phrase] * _bits(joined.sets[0], size)
        + program.constraint_touched[phrase] * touched
        + program.constraint_untouched[phrase] * (1.0 - touched)
        + program.constraint_kept[phrase] * kept
        + program.constraint_new[phrase] * touched * (1.0 - kept)
    )
    return jnp.where(scene.is_object[None], odds, NEVER)


def _best_sets(odds: Array, cost: Array, size: int) -> tuple[list[Array], Array]:
    """Find the four best sets over the four combinations of the children.

    Args:
        odds: f32[4, (2 + L) N, P] log-odds of objects, regions by slot and constraints.
        cost: f32[4, P] of the combinations.
        size: N.

    Returns:
        2 + L masks i32[4, P] and their costs f32[4, P], best first.
    """
    margin = jnp.abs(odds)
    # Σ log(1 + e^−m) as one logarithm of a product: up to 2^60 fits float32.
    base = cost + jnp.log(jnp.prod(1.0 + jnp.exp(-margin), axis=-2))
    (m1, m2, m3), (f1, f2, f3) = _smallest(margin, 3)
    is_pair = (m1 + m2 < m3).astype(jnp.int32)
    costs = jnp.concatenate([base, base + m1, base + m2, base + jnp.minimum(m3, m1 + m2)])
    values, places = _smallest(costs, BEAM)
    place = jnp.stack(places)
    kind, combination = place >> 2, place & 3
    pair = _pick(is_pair, combination)
    flips = (
        (_pick(f1, combination), (kind == 1) | ((kind == 3) & (pair == 1))),
        (_pick(f2, combination), (kind == 2) | ((kind == 3) & (pair == 1))),
        (_pick(f3, combination), (kind == 3) & (pair == 0)),
    )
    weight = jnp.left_shift(jnp.int32(1), jnp.arange(size, dtype=jnp.int32))[:, None]
    groups = odds.reshape(BEAM, -1, size, odds.shape[-1])
    masks = jnp.sum(jnp.where(groups > 0, weight[None, None], 0), axis=-2)  # [4, 2 + L, P]
    chosen = []
    for g in range(masks.shape[1]):
        mask = _pick(masks[:, g], combination)
        for index, is_on in flips:
            bit = index - g * size
            hit = is_on & (bit >= 0) & (bit < size)
            mask = mask ^ jnp.where(hit, jnp.left_shift(1, jnp.clip(bit, 0, size - 1)), 0)
        chosen.append(mask)
    return chosen, jnp.stack(values)


def _lies(program: BehaviorProgram, scene: Scene, regions: list[Array], phrase: Array) -> Array:
    """Find the objects that lie in the expressed regions, i32[4, P]."""
    size = scene.robot.shape[0]
    found = jnp.zeros_like(regions[0])
    for s in range(NUM_SLOTS):
        table = scene.lies[program.region_table[phrase, s]]
        for j in range(size):
            found = found | jnp.where((regions[s] >> j) & 1 == 1, table[j][None], 0)
    return found


def _advance(program: BehaviorProgram, scene: Scene, beam: Beam, phrase: Array) -> Beam:
    """Infer one phrase from its children."""
    size, num_particles = scene.robot.shape
    joined = _join(program, beam, phrase)
    odds = jnp.concatenate(
        [
            _object_odds(program, scene, joined, phrase)[:, None],
            _region_odds(program, scene, joined, phrase),
            _constraint_odds(program, scene, joined, phrase)[:, None],
        ],
        axis=1,
    ).reshape(BEAM, -1, num_particles)
    masks, cost = _best_sets(odds, joined.cost, size)
    lies = _lies(program, scene, masks[REGIONS : REGIONS + NUM_SLOTS], phrase)
    return Beam(
        sets=beam.sets.at[phrase].set(jnp.stack([*masks, lies])),
        cost=beam.cost.at[phrase].set(cost),
    )


def _by_relation(values: Array, relation: Array) -> Array:
    """Spread slots f32[L, N, P] over the seven regions, f32[7, N, P]."""
    hit = relation[:, None] == jnp.arange(7, dtype=relation.dtype)[None, :]
    return jnp.sum(jnp.where(hit[:, :, None, None], values[:, None], 0.0), axis=0)


def _conclude(program: BehaviorProgram, scene: Scene, joined: Joined, root: Array) -> Behavior:
    """Read the behavior off the root, averaged over the combinations of its children.

    A behavior has one goal: the probability that any goal is expressed is shared in proportion
    to the probability of each.
    """
    num_particles = scene.robot.shape[-1]
    weight = jax.nn.softmax(-joined.cost, axis=0)
    goal = jax.nn.sigmoid(_region_odds(program, scene, joined, root))
    is_any = 1.0 - jnp.prod(1.0 - goal, axis=(1, 2))
    share = weight * is_any / jnp.maximum(jnp.sum(goal, axis=(1, 2)), 1e-9)
    constraint = jax.nn.sigmoid(_constraint_odds(program, scene, joined, root))
    exists = jnp.where(program.num_phrases == 0, 0.0, 1.0)
    return Behavior(
        action=jnp.repeat(program.action[:, None], num_particles, axis=1),
        mode=jnp.repeat(program.mode[:, None], num_particles, axis=1),
        goal=exists
        * _by_relation(jnp.sum(goal * share[:, None, None], axis=0), program.region_relation[root]),
        constraint=exists
        * _by_relation(
            jnp.sum(constraint * weight[:, None], axis=0)[None],
            program.constraint_relation[root][None],
        ),
    )


def infer_behaviors(
    program: BehaviorProgram, worlds: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in every particle (section 3.3).

    Limits: a program of no phrases has no goal; a world without the object has goals that sum to
    nearly nothing. Empty object slots and padded phrases change nothing.

    Args:
        program: one clause.
        worlds: the particles' objects, leaves [..., P]; at most 15 slots with the robot's.
        num_phrases: how many phrases to infer, at least those of the program: the largest of a
            batch. It is a trip count, so padding costs nothing.

    Returns:
        The behaviors, leaves [..., P].
    """
    scene = _scene(worlds)
    height, num_particles = program.child.shape[0], scene.robot.shape[-1]
    beam = Beam(
        sets=jnp.zeros((height, 3 + NUM_SLOTS, BEAM, num_particles), jnp.int32),
        cost=jnp.zeros((height, BEAM, num_particles), jnp.float32),
    )
    trips = jnp.asarray(num_phrases, jnp.int32) - 1
    beam = jax.lax.fori_loop(
        0, trips, lambda phrase, carry: _advance(program, scene, carry, phrase), beam
    )
    root = jnp.maximum(program.num_phrases - 1, 0)
    return _conclude(program, scene, _join(program, beam, root), root)


def infer_behavior(
    program: BehaviorProgram, world: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in one world; see ``infer_behaviors``.

    Args:
        program: one clause.
        world: its objects.
        num_phrases: how many phrases to infer, at least those of the program.

    Returns:
        The behavior.
    """
    worlds = jax.tree.map(lambda leaf: leaf[..., None], world)
    behaviors = infer_behaviors(program, worlds, num_phrases=num_phrases)
    return jax.tree.map(lambda leaf: leaf[..., 0], behaviors)
