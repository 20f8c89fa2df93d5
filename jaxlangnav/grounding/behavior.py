"""Behavior inference in the particles (section 3.3): the DCG on the device, a beam four wide.

Words are gone (``program``); what is left per particle is look-ups by type, adds and k-best. Sets
of objects are bit masks, so joining children, and finding what lies in regions, is a few integer
operations. The four best sets of independent factors have a closed form: none, the smallest margin
flipped, the second smallest, and the cheaper of the third smallest and the two smallest together.

Phrases come bottom-up, so the hypotheses of a phrase's children lie on top of a stack, a shift
register that needs no look-up. Equal sets that rest on different child hypotheses stay apart.
Arrays carry two lane axes **last**, episodes E and particles P, so that every operation is a
vector operation over lanes; ``vmap`` over episodes is told to put its axis there.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.behavior_odds import (
    Combinations,
    ObjectSets,
    build_object_sets,
    constraint_odds,
    iota,
    lying_in,
    object_odds,
    pick_of_four,
    region_odds,
    smallest,
    to_mask,
)
from jaxlangnav.grounding.program import (
    MAX_DEPTH,
    NUM_CHILDREN,
    NUM_PHRASES,
    NUM_REGION_SLOTS,
    OF_THE_CLAUSE,
    BehaviorProgram,
)
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.messages import NONE, Behavior, BehaviorWorld
from jaxlangnav.numerics.batching import materialize, select_row
from jaxlangnav.pytree import replace

_BEAM = 4
_DEAD = 1e6
"""Cost of a hypothesis that does not exist."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (2, 0), (3, 0))
"""Pairs of two sorted lists of four among which the four best sums are."""
_OBJECTS, _REGIONS, _CONSTRAINTS, _LIES = 0, 1, 1 + NUM_REGION_SLOTS, 2 + NUM_REGION_SLOTS
"""Rows of ``_Stack.sets``."""


class _Stack(NamedTuple):
    """Hypotheses of phrases whose parent is still to come; the last one first."""

    sets: Array  # i32[D, 5, 4, E, P] objects, regions by slot, constraints, and what lies there
    cost: Array  # f32[D, 4, E, P] −log-probability, ascending


class _Expressed(NamedTuple):
    """What a phrase may express, given each of the four best combinations of its children."""

    odds: Array  # f32[4, 3 N, E, P] log-odds: objects (of a verb: constraints), regions by slot
    cost: Array  # f32[4, E, P] of the combinations


def _child(row: BehaviorProgram, stack: _Stack, k: Array | int) -> Combinations:
    """Read the hypotheses of a phrase's k-th child from the top as if it were the only one."""
    exists = row.num_children > k
    sets = jnp.where(exists, stack.sets[k], 0)
    objects, regions = sets[_OBJECTS], sets[_REGIONS : _REGIONS + NUM_REGION_SLOTS]
    slots = jnp.append(row.region_from[k], row.constraint_region[k][None], axis=0)
    held = [jnp.where(slots == i, one[:, None], 0) for i, one in enumerate(regions)]
    by_slot = functools.reduce(jnp.bitwise_or, held)
    touched = functools.reduce(jnp.bitwise_or, [objects, *regions])
    kept = jnp.where(row.constraint_from[k] == NONE, 0, sets[_CONSTRAINTS])
    outside = jnp.where(row.is_restrictor[k] & exists, ~sets[_LIES], 0)
    first = jnp.where(iota(_BEAM, 3) == 0, 0.0, _DEAD).astype(jnp.float32)
    return Combinations(
        sets=jnp.concatenate([jnp.stack([objects, touched, kept, outside], axis=1), by_slot], 1),
        cost=jnp.where(exists, stack.cost[k], first),
    )


