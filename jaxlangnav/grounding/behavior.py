"""Behavior inference per particle (section 3.3): beam search of width 4 over phrases, on device.

Words are contracted beforehand (``program``), which leaves table look-ups, sums and k-best. Sets
of objects are bit masks, so joining children, and finding the objects in regions, is a few integer
operations. The four best sets of independent factors have a closed form: none, the smallest margin
flipped, the second smallest, and the cheaper of the third smallest and the two smallest together.

Phrases come bottom-up, so the hypotheses of a phrase's children lie on top of a stack, a shift
register that needs no look-up. Equal sets that rest on different child hypotheses stay apart.
Arrays carry two lane axes **last**, episodes E and particles P, so that every operation is a
vector operation over lanes; a rule of ``vmap`` puts its axis there.
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
    object_odds,
    objects_in,
    region_odds,
    smallest_with_index,
    take_of_beam,
    to_mask,
)
from jaxlangnav.grounding.program import (
    CLAUSE_FIELDS,
    MAX_DEPTH,
    NUM_CHILDREN,
    NUM_PHRASES,
    NUM_REGION_SLOTS,  # relations that a phrase may express at once
    CompiledClause,
)
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.inputs.object_types import label_of  # type code without attribute bits
from jaxlangnav.messages import NONE, Behavior, BehaviorWorld
from jaxlangnav.numerics.batching import materialize, select_row
from jaxlangnav.pytree import replace

_BEAM = 4
_COST_EMPTY = 1e6  # cost of a hypothesis that does not exist
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (2, 0), (3, 0))
"""Index pairs into two sorted lists of four that include the four smallest sums."""
_OBJECTS, _REGIONS, _CONSTRAINTS, _LOCATED = 0, 1, 1 + NUM_REGION_SLOTS, 2 + NUM_REGION_SLOTS
"""Indices into ``_Stack.sets``."""


class _Stack(NamedTuple):
    """Beam hypotheses of phrases whose parent has not been processed yet; the latest first."""

    sets: Array  # i32[D, 5, 4, E, P] objects, regions by relation slot, constraints, located
    cost: Array  # f32[D, 4, E, P] −log-probability, ascending


class _SymbolOdds(NamedTuple):
    """Log-odds of a phrase's symbols, given each of the four best combinations of its children."""

    log_odds: Array  # f32[4, 3 N, E, P] objects (of a verb: constraints), regions by relation
    cost: Array  # f32[4, E, P] of the combinations


def _child_beam(phrase: CompiledClause, stack: _Stack, k: Array | int) -> Combinations:
    """Read a phrase's k-th child from the stack as a combination by itself."""
    exists = phrase.num_children > k
    sets = jnp.where(exists, stack.sets[k], 0)
    objects, regions = sets[_OBJECTS], sets[_REGIONS : _REGIONS + NUM_REGION_SLOTS]
    slots = jnp.append(phrase.child_region_slot[k], phrase.constraint_region_slot[k][None], axis=0)
    in_slot = [jnp.where(slots == i, sets_i[:, None], 0) for i, sets_i in enumerate(regions)]
    by_slot = functools.reduce(jnp.bitwise_or, in_slot)
    mentioned = functools.reduce(jnp.bitwise_or, [objects, *regions])
    constraints = jnp.where(phrase.child_constraint_slot[k] == NONE, 0, sets[_CONSTRAINTS])
    excluded = jnp.where(phrase.is_restrictor[k] & exists, ~sets[_LOCATED], 0)
    empty_cost = jnp.where(iota(_BEAM, 3) == 0, 0.0, _COST_EMPTY).astype(jnp.float32)
    return Combinations(
        sets=jnp.append(jnp.stack([objects, mentioned, constraints, excluded], 1), by_slot, axis=1),
        cost=jnp.where(exists, stack.cost[k], empty_cost),
    )


def _combine(left: Combinations, right: Combinations) -> Combinations:
    """Find the four best combinations of two sorted lists of hypotheses, exactly."""
    left_cost, right_cost = jnp.unstack(left.cost), jnp.unstack(right.cost)
    cost = jnp.stack([left_cost[i] + right_cost[j] for i, j in _PAIRS])
    values, indices = smallest_with_index(cost, _BEAM)
    pair = jnp.stack(indices)
    i = jnp.where(pair < 4, 0, jnp.where(pair < 6, 1, pair - 4))
    j = jnp.where(pair < 4, pair, jnp.where(pair == 5, 1, 0))
    sets = take_of_beam(left.sets, i[:, None]) | take_of_beam(right.sets, j[:, None])
    return Combinations(sets, jnp.stack(values))


