"""Sample the grounding of one relation from its exact proposal distribution (eq. 7a).

Each annotated relation samples its figure and landmark jointly from the observed objects or from
new ones under a Dirichlet-process prior, and the metric constraint of a new one from the
relation's likelihood. The prior: every object mentioned exists once, anywhere in the operating
area A or where a relation locates it; further objects of each type have a Poisson density
λ = α / A, with α the posterior expected count (``counts``). Relative to "no observed object is
mentioned", the groundings have weights

    both observed     f(x_f − x_l) A / α²          figure new      E_f[m] / α
    landmark new      E_f[m] / α                   both new        u E_f[m]

(f the relation's density, m the probability of having missed an object, u its mean over A), and
with no relation 1/α against u: the Dirichlet process, with "new" scaled by the unseen fraction.
Expectations are estimated by sampling the position from a density q, with weight f m / q, so the
total is an unbiased estimate of the evidence of the sentence given the observed map.

Annotations may be wrong: with probability ε a relation does not constrain its figure, so f is
(1 − ε) times the relation's density plus ε / A. Without this the robot would search forever for a
hydrant "in front of the cone" that is behind it.

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
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, LANDMARK, Query, weigh_by_robot

_MIN_LOG_TOTAL = -60.0


def ground_relation(
    seen: Observed,
    query: Query,
    robot_relations: Query,
    grounding: Grounding,
    draws: Draws,
    scene: Unexplored,
    *,
    params: MapParams,
) -> Grounding:
    """Sample the grounding of one relation in one particle, given earlier ones (eq. 7a).

    The grounding is unchanged if the particle's interpretation has no such relation. The
    ``robot_relations``, leaves [J, ...], weigh the ends that it grounds.
    """
    # The referent of another mention cannot also be the referent of an untyped one.
    bits = jnp.where(grounding.slot == NONE, 0, jnp.left_shift(1, jnp.maximum(grounding.slot, 0)))
    used = jax.lax.reduce_or(bits, axes=(0,))[None]
    excluded = query.excluded | jnp.where(is_anything(query.types), used, 0)
    query = materialize(_set_other_landmark(query._replace(excluded=excluded), grounding))
    ends = list_candidates(seen, query, grounding, scene, params=params)
    proposals = materialize(propose(query, ends, draws, params.relations))
    rank = log_rank(query, proposals.related, seen, scene, params=params)
    log_weight = _log_weights(query, ends, proposals, rank, scene, params.misleading)
    mention = jnp.where(ends.is_open, query.mention, NONE)
    weighed = robot_relations, mention, proposals.pairs, scene.log_area, params.misleading
    log_weight = weigh_by_robot(log_weight, *weighed)
    choice, log_total = categorical.draw(log_weight, draws.choice)
    # One object of each chain of relations has the uniform prior over the area: for a figure
    # grounded earlier and now related to the robot that prior is divided out.
    by_robot = ~ends.is_open[FIGURE] & ~query.is_by_object
    both_open = ends.is_open[FIGURE] & ends.is_open[LANDMARK]
    log_root = jnp.where(both_open, -scene.log_area, jnp.where(by_robot, scene.log_area, 0.0))
    log_total = jnp.maximum(log_total + log_root, _MIN_LOG_TOTAL)
    # If no grounding is possible (a figure drawn outside the area), keep a hypothesis of negligible
    # weight in the unexplored area.
    choice = jnp.where(log_total <= _MIN_LOG_TOTAL, log_weight.shape[0] - 1, choice)
    return _update_grounding(grounding, query, ends, proposals, choice, log_total)


def _set_other_landmark(query: Query, grounding: Grounding) -> Query:
    """Set the ``other_landmark`` of "between", grounded before, and exclude it as an end."""
    table = jnp.stack([grounding.x, grounding.y, grounding.slot.astype(jnp.float32)], axis=1)
    other = lookup(table, jnp.broadcast_to(query.other, table.shape[1:]))
    slot = jnp.where(query.is_between, other[2], NONE).astype(jnp.int32)
    return query._replace(
        viewer=jnp.where(query.is_between[None], other, query.viewer),
        excluded=query.excluded | jnp.where(slot == NONE, 0, jnp.left_shift(1, slot))[None],
    )


def _log_pair_prior(ends: Candidates) -> Array:
    """Compute the log-prior of pairs of candidates, f32[(O + 1)², ...]; −∞ for equal ends."""
    size = ends.x.shape[1]
    log_prior = ends.log_prior[FIGURE][:, None] + ends.log_prior[LANDMARK][None]
    is_both = np.arange(size) < size - 1
    is_both = append_axes(jnp.asarray(is_both[:, None] & is_both[None]), log_prior.ndim)
    padding = ((0, 1), (0, 1), *((0, 0),) * (log_prior.ndim - 2))
    log_prior = log_prior + jnp.where(is_both, jnp.pad(ends.log_pair_gain, padding), 0.0)
    # The last candidates are earlier groundings, not objects.
    same_slot = jnp.asarray(np.diag(np.arange(size) < size - 1))
    log_prior = jnp.where(append_axes(same_slot, log_prior.ndim), -jnp.inf, log_prior)
    return log_prior.reshape(size * size, *log_prior.shape[2:])


def _log_weights(
    query: Query,
    ends: Candidates,
    proposals: Proposals,
    log_rank: Array,
    scene: Unexplored,
    error_rate: Array,
) -> Array:
    """Compute the log-weights of all proposals for a relation: prior · f m / q, f32[W, ...]."""
    size, ndim = ends.x.shape[1], proposals.new_x.ndim
    old, new = slice(size * size), slice(size * size, None)
    log_area, log_unseen = prepend_axes(scene.log_area, ndim), prepend_axes(scene.log_unseen, ndim)
    log_density = query.log_density(*proposals.related)
    is_related = (query.relation != NONE)[None]
    log_holds = jnp.where(is_related, jnp.log1p(-error_rate), -jnp.inf) + log_rank
    log_fails = jnp.where(is_related, jnp.log(error_rate), 0.0)
    log_old = jnp.logaddexp(log_holds[old] + log_density[old], log_fails - log_area)

    # One end new: the other's prior. Both: the landmark is uniform over the area, u times A for
    # the root of the chain.
    log_other = jnp.where(ends.is_open[:, None], ends.log_prior[::-1], -jnp.inf)
    log_other = log_other.reshape(2 * size, *log_other.shape[2:])
    is_open = (ends.is_open[FIGURE] & ends.is_open[LANDMARK])[None]
    log_both = jnp.where(is_open, log_unseen + log_area, -jnp.inf)
    log_pairs = [log_both - jnp.log(float(NUM_UNSEEN))] * NUM_UNSEEN
    log_new = _log_new(query, proposals, log_density[new], scene) + log_holds[new]
    # An invalid relation is enumerated in every particle, not sampled: one draw in twenty would
    # leave that hypothesis to two or three particles, which are soon lost.
    log_anywhere = log_fails + log_unseen
    log_old = log_old + _log_pair_prior(ends)
    log_new = log_new + jnp.concatenate([log_other, *log_pairs])
    log_anywhere = log_anywhere + jnp.concatenate([log_other, log_both])
    return jnp.concatenate([log_old, log_new, log_anywhere])


def _log_new(query: Query, proposals: Proposals, log_density: Array, scene: Unexplored) -> Array:
    """Compute log f m / q of the new objects drawn, f32[2 (O + 1) + NUM_UNSEEN, ...]."""
    log_miss = log_miss_at(scene.coverage, proposals.new_x, proposals.new_y, scene.first_row)
    # A new figure was drawn from f; a landmark from its figure's frame, not from its own.
    size = (log_miss.shape[0] - NUM_UNSEEN) // 2
    log_ratio = log_density[size : 2 * size] - proposals.log_proposal
    log_landmark = log_miss[size : 2 * size] + log_ratio
    log_drawn = jnp.concatenate([log_miss[:size], log_landmark, log_miss[2 * size :]])
    # For draws from the unseen area, q is m / u A.
    log_anywhere = log_density + prepend_axes(scene.log_unseen + scene.log_area, log_miss.ndim)
    return jnp.where(query.is_rangeless[None], log_anywhere, log_drawn)


def _update_grounding(
    grounding: Grounding,
    query: Query,
    ends: Candidates,
    proposals: Proposals,
    choice: Array,
    log_total: Array,
) -> Grounding:
    """Write the sampled figure and landmark into the grounding; earlier ends stay."""
    num_objects = ends.x.shape[1] - 1
    slots, anchoring = proposal_layout(num_objects)
    slot = jnp.where(ends.is_open, jnp.asarray(slots)[:, choice], ends.earlier.slot)
    inherited = jnp.where(ends.is_open, NONE, ends.earlier.root)
    root = jnp.where(slot == NONE, inherited, slot)
    node = jnp.where(slot == NONE, num_objects + query.mention, slot)
    # The figure of an ordinal rank may be anywhere unseen: it is not anchored to its landmark.
    is_anchored = jnp.asarray(anchoring)[:, choice] & (query.is_by_object & ~query.is_ordinal)[None]
    x, y, landmark_x, landmark_y = (
        jnp.take_along_axis(leaf, choice[None], axis=0)[0] for leaf in proposals.pairs
    )
    chosen = (
        slot,
        jnp.stack([x, landmark_x]),
        jnp.stack([y, landmark_y]),
        jnp.where(is_anchored, node[::-1], NONE),
        jnp.where(is_anchored, root[::-1], NONE),
        jnp.ones_like(ends.is_open),
    )
    is_valid = query.mention[FIGURE] != NONE
    changed = jnp.where(ends.is_open & is_valid[None] & (query.types >= 0), query.mention, NONE)
    mentions = append_axes(jnp.arange(grounding.slot.shape[0]), query.mention.ndim)
    is_figure, is_landmark = (mentions == changed[end][None] for end in (FIGURE, LANDMARK))
    # For each mention, i32[M, ...]: 2 if grounded now as the figure, 1 as the landmark, or 0.
    source = jnp.where(is_figure, 2, is_landmark.astype(jnp.int32))

    def merge(old: Array, new: Array) -> Array:
        new_ends = (jnp.broadcast_to(new[end : end + 1], old.shape) for end in (LANDMARK, FIGURE))
        return jax.lax.select_n(source, old, *new_ends)

    log_weight = grounding.log_weight + jnp.where(is_valid, log_total, 0.0)
    fields = [merge(old, new) for old, new in zip(grounding[:-1], chosen, strict=True)]
    return Grounding(*fields, log_weight=log_weight)
