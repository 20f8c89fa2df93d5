"""Behavior inference in plain NumPy: the same program, beam and answer as ``infer_behaviors``.

Worlds are the first axis, P of them at once, or one after the other as a first implementation
would. Sets are boolean arrays. B hypotheses of the beam, N object slots, L region slots.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.grounding.beam import BEAM
from jaxlangnav.grounding.program import AT_TABLE, LOG_NEVER, NUM_REGION_SLOTS
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.kinds import fits
from jaxlangnav.messages import NONE, ROBOT

Program = Any
"""A ``BehaviorProgram`` whose leaves are NumPy arrays."""


class Worlds(NamedTuple):
    """The fields of ``BehaviorWorld``, with the worlds first."""

    object_type: np.ndarray  # i32[P, N]
    is_object: np.ndarray  # bool[P, N]
    is_related: np.ndarray  # bool[P, 6, N, N]
    is_superlative: np.ndarray  # bool[P, 6, N, N]
    is_later: np.ndarray  # bool[P, 6, N, N]
    is_previous: np.ndarray  # bool[P, N]


class Sets(NamedTuple):
    """What a phrase may express, likeliest first."""

    objects: np.ndarray  # bool[P, B, N]
    regions: np.ndarray  # bool[P, B, L, N]
    constraints: np.ndarray  # bool[P, B, N]
    lies: np.ndarray  # bool[P, B, N] objects in the regions
    cost: np.ndarray  # f[P, B] −log-probability


class Joined(NamedTuple):
    """The best combinations of what the children express, as the phrase sees them."""

    objects: np.ndarray  # bool[P, B, N]
    same: np.ndarray  # bool[P, B, L, N]
    touched: np.ndarray  # bool[P, B, N]
    near: np.ndarray  # bool[P, B, N]
    kept: np.ndarray  # bool[P, B, N]
    lies: np.ndarray  # bool[P, B, N]
    cost: np.ndarray  # f[P, B]


def _tables(program: Program, world: Worlds) -> list[np.ndarray]:
    """Find what lies where, bool[P, N, N] per table of the program: figure, landmark."""
    itself = np.eye(world.object_type.shape[1], dtype=bool) & world.is_object[:, :, None]
    tables = []
    for number in program.table:
        kind, relation = divmod(int(number), NUM_RELATIONS)
        if number == AT_TABLE:
            tables.append(itself)
        else:
            source = {0: world.is_related, 1: world.is_superlative}.get(kind, world.is_later)
            tables.append(source[:, relation])
    return tables


def _slot(regions: np.ndarray, slot: int) -> np.ndarray:
    """Take the regions of a slot; none where there is no such slot."""
    return regions[:, :, slot] if slot != NONE else np.zeros_like(regions[:, :, 0])


def _join(program: Program, row: int, children: list[Sets], like: np.ndarray) -> Joined:
    """Combine the hypotheses of the children; the last child comes first."""
    worlds, size = like.shape
    nothing = np.zeros((worlds, 1, size), bool)
    joined = Joined(
        objects=nothing,
        same=np.zeros((worlds, 1, NUM_REGION_SLOTS, size), bool),
        touched=nothing,
        near=nothing,
        kept=nothing,
        lies=~nothing,
        cost=np.zeros((worlds, 1)),
    )
    for k, child in enumerate(children):
        same = [_slot(child.regions, int(s)) for s in program.region_from[row, k]]
        own = Joined(
            objects=child.objects,
            same=np.stack(same, axis=2),
            touched=child.objects | child.regions.any(axis=2),
            near=_slot(child.regions, int(program.constraint_region[row, k])),
            kept=child.constraints & bool(program.constraint_from[row, k] != NONE),
            lies=child.lies | ~bool(program.is_restrictor[row, k]),
            cost=child.cost,
        )
        joined = _pair(joined, own)
    return joined


def _pair(left: Joined, right: Joined) -> Joined:
    """Keep the best combinations of two lists."""
    cost = (left.cost[:, :, None] + right.cost[:, None, :]).reshape(len(left.cost), -1)
    best = np.argsort(cost, axis=1, kind="stable")[:, :BEAM]
    i, j = np.divmod(best, right.cost.shape[1])
    rows = np.arange(len(cost))[:, None]

    def union(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return one[rows, i] | other[rows, j]

    return Joined(
        objects=union(left.objects, right.objects),
        same=union(left.same, right.same),
        touched=union(left.touched, right.touched),
        near=union(left.near, right.near),
        kept=union(left.kept, right.kept),
        lies=left.lies[rows, i] & right.lies[rows, j],
        cost=cost[rows, best],
    )


def _object_odds(
    program: Program, world: Worlds, own: np.ndarray, joined: Joined, row: int
) -> np.ndarray:
    """Evaluate the log-odds of the objects, f[P, B, N]."""
    previous = world.is_previous & world.is_object
    has = previous.any(axis=1, keepdims=True)
    kind = np.max(np.where(previous, world.object_type, NONE - 9), axis=1, keepdims=True)
    alike = (world.object_type == kind) & world.is_object & ~previous
    weight = program.object_previous[row]
    base = np.where(own, program.object_named[row], program.object_unnamed[row])
    base = base + weight[0] * (own & previous) + weight[1] * previous + weight[2] * alike
    base += weight[3] * (has & world.is_object & ~previous & ~alike) + weight[4] * ~has
    base = np.where(world.is_object, base, LOG_NEVER)[:, None]
    there = np.where(joined.lies, program.object_lies[row], program.object_outside[row])
    inside = np.where(
        joined.objects, program.object_inside[row] + there, program.object_absent[row]
    )
    return base + inside + program.object_own_lies[row] * (own[:, None] & joined.lies)


def _region_odds(
    program: Program, world: Worlds, own: np.ndarray, joined: Joined, row: int
) -> np.ndarray:
    """Evaluate the log-odds of the regions, f[P, B, L, N]."""
    robot = world.object_type == ROBOT
    odds = []
    for s in range(NUM_REGION_SLOTS):
        same, inside = joined.same[:, :, s], joined.objects
        base = program.region_base[row, s] + program.region_own[row, s] * own
        base = np.where(world.is_object, base + program.region_robot[row, s] * robot, LOG_NEVER)
        odds.append(
            base[:, None]
            + program.region_inside[row, s] * inside
            + program.region_same[row, s] * same
            + program.region_absent[row, s] * ~(inside | same)
        )
    return np.stack(odds, axis=2)


def _constraint_odds(program: Program, world: Worlds, joined: Joined, row: int) -> np.ndarray:
    """Evaluate the log-odds of the constraints, f[P, B, N]."""
    touched, kept = joined.touched, joined.kept
    base = np.where(world.is_object, program.constraint_base[row], LOG_NEVER)[:, None]
    odds = base + program.constraint_same[row] * joined.near
    odds = odds + program.constraint_inside[row] * joined.objects
    odds += np.where(touched, program.constraint_touched[row], program.constraint_untouched[row])
    odds += program.constraint_new[row] * (touched & ~kept) + program.constraint_kept[row] * kept
    return odds


def _best_sets(odds: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the best sets over all combinations: bool[P, B, S] and f[P, B]."""
    margin = np.abs(odds)
    order = np.argpartition(margin, 2, axis=2)[:, :, :3]
    least = np.take_along_axis(margin, order, axis=2)
    sort = np.argsort(least, axis=2)
    order, least = (np.take_along_axis(values, sort, axis=2) for values in (order, least))
    base = cost + np.log1p(np.exp(-margin)).sum(axis=2)
    m1, m2, m3 = np.moveaxis(least, 2, 0)
    is_pair = m1 + m2 < m3
    costs = np.stack([base, base + m1, base + m2, base + np.minimum(m3, m1 + m2)], axis=1)
    costs = costs.reshape(len(cost), -1)
    best = np.argsort(costs, axis=1, kind="stable")[:, :BEAM]
    kind, combination = np.divmod(best, cost.shape[1])
    rows = np.arange(len(cost))[:, None]
    expressed = (odds > 0)[rows, combination]
    pair = (kind == 3) & is_pair[rows, combination]
    flips = ((kind == 1) | pair, (kind == 2) | pair, (kind == 3) & ~pair)
    for number, is_flipped in enumerate(flips):
        where = order[rows, combination, number]
        world, beam = np.nonzero(is_flipped)
        expressed[world, beam, where[world, beam]] ^= True
    return expressed, costs[rows, best]