def _four_best_sets(log_odds: Array, cost: Array, size: int) -> tuple[Array, Array]:
    """Find the four best sets over the four combinations of the children.

    By log-odds f32[4, (1 + L) N, E, P] of objects (or constraints) and regions by slot, and costs
    f32[4, E, P] of the combinations: masks i32[4, 1 + L, E, P] and their costs, best first.
    """
    margin = jnp.abs(log_odds)
    # Σ log(1 + e^−m) as one logarithm of a product: up to 2^93 (3 N factors, N ≤ 31) fits float32.
    base = cost + jnp.log(jnp.prod(1.0 + jnp.exp(-margin), axis=-3))
    (m1, m2, m3), (f1, f2, f3) = smallest_with_index(margin, 3)
    is_pair = (m1 + m2 < m3).astype(jnp.int32)
    costs = jnp.concatenate([base, base + m1, base + m2, base + jnp.minimum(m3, m1 + m2)])
    values, indices = smallest_with_index(costs, _BEAM)
    index = jnp.stack(indices)
    rank, combination = index >> 2, index & 3  # as ``costs`` lists them
    pair = (rank == 3) & (take_of_beam(is_pair, combination) == 1)
    flips = (
        jnp.where((rank == 1) | pair, take_of_beam(f1, combination), NONE),
        jnp.where((rank == 2) | pair, take_of_beam(f2, combination), NONE),
        jnp.where((rank == 3) & ~pair, take_of_beam(f3, combination), NONE),
    )
    masks = to_mask(log_odds.reshape(_BEAM, -1, size, *log_odds.shape[-2:]) > 0)  # [4, 1 + L, E, P]
    offset = size * jnp.arange(masks.shape[1], dtype=jnp.int32)[:, None, None]
    chosen = take_of_beam(masks, combination[:, None])
    for flip in flips:
        bit = flip[:, None] - offset
        in_mask = (bit >= 0) & (bit < size)
        chosen = chosen ^ jnp.where(in_mask, jnp.left_shift(1, jnp.clip(bit, 0, size - 1)), 0)
    return chosen, jnp.stack(values)


def _push_phrase(stack: _Stack, top: _Stack, num_children: Array) -> _Stack:
    """Replace the children's hypotheses on the stack by the phrase's, one entry."""

    def shifted(old: Array, new: Array) -> Array:
        entries = old  # of a padding phrase
        for count in range(NUM_CHILDREN + 1):
            pushed = jnp.concatenate([new, old[count:], *[old[-1:]] * count])[:MAX_DEPTH]
            entries = jnp.where(num_children == count, pushed, entries)
        return entries

    return jax.tree.map(shifted, stack, top)


MAX_SLOTS = 31
"""Object slots, the robot's included: a bit mask and a sorted list of factors hold them."""
ROOT = -1
"""Index of the root phrase in a clause: the last, however many phrases there are."""


def _reduce(phrase: CompiledClause, scene: ObjectSets, stack: _Stack) -> tuple[_Stack, _SymbolOdds]:
    """Infer the beam of one phrase from those of its children, and push it on the stack."""
    size = scene.in_region.shape[1]
    # The trip count is the maximum over lanes; the loop also keeps the compiler from recomputing
    # the same values inside every later fusion.
    joined = jax.lax.fori_loop(
        1,
        jnp.max(phrase.num_children),
        lambda k, joined: _combine(joined, _child_beam(phrase, stack, k)),
        _child_beam(phrase, stack, 0),
    )
    # A phrase expresses objects or constraints, never both: they share the first N symbols.
    leading = jax.lax.cond(
        jnp.any(phrase.is_verb),
        lambda noun: jnp.where(phrase.is_verb, constraint_odds(phrase, scene, joined, size), noun),
        lambda noun: noun,
        object_odds(phrase, scene, joined, size),
    )
    log_odds = jnp.concatenate([leading[:, None], region_odds(phrase, scene, joined, size)], axis=1)
    log_odds = materialize(log_odds.reshape(_BEAM, -1, *log_odds.shape[-2:]))
    best, cost = materialize(_four_best_sets(log_odds, joined.cost, size))
    regions, is_verb = best[:, 1:], phrase.is_verb
    objects, constraints = jnp.where(is_verb, 0, best[:, 0]), jnp.where(is_verb, best[:, 0], 0)
    located = objects_in(phrase, scene, regions)
    sets = jnp.stack([objects, *jnp.unstack(regions, axis=1), constraints, located])
    top = materialize(_Stack(sets[None], cost[None]))
    return _push_phrase(stack, top, phrase.num_children), _SymbolOdds(log_odds, joined.cost)