def _combine(left: Combinations, right: Combinations) -> Combinations:
    """Keep the four best combinations of two sorted lists of hypotheses, exactly."""
    left_cost, right_cost = jnp.unstack(left.cost), jnp.unstack(right.cost)
    cost = jnp.stack([left_cost[i] + right_cost[j] for i, j in _PAIRS])
    values, places = smallest(cost, _BEAM)
    place = jnp.stack(places)
    i = jnp.where(place < 4, 0, jnp.where(place < 6, 1, place - 4))
    j = jnp.where(place < 4, place, jnp.where(place == 5, 1, 0))
    return Combinations(
        sets=pick_of_four(left.sets, i[:, None]) | pick_of_four(right.sets, j[:, None]),
        cost=jnp.stack(values),
    )


def _four_best_sets(odds: Array, cost: Array, size: int) -> tuple[Array, Array]:
    """Find the four best sets over the four combinations of the children.

    By log-odds f32[4, (1 + L) N, E, P] of objects (or constraints) and regions by slot, and costs
    f32[4, E, P] of the combinations: masks i32[4, 1 + L, E, P] and their costs, best first.
    """
    margin = jnp.abs(odds)
    # Σ log(1 + e^−m) as one logarithm of a product: up to 2^60 fits float32.
    base = cost + jnp.log(jnp.prod(1.0 + jnp.exp(-margin), axis=-3))
    (m1, m2, m3), (f1, f2, f3) = smallest(margin, 3)
    is_pair = (m1 + m2 < m3).astype(jnp.int32)
    costs = jnp.concatenate([base, base + m1, base + m2, base + jnp.minimum(m3, m1 + m2)])
    values, places = smallest(costs, _BEAM)
    place = jnp.stack(places)
    kind, combination = place >> 2, place & 3
    pair = (kind == 3) & (pick_of_four(is_pair, combination) == 1)
    flips = (
        jnp.where((kind == 1) | pair, pick_of_four(f1, combination), NONE),
        jnp.where((kind == 2) | pair, pick_of_four(f2, combination), NONE),
        jnp.where((kind == 3) & ~pair, pick_of_four(f3, combination), NONE),
    )
    masks = to_mask(odds.reshape(_BEAM, -1, size, *odds.shape[-2:]) > 0)  # [4, 1 + L, E, P]
    first = size * jnp.arange(masks.shape[1], dtype=jnp.int32)[:, None, None]
    chosen = pick_of_four(masks, combination[:, None])
    for flip in flips:
        bit = flip[:, None] - first
        is_here = (bit >= 0) & (bit < size)
        chosen = chosen ^ jnp.where(is_here, jnp.left_shift(1, jnp.clip(bit, 0, size - 1)), 0)
    return chosen, jnp.stack(values)


def _push_phrase(stack: _Stack, top: _Stack, num_children: Array) -> _Stack:
    """Put a phrase's hypotheses (depth 1) where its children's were."""

    def shifted(old: Array, new: Array) -> Array:
        rows = old  # of a padded row
        for count in range(NUM_CHILDREN + 1):
            left = [old[count:], *[old[-1:]] * count]
            rows = jnp.where(num_children == count, jnp.concatenate([new, *left])[:MAX_DEPTH], rows)
        return rows

    return jax.tree.map(shifted, stack, top)


MAX_SLOTS = 31
"""Object slots, the robot's included: a bit mask and a sorted list of factors hold them."""
ROOT = -1
"""Row of the root in a program: the last one, however many phrases there are."""


def _advance(row: BehaviorProgram, scene: ObjectSets, stack: _Stack) -> tuple[_Stack, _Expressed]:
    """Infer one phrase from its children."""
    size = scene.lies.shape[1]
    # As many times as some lane has children; the loop also keeps the compiler from computing
    # the same values anew inside every later fusion.
    joined = jax.lax.fori_loop(
        1,
        jnp.max(row.num_children),
        lambda k, left: _combine(left, _child(row, stack, k)),
        _child(row, stack, 0),
    )
    # A phrase expresses objects or constraints, never both: they share the first N symbols.
    first = jax.lax.cond(
        jnp.any(row.is_verb),
        lambda noun: jnp.where(row.is_verb, constraint_odds(row, scene, joined, size), noun),
        lambda noun: noun,
        object_odds(row, scene, joined, size),
    )
    regions = region_odds(row, scene, joined, size)
    odds = jnp.concatenate([first[:, None], regions], axis=1)
    odds = materialize(odds.reshape(_BEAM, -1, *odds.shape[-2:]))
    sets, cost = materialize(_four_best_sets(odds, joined.cost, size))
    both, places = sets[:, 0], sets[:, 1:]
    objects, constraints = jnp.where(row.is_verb, 0, both), jnp.where(row.is_verb, both, 0)
    lies = lying_in(row, scene, places)
    found = jnp.stack([objects, *jnp.unstack(places, axis=1), constraints, lies])
    top = materialize(_Stack(found[None], cost[None]))
    return _push_phrase(stack, top, row.num_children), _Expressed(odds, joined.cost)