def infer(program: Program, world: Worlds) -> tuple[np.ndarray, np.ndarray]:
    """Infer the goals and constraints of one clause in P worlds.

    Args:
        program: leaves [H, ...].
        world: the worlds.

    Returns:
        f[P, 7, N] each.
    """
    size = world.object_type.shape[1]
    tables, stack = _tables(program, world), []
    kind = world.object_type
    rows = [*range(int(program.num_phrases) - 1), len(program.num_children) - 1]
    for row in rows:
        count = int(program.num_children[row])
        children = [stack.pop() for _ in range(count)]
        own = fits(kind[..., None], program.own[row]).any(-1) & world.is_object
        joined = _join(program, row, children, kind)
        regions = _region_odds(program, world, own, joined, row)
        if row == rows[-1]:
            return _conclude(
                program, joined, regions, _constraint_odds(program, world, joined, row)
            )
        is_verb = bool(program.is_verb[row])
        first = (
            _constraint_odds(program, world, joined, row)
            if is_verb
            else _object_odds(program, world, own, joined, row)
        )
        odds = np.concatenate([first[:, :, None], regions], axis=2)
        expressed, cost = _best_sets(odds.reshape(*odds.shape[:2], -1), joined.cost)
        expressed = expressed.reshape(*expressed.shape[:2], -1, size)
        lies = np.zeros_like(expressed[:, :, 0])
        for s, table in enumerate(program.region_table[row]):
            if table != NONE:
                lies |= np.einsum("pij,pbj->pbi", tables[table], expressed[:, :, 1 + s])
        first, none = expressed[:, :, 0], np.zeros_like(lies)
        objects, constraints = (none, first) if is_verb else (first, none)
        stack.append(Sets(objects, expressed[:, :, 1:], constraints, lies, cost))
    raise AssertionError("a program has at least its root")


def _conclude(
    program: Program, joined: Joined, regions: np.ndarray, constraints: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Average goals and constraints over the combinations of the root's children."""
    goal, constraint = (1.0 / (1.0 + np.exp(-np.clip(x, -80, 80))) for x in (regions, constraints))
    weight = np.exp(joined.cost.min(axis=1, keepdims=True) - joined.cost)
    weight /= weight.sum(axis=1, keepdims=True)
    is_none = np.prod(1.0 - goal, axis=(2, 3))
    share = weight * (1.0 - is_none) / np.maximum(goal.sum(axis=(2, 3)), 1e-9)
    by_slot = np.einsum("pbln,pb->pln", goal, share)
    found = np.zeros((2, len(goal), NUM_REGIONS, goal.shape[-1]))
    for s, relation in enumerate(program.region_relation[-1]):
        if relation != NONE:
            found[0][:, relation] += by_slot[:, s]
    relation = int(program.constraint_relation[-1])
    if relation != NONE:
        found[1][:, relation] = np.einsum("pbn,pb->pn", constraint, weight)
    return found[0], found[1]
