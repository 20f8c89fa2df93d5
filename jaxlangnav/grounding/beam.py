"""The beam of behavior inference: hypotheses of phrases, four wide, on a stack (section 3.3).

Sets of objects are bit masks, so joining children is a few integer operations. The four best sets
of independent factors have a closed form: none, the smallest margin flipped, the second smallest,
and the cheaper of the third smallest and the two smallest together.

Phrases come bottom-up, so the hypotheses of a phrase's children lie on top of a stack; the stack
is a shift register, which needs no look-up. Arrays carry two lane axes **last**, episodes E and
particles P. Equal sets that rest on different child hypotheses stay apart.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.behavior_odds import Combinations, iota, pick_of_four, smallest, to_mask
from jaxlangnav.grounding.program import MAX_DEPTH, NUM_CHILDREN, NUM_REGION_SLOTS, BehaviorProgram
from jaxlangnav.messages import NONE

BEAM = 4
_DEAD = 1e6
"""Cost of a hypothesis that does not exist."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (2, 0), (3, 0))
"""Pairs of two sorted lists of four among which the four best sums are."""
OBJECTS_ROW, REGIONS_ROW, CONSTRAINTS_ROW, LIES_ROW = (
    0,
    1,
    1 + NUM_REGION_SLOTS,
    2 + NUM_REGION_SLOTS,
)
"""Rows of ``Stack.sets``."""


class Stack(NamedTuple):
    """Hypotheses of phrases whose parent is still to come; the last one first."""

    sets: Array  # i32[D, 5, 4, E, P] objects, regions by slot, constraints, and what lies there
    cost: Array  # f32[D, 4, E, P] −log-probability, ascending


class Expressed(NamedTuple):
    """What a phrase may express, given each of the four best combinations of its children."""

    odds: Array  # f32[4, 3 N, E, P] log-odds: objects (of a verb: constraints), regions by slot
    cost: Array  # f32[4, E, P] of the combinations


def _child(row: BehaviorProgram, stack: Stack, k: Array | int) -> Combinations:
    """Read the hypotheses of a phrase's k-th child from the top as if it were the only one."""
    exists = row.num_children > k
    sets = jnp.where(exists, stack.sets[k], 0)
    objects, regions = sets[OBJECTS_ROW], sets[REGIONS_ROW : REGIONS_ROW + NUM_REGION_SLOTS]
    slots = jnp.append(row.region_from[k], row.constraint_region[k][None], axis=0)
    by_slot = jnp.zeros((1, 1, 1, 1), jnp.int32)
    for slot in range(NUM_REGION_SLOTS):
        by_slot = by_slot | jnp.where(slots == slot, regions[slot][:, None], 0)
    touched = functools.reduce(jnp.bitwise_or, [objects, *regions])
    kept = jnp.where(row.constraint_from[k] == NONE, 0, sets[CONSTRAINTS_ROW])
    outside = jnp.where(row.is_restrictor[k] & exists, ~sets[LIES_ROW], 0)
    first = jnp.where(iota(BEAM, 3) == 0, 0.0, _DEAD).astype(jnp.float32)
    return Combinations(
        sets=jnp.concatenate([jnp.stack([objects, touched, kept, outside], axis=1), by_slot], 1),
        cost=jnp.where(exists, stack.cost[k], first),
    )


def _combine(left: Combinations, right: Combinations) -> Combinations:
    """Keep the four best combinations of two sorted lists of hypotheses, exactly."""
    left_cost, right_cost = jnp.unstack(left.cost), jnp.unstack(right.cost)
    cost = jnp.stack([left_cost[i] + right_cost[j] for i, j in _PAIRS])
    values, places = smallest(cost, BEAM)
    place = jnp.stack(places)
    i = jnp.where(place < 4, 0, jnp.where(place < 6, 1, place - 4))
    j = jnp.where(place < 4, place, jnp.where(place == 5, 1, 0))
    return Combinations(
        sets=pick_of_four(left.sets, i[:, None]) | pick_of_four(right.sets, j[:, None]),
        cost=jnp.stack(values),
    )


def join_children(row: BehaviorProgram, stack: Stack) -> Combinations:
    """Combine the hypotheses of all children of a phrase."""

    def add(k: Array, left: Combinations) -> Combinations:
        return _combine(left, _child(row, stack, k))

    # As many times as some lane has children; the loop also keeps the compiler from computing
    # the same values anew inside every later fusion.
    return jax.lax.fori_loop(1, jnp.max(row.num_children), add, _child(row, stack, 0))


def four_best_sets(odds: Array, cost: Array, size: int) -> tuple[Array, Array]:
    """Find the four best sets over the four combinations of the children.

    Args:
        odds: f32[4, (1 + L) N, E, P] log-odds of objects (or constraints) and regions by slot.
        cost: f32[4, E, P] of the combinations.
        size: N.

    Returns:
        Masks i32[4, 1 + L, E, P] and their costs f32[4, E, P], best first.
    """
    margin = jnp.abs(odds)
    # Σ log(1 + e^−m) as one logarithm of a product: up to 2^60 fits float32.
    base = cost + jnp.log(jnp.prod(1.0 + jnp.exp(-margin), axis=-3))
    (m1, m2, m3), (f1, f2, f3) = smallest(margin, 3)
    is_pair = (m1 + m2 < m3).astype(jnp.int32)
    costs = jnp.concatenate([base, base + m1, base + m2, base + jnp.minimum(m3, m1 + m2)])
    values, places = smallest(costs, BEAM)
    place = jnp.stack(places)
    kind, combination = place >> 2, place & 3
    pair = (kind == 3) & (pick_of_four(is_pair, combination) == 1)
    flips = (
        jnp.where((kind == 1) | pair, pick_of_four(f1, combination), NONE),
        jnp.where((kind == 2) | pair, pick_of_four(f2, combination), NONE),
        jnp.where((kind == 3) & ~pair, pick_of_four(f3, combination), NONE),
    )
    masks = to_mask(odds.reshape(BEAM, -1, size, *odds.shape[-2:]) > 0)  # [4, 1 + L, E, P]
    first = size * jnp.arange(masks.shape[1], dtype=jnp.int32)[:, None, None]
    chosen = pick_of_four(masks, combination[:, None])
    for flip in flips:
        bit = flip[:, None] - first
        is_here = (bit >= 0) & (bit < size)
        chosen = chosen ^ jnp.where(is_here, jnp.left_shift(1, jnp.clip(bit, 0, size - 1)), 0)
    return chosen, jnp.stack(values)


def push_phrase(stack: Stack, top: Stack, num_children: Array) -> Stack:
    """Put a phrase's hypotheses (depth 1) where its children's were."""

    def shifted(old: Array, new: Array) -> Array:
        rows = old  # of a padded row
        for count in range(NUM_CHILDREN + 1):
            left = [old[count:], *[old[-1:]] * count]
            rows = jnp.where(num_children == count, jnp.concatenate([new, *left])[:MAX_DEPTH], rows)
        return rows

    return Stack(shifted(stack.sets, top.sets), shifted(stack.cost, top.cost))
