"""Sample the grounding of one relation from its exact proposal distribution (eq. 7a).

Each annotated relation samples its figure and landmark jointly from the observed objects or from
new ones under a Dirichlet-process prior, and the metric constraint of a new one from the
relation's likelihood. The prior behind it: every thing mentioned exists once, anywhere in the
operating area A or where a relation places it; further objects of each type are scattered at a
density λ = α / A, with α as expected after what has been seen (``counts``). Against "all observed
objects are bystanders", the groundings weigh

    both observed     f(x_f − x_l) A / α²          figure new      E_f[m] / α
    landmark new      E_f[m] / α                   both new        u E_f[m]

(f the relation's density, m the probability of having missed something, u its mean over A), and
with no relation 1/α against u: the Dirichlet process, with "new" scaled by what is unexplored.
Expectations are taken by sampling the place itself from a density q, so that it weighs f m / q and
the total is an unbiased estimate of the evidence of the sentence given the observed map.

People err and mislead: with probability ε a relation says nothing about where its figure is, and
f is (1 − ε) times the relation's density plus ε / A. Without this the robot searches for ever for
a hydrant "in front of the cone" that stands behind it.

Everything takes one particle, or all of them with the particle axis last ("..." in shapes).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.messages import NONE
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.batching import append_axes, lookup, materialize, prepend_axes
from jaxlangnav.semantic_map.coverage import log_miss_at
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.candidates import (
    NUM_UNSEEN,
    Candidates,
    Draws,
    Grounding,
    Observed,
    Unexplored,
    list_candidates,
)
from jaxlangnav.semantic_map.proposal.enumerate import Proposals, proposal_layout, propose
from jaxlangnav.semantic_map.proposal.ranks import log_rank
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, LANDMARK, Query

_LOG_FLOOR = -60.0
PLURAL = 10.0
"""Who says "the second" or "the rightmost" speaks of several: so much likelier is an unseen one."""


def ground_relation(
    seen: Observed,
    query: Query,
    grounding: Grounding,
    draws: Draws,
    scene: Unexplored,
    *,
    params: MapParams,
) -> Grounding:
    """Ground one annotated relation of one particle's reading, given earlier ones (eq. 7a).

    The grounding is unchanged where the reading has no such relation.
    """
    # What other mentions refer to already is nothing that is called by no type.
    bits = jnp.where(grounding.slot == NONE, 0, jnp.left_shift(1, jnp.maximum(grounding.slot, 0)))
    taken = jax.lax.reduce_or(bits, axes=(0,))[None]
    excluded = query.excluded | jnp.where(is_anything(query.kind), taken, 0)
    query = materialize(_from_other(query._replace(excluded=excluded), grounding))
    ends = list_candidates(seen, query, grounding, scene, params=params)
    ways = materialize(propose(query, ends, draws, params.relations))
    num_known = ends.x.shape[1]
    rank = log_rank(query, ways.told, seen, draws, scene, params=params, num_known=num_known)
    log_weight = _weigh(query, ends, ways, rank, scene, params.misleading)
    choice, log_total = categorical.draw(log_weight, draws.choice)
    # One thing of each chain of relations has the uniform prior over the area: a figure grounded
    # earlier that is now placed against the robot gives its share back.
    is_placed = ~ends.is_open[FIGURE] & ~query.is_by_object
    both_open = ends.is_open[FIGURE] & ends.is_open[LANDMARK]
    log_root = jnp.where(both_open, -scene.log_area, jnp.where(is_placed, scene.log_area, 0.0))
    log_total = jnp.maximum(log_total + log_root, _LOG_FLOOR)
    # Where no grounding is possible (a drawn figure fell outside the area), the words stay a
    # hypothesis somewhere unexplored, of hardly any weight, that the next looks can refute.
    choice = jnp.where(log_total <= _LOG_FLOOR, log_weight.shape[0] - 1, choice)
    return _enter(grounding, query, ends, ways, choice, log_total)


def _from_other(query: Query, grounding: Grounding) -> Query:
    """See what lies between two landmarks from the other one, which is neither of the ends."""
    table = jnp.stack([grounding.x, grounding.y, grounding.slot.astype(jnp.float32)], axis=1)
    other = lookup(table, jnp.broadcast_to(query.other, table.shape[1:]))
    slot = jnp.where(query.is_between, other[2], NONE).astype(jnp.int32)
    taken = jnp.where(slot == NONE, 0, jnp.left_shift(1, slot))
    return query._replace(
        # In which direction the speaker looked counts for nothing then.
        viewer=jnp.where(query.is_between[None], other, query.viewer),
        excluded=query.excluded | taken[None],
    )


def _log_prior_known(ends: Candidates) -> Array:
    """Give pairs of known ends their prior, f32[(O + 1)², ...]; nothing is its own landmark."""
    size = ends.x.shape[1]
    log_prior = ends.log_prior[FIGURE][:, None] + ends.log_prior[LANDMARK][None]
    is_both = np.arange(size) < size - 1
    is_both = append_axes(jnp.asarray(is_both[:, None] & is_both[None]), log_prior.ndim)
    room = ((0, 1), (0, 1), *((0, 0),) * (log_prior.ndim - 2))
    log_prior = log_prior + jnp.where(is_both, jnp.pad(ends.log_alike, room), 0.0)
    # The last candidates are places decided earlier, not objects.
    is_same = jnp.asarray(np.diag(np.arange(size) < size - 1))
    log_prior = jnp.where(append_axes(is_same, log_prior.ndim), -jnp.inf, log_prior)
    return log_prior.reshape(size * size, *log_prior.shape[2:])


def _weigh(
    query: Query,
    ends: Candidates,
    ways: Proposals,
    log_rank: Array,
    scene: Unexplored,
    misleading: Array,
) -> Array:
    """Weigh all ways to ground a relation: prior · f m / q, f32[W, ...] log-weights."""
    size, ndim = ends.x.shape[1], ways.new_x.ndim
    known, new = slice(size * size), slice(size * size, None)
    log_area, log_unseen = prepend_axes(scene.log_area, ndim), prepend_axes(scene.log_unseen, ndim)
    log_density = query.log_density(*ways.told)
    is_told = (query.relation != NONE)[None]
    log_holds = jnp.where(is_told, jnp.log1p(-misleading), -jnp.inf) + log_rank
    log_misleads = jnp.where(is_told, jnp.log(misleading), 0.0)
    log_known = jnp.logaddexp(log_holds[known] + log_density[known], log_misleads - log_area)

    # One end new: the other's prior. Both: the landmark is uniform over the area, its share of
    # what is unexplored times A for the root of the chain.
    log_other = jnp.where(ends.is_open[:, None], ends.log_prior[::-1], -jnp.inf)
    log_other = log_other.reshape(2 * size, *log_other.shape[2:])
    is_open = (ends.is_open[FIGURE] & ends.is_open[LANDMARK])[None]
    log_both = jnp.where(is_open, log_unseen + log_area, -jnp.inf)
    log_each = [log_both - jnp.log(float(NUM_UNSEEN))] * NUM_UNSEEN
    log_new = _log_new(query, ways, log_density[new], scene) + log_holds[new]
    # That the relation says nothing is weighed in every particle and not drawn: a draw in twenty
    # leaves what it alone explains to two or three particles, which soon die out.
    log_free = log_misleads + log_unseen
    log_known = log_known + _log_prior_known(ends)
    log_new = log_new + jnp.concatenate([log_other, *log_each])
    log_free = log_free + jnp.concatenate([log_other, log_both])
    return jnp.concatenate([log_known, log_new, log_free])


def _log_new(query: Query, ways: Proposals, log_density: Array, scene: Unexplored) -> Array:
    """Compute log f m / q of what was drawn for the relation, f32[2 (O + 1) + NUM_UNSEEN, ...]."""
    log_miss = log_miss_at(scene.coverage, ways.new_x, ways.new_y, scene.first_row)
    # A new figure was drawn from f; a landmark from its figure's frame, not from its own.
    size = (log_miss.shape[0] - NUM_UNSEEN) // 2
    log_ratio = log_density[size : 2 * size] - ways.log_drawn
    log_landmark = log_miss[size : 2 * size] + log_ratio
    log_drawn = jnp.concatenate([log_miss[:size], log_landmark, log_miss[2 * size :]])
    # Drawn from all that is unseen, q is m / u A.
    log_anywhere = log_density + prepend_axes(scene.log_unseen + scene.log_area, log_miss.ndim)
    # There are several of the figures, not of what they are placed against.
    row = append_axes(jnp.arange(log_miss.shape[0]), log_miss.ndim)
    is_plural = query.is_order[None] & ((row < size) | (row >= 2 * size))
    log_anywhere = log_anywhere + jnp.where(is_plural, jnp.log(PLURAL), 0.0)
    return jnp.where(query.is_anywhere[None], log_anywhere, log_drawn)


def _enter(
    grounding: Grounding,
    query: Query,
    ends: Candidates,
    ways: Proposals,
    choice: Array,
    log_total: Array,
) -> Grounding:
    """Enter the chosen figure and landmark; ends decided earlier stay."""
    num_objects = ends.x.shape[1] - 1
    slots, hangs = proposal_layout(num_objects)
    slot = jnp.where(ends.is_open, jnp.asarray(slots)[:, choice], ends.earlier.slot)
    inherited = jnp.where(ends.is_open, NONE, ends.earlier.root)
    root = jnp.where(slot == NONE, inherited, slot)
    place = jnp.where(slot == NONE, num_objects + query.mention, slot)
    # What an order is about may be anywhere unseen: it lies at its landmark no more than elsewhere.
    is_hung = jnp.asarray(hangs)[:, choice] & (query.is_by_object & ~query.is_order)[None]
    x, y, landmark_x, landmark_y = (
        jnp.take_along_axis(leaf, choice[None], axis=0)[0] for leaf in ways.pairs
    )
    after = (
        slot,
        jnp.stack([x, landmark_x]),
        jnp.stack([y, landmark_y]),
        jnp.where(is_hung, place[::-1], NONE),
        jnp.where(is_hung, root[::-1], NONE),
        jnp.ones_like(ends.is_open),
    )
    is_valid = query.mention[FIGURE] != NONE
    is_decided = ends.is_open & is_valid[None]
    entered_by = jnp.where(is_decided & (query.kind >= 0), query.mention, NONE)
    mentions = append_axes(jnp.arange(grounding.slot.shape[0]), query.mention.ndim)
    is_figure, is_landmark = (mentions == entered_by[end][None] for end in (FIGURE, LANDMARK))
    # Of each mention, i32[M, ...]: 2 decided now as the figure, 1 as the landmark, or 0.
    source = jnp.where(is_figure, 2, is_landmark.astype(jnp.int32))

    def put(old: Array, new: Array) -> Array:
        of_end = (jnp.broadcast_to(new[end : end + 1], old.shape) for end in (LANDMARK, FIGURE))
        return jax.lax.select_n(source, old, *of_end)

    log_weight = grounding.log_weight + jnp.where(is_valid, log_total, 0.0)
    entered = [put(old, new) for old, new in zip(grounding[:-1], after, strict=True)]
    return Grounding(*entered, log_weight=log_weight)