def _by_relation(values: Array, relation: Array) -> Array:
    """Scatter values of a phrase's L relations, f32[L, N, E, P], to all seven: f32[7, N, E, P]."""
    regions = iota(NUM_REGIONS, 3)[:, None]
    spread = [jnp.where(r == regions, v[None], 0.0) for r, v in zip(relation, values, strict=True)]
    return functools.reduce(jnp.add, spread)


def _root_marginals(clause: CompiledClause, root: _SymbolOdds, size: int) -> Behavior:
    """Compute the behavior marginals at the root, averaged over its children's combinations.

    A behavior has one goal: the probability that any goal is expressed is divided in proportion
    to the probability of each.
    """

    def mean(values: Array, weight: Array) -> Array:
        return functools.reduce(jnp.add, jnp.unstack(values * weight))

    batch_shape = root.cost.shape[1:]
    # Written out: XLA's logistic, and its sums over a short leading axis, are scalar on CPU.
    probability = materialize(1.0 / (1.0 + jnp.exp(-root.log_odds)))
    constraint, goal = probability[:, :size], probability[:, size:]
    goal = goal.reshape(_BEAM, NUM_REGION_SLOTS, size, *batch_shape)
    none_prob = jnp.prod(functools.reduce(jnp.multiply, jnp.unstack(1.0 - goal, axis=1)), axis=1)
    total = jnp.sum(functools.reduce(jnp.add, jnp.unstack(goal, axis=1)), axis=1)
    exists = jnp.where(clause.num_phrases == 0, 0.0, 1.0)
    weight = exists * jax.nn.softmax(-root.cost, axis=0)
    scale = weight * (1.0 - none_prob) / jnp.maximum(total, 1e-9)
    by_slot = materialize((mean(goal, scale[:, None, None]), mean(constraint, weight[:, None])))
    return Behavior(
        action=jnp.broadcast_to(clause.action, (clause.action.shape[0], *batch_shape)),
        mode=jnp.broadcast_to(clause.mode, (clause.mode.shape[0], *batch_shape)),
        goal=_by_relation(by_slot[0], clause.region_relation[ROOT]),
        constraint=_by_relation(by_slot[1][None], clause.constraint_relation[ROOT][None]),
    )


def _infer_lanes(clause: CompiledClause, worlds: BehaviorWorld, num_phrases: Array) -> Behavior:
    """Infer behaviors, given leaves [..., E, 1] of the clause and [..., E, P] of the worlds."""
    scene = build_object_sets(clause, worlds)
    size, *lanes = scene.in_region.shape[1:]
    sets = jnp.zeros((MAX_DEPTH, 3 + NUM_REGION_SLOTS, _BEAM, *lanes), jnp.int32)
    cost = jnp.zeros((MAX_DEPTH, _BEAM, *lanes), jnp.float32)
    log_odds = jnp.zeros((_BEAM, (1 + NUM_REGION_SLOTS) * size, *lanes), jnp.float32)
    start = _Stack(sets, cost), _SymbolOdds(log_odds, cost[0])
    phrases = {
        field.name: getattr(clause, field.name)
        for field in dataclasses.fields(clause)
        if field.name not in CLAUSE_FIELDS
    }

    def infer(index: Array, carry: tuple[_Stack, _SymbolOdds]) -> tuple[_Stack, _SymbolOdds]:
        # The root comes last in every lane, however many phrases a lane has.
        row = jnp.where(index == num_phrases - 1, NUM_PHRASES - 1, index)
        return _reduce(replace(clause, **select_row(phrases, row)), scene, carry[0])

    # Phrases are processed bottom-up.
    _, root = jax.lax.fori_loop(0, num_phrases, infer, start)
    return _root_marginals(clause, root, size)


@jax.custom_batching.custom_vmap
def _infer(clause: CompiledClause, worlds: BehaviorWorld, num_phrases: Array) -> Behavior:
    """Infer behaviors of one episode: leaves [...] of the clause and [..., P] of the worlds."""
    clause = jax.tree.map(lambda leaf: leaf[..., None, None], clause)
    worlds = jax.tree.map(lambda leaf: leaf[..., None, :], worlds)
    # Lanes stand last everywhere, so aligning shapes from the right is what is meant.
    with jax.numpy_rank_promotion("allow"):
        behavior = _infer_lanes(clause, worlds, num_phrases)
    return jax.tree.map(lambda leaf: leaf[..., 0, :], behavior)