def _by_relation(values: Array, relation: Array) -> Array:
    """Spread slots f32[L, N, E, P] over the seven regions, f32[7, N, E, P]."""
    regions = iota(NUM_REGIONS, 3)[:, None]
    spread = [
        jnp.where(own == regions, one[None], 0.0) for own, one in zip(relation, values, strict=True)
    ]
    return functools.reduce(jnp.add, spread)


def _conclude(program: BehaviorProgram, root: _Expressed, size: int) -> Behavior:
    """Read the behavior off the root, averaged over the combinations of its children.

    A behavior has one goal: the probability that any goal is expressed is shared in proportion
    to the probability of each.
    """

    def mean(values: Array, weight: Array) -> Array:
        return functools.reduce(jnp.add, jnp.unstack(values * weight))

    lanes = root.cost.shape[1:]
    # Written out: XLA's logistic, and its sums over a short leading axis, are scalar on CPU.
    probability = materialize(1.0 / (1.0 + jnp.exp(-root.odds)))
    constraint, goal = probability[:, :size], probability[:, size:]
    goal = goal.reshape(_BEAM, NUM_REGION_SLOTS, size, *lanes)
    is_none = jnp.prod(functools.reduce(jnp.multiply, jnp.unstack(1.0 - goal, axis=1)), axis=1)
    total = jnp.sum(functools.reduce(jnp.add, jnp.unstack(goal, axis=1)), axis=1)
    exists = jnp.where(program.num_phrases == 0, 0.0, 1.0)
    weight = exists * jax.nn.softmax(-root.cost, axis=0)
    share = weight * (1.0 - is_none) / jnp.maximum(total, 1e-9)
    by_slot = materialize((mean(goal, share[:, None, None]), mean(constraint, weight[:, None])))
    return Behavior(
        action=jnp.broadcast_to(program.action, (program.action.shape[0], *lanes)),
        mode=jnp.broadcast_to(program.mode, (program.mode.shape[0], *lanes)),
        goal=_by_relation(by_slot[0], program.region_relation[ROOT]),
        constraint=_by_relation(by_slot[1][None], program.constraint_relation[ROOT][None]),
    )


def _infer_lanes(program: BehaviorProgram, worlds: BehaviorWorld, num_phrases: Array) -> Behavior:
    """Infer behaviors with leaves [..., E, 1] of the program and [..., E, P] of the worlds."""
    scene = build_object_sets(program, worlds)
    size, *lanes = scene.lies.shape[1:]
    stack = _Stack(
        sets=jnp.zeros((MAX_DEPTH, 3 + NUM_REGION_SLOTS, _BEAM, *lanes), jnp.int32),
        cost=jnp.zeros((MAX_DEPTH, _BEAM, *lanes), jnp.float32),
    )
    nothing = _Expressed(
        odds=jnp.zeros((_BEAM, (1 + NUM_REGION_SLOTS) * size, *lanes), jnp.float32),
        cost=stack.cost[0],
    )
    rows = {
        field.name: getattr(program, field.name)
        for field in dataclasses.fields(program)
        if field.name not in OF_THE_CLAUSE
    }

    def infer(index: Array, carry: tuple[_Stack, _Expressed]) -> tuple[_Stack, _Expressed]:
        # The root comes last in every lane, however many phrases a lane has.
        phrase = jnp.where(index == num_phrases - 1, NUM_PHRASES - 1, index)
        row = replace(program, **select_row(rows, phrase))
        return _advance(row, scene, carry[0])

    # The phrases bottom-up.
    _, root = jax.lax.fori_loop(0, num_phrases, infer, (stack, nothing))
    return _conclude(program, root, size)


@jax.custom_batching.custom_vmap
def _infer(program: BehaviorProgram, worlds: BehaviorWorld, num_phrases: Array) -> Behavior:
    """Infer behaviors of one episode: leaves [...] of the program and [..., P] of the worlds."""
    program = jax.tree.map(lambda leaf: leaf[..., None, None], program)
    worlds = jax.tree.map(lambda leaf: leaf[..., None, :], worlds)
    # Lanes stand last everywhere, so aligning shapes from the right is what is meant.
    with jax.numpy_rank_promotion("allow"):
        behavior = _infer_lanes(program, worlds, num_phrases)
    return jax.tree.map(lambda leaf: leaf[..., 0, :], behavior)


@_infer.def_vmap
def _infer_episodes(
    axis_size: int,
    in_batched: Any,
    program: BehaviorProgram,
    worlds: BehaviorWorld,
    num_phrases: Array,
) -> tuple[Behavior, Behavior]:
    """Infer behaviors of a batch of episodes, whose axis becomes a lane axis."""

    def of_program(leaf: Array, is_batched: bool) -> Array:
        return (jnp.moveaxis(leaf, 0, -1) if is_batched else leaf[..., None])[..., None]

    def of_worlds(leaf: Array, is_batched: bool) -> Array:
        return jnp.moveaxis(leaf, 0, -2) if is_batched else leaf[..., None, :]

    program = jax.tree.map(of_program, program, in_batched[0])
    worlds = jax.tree.map(of_worlds, worlds, in_batched[1])
    shape = (axis_size, max(leaf.shape[-1] for leaf in jax.tree.leaves(worlds)))
    worlds = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (*leaf.shape[:-2], *shape)), worlds)
    with jax.numpy_rank_promotion("allow"):
        behavior = _infer_lanes(program, worlds, jnp.max(num_phrases))
    behavior = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), behavior)
    return behavior, jax.tree.map(lambda _: True, behavior)


def infer_behaviors(
    program: BehaviorProgram, worlds: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in every particle (section 3.3), leaves [..., P].

    Limits: a program of no phrases has no goal; a world without the object has goals that sum to
    nearly nothing. Empty object slots and padded phrases change nothing.

    Args:
        program: one clause.
        worlds: the particles' objects, leaves [..., P]; at most ``MAX_SLOTS`` with the robot's.
        num_phrases: how many phrases to infer, at least those of the program. It is a trip
            count, so padding costs nothing; a batch of episodes takes the largest.

    Raises:
        ValueError: there are more object slots than the bit masks hold.
    """
    size = worlds.object_type.shape[0]
    if size > MAX_SLOTS:
        raise ValueError(f"{size} object slots, but bit masks hold at most {MAX_SLOTS}")
    edges = worlds.is_related, worlds.is_superlative, worlds.is_later
    chex.assert_shape([worlds.object_type, worlds.is_object, worlds.is_previous], (size, None))
    chex.assert_shape(edges, (NUM_RELATIONS, size, size, None))
    chex.assert_type([worlds.object_type, worlds.is_object, worlds.is_previous], [int, bool, bool])
    chex.assert_type(edges, bool)
    chex.assert_shape(program.regions, (NUM_PHRASES, None, NUM_REGION_SLOTS))
    chex.assert_type([program.objects, program.regions], jnp.float32)
    return _infer(program, worlds, jnp.asarray(num_phrases, jnp.int32))


def infer_behavior(
    program: BehaviorProgram, world: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in one world; see ``infer_behaviors``."""
    worlds = jax.tree.map(lambda leaf: leaf[..., None], world)
    behaviors = infer_behaviors(program, worlds, num_phrases=num_phrases)
    return jax.tree.map(lambda leaf: leaf[..., 0], behaviors)