@_infer.def_vmap
def _infer_episodes(
    size: int, in_batched: Any, clause: CompiledClause, worlds: BehaviorWorld, num_phrases: Array
) -> tuple[Behavior, Behavior]:
    """Infer behaviors of a batch of episodes, whose axis becomes a lane axis."""

    def of_clause(leaf: Array, is_batched: bool) -> Array:
        return (jnp.moveaxis(leaf, 0, -1) if is_batched else leaf[..., None])[..., None]

    def of_worlds(leaf: Array, is_batched: bool) -> Array:
        return jnp.moveaxis(leaf, 0, -2) if is_batched else leaf[..., None, :]

    clause = jax.tree.map(of_clause, clause, in_batched[0])
    worlds = jax.tree.map(of_worlds, worlds, in_batched[1])
    shape = (size, max(leaf.shape[-1] for leaf in jax.tree.leaves(worlds)))
    worlds = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (*leaf.shape[:-2], *shape)), worlds)
    with jax.numpy_rank_promotion("allow"):
        behavior = _infer_lanes(clause, worlds, jnp.max(num_phrases))
    behavior = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), behavior)
    return behavior, jax.tree.map(lambda _: True, behavior)


def infer_behaviors(
    clause: CompiledClause, worlds: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in every particle (section 3.3), leaves [..., P].

    Limits: a clause without phrases has no goal; without the object, goals sum to nearly zero.
    Empty object slots and padded phrases change nothing.

    Args:
        clause: compiled; traced.
        worlds: the particles' objects, leaves [..., P]; of more than ``MAX_SLOTS`` those that
            matter most are inferred (``most_relevant_slots``), and the others are 0.
        num_phrases: number of phrases to infer, at least the clause's. It is a trip count, so
            padding costs nothing; a batch of episodes takes the maximum.
    """
    size = worlds.object_type.shape[0]
    if size > MAX_SLOTS:
        choose = jax.vmap(most_relevant_slots, in_axes=(-1, None), out_axes=-1)
        worlds, slots = choose(worlds, label_of(clause.named_types.reshape(-1)))
        behavior = infer_behaviors(clause, worlds, num_phrases=num_phrases)
        lanes = jnp.arange(slots.shape[-1])[None]
        goal, constraint = (
            jnp.zeros((NUM_REGIONS, size, lanes.size)).at[:, slots, lanes].set(values)
            for values in (behavior.goal, behavior.constraint)
        )
        return replace(behavior, goal=goal, constraint=constraint)
    edges = worlds.is_related, worlds.is_superlative, worlds.is_ordinal
    chex.assert_shape([worlds.object_type, worlds.is_object, worlds.is_previous], (size, None))
    chex.assert_shape(edges, (NUM_RELATIONS, size, size, None))
    chex.assert_type([worlds.object_type, worlds.is_object, worlds.is_previous], [int, bool, bool])
    chex.assert_type(edges, bool)
    chex.assert_shape(clause.regions, (NUM_PHRASES, None, NUM_REGION_SLOTS))
    chex.assert_type([clause.objects, clause.regions], jnp.float32)
    return _infer(clause, worlds, jnp.asarray(num_phrases, jnp.int32))


def most_relevant_slots(world: BehaviorWorld, named: Array) -> tuple[BehaviorWorld, Array]:
    """Select the most relevant slots, as many as the bit masks of the behavior model can hold.

    Referents and the last goal come first, then objects of named types, i32[n] labels, then the
    rest; the robot stays the last. i32[MAX_SLOTS] are the selected slots.
    """
    object_type = world.object_type
    is_referred = jnp.any(world.is_related, axis=(0, 1)) | jnp.any(world.is_related, axis=(0, 2))
    is_named = (object_type >= 0) & jnp.any(label_of(object_type)[:, None] == named[None], axis=1)
    rank = jnp.where(world.is_object, 1 + 2 * is_named + 4 * (is_referred | world.is_previous), 0)
    order = jnp.argsort(-rank[:-1], stable=True)[: MAX_SLOTS - 1]
    slots = jnp.append(jnp.sort(order), object_type.shape[0] - 1)

    def select(leaf: Array) -> Array:  # of objects [N + 1], or of edges [6, N + 1, N + 1]
        return leaf[slots] if leaf.ndim == 1 else leaf[:, slots][:, :, slots]

    return jax.tree.map(select, world), slots


def infer_behavior(
    clause: CompiledClause, world: BehaviorWorld, *, num_phrases: Array | int
) -> Behavior:
    """Infer the distribution over behaviors in one world; see ``infer_behaviors``."""
    worlds = jax.tree.map(lambda leaf: leaf[..., None], world)
    behaviors = infer_behaviors(clause, worlds, num_phrases=num_phrases)
    return jax.tree.map(lambda leaf: leaf[..., 0], behaviors)
