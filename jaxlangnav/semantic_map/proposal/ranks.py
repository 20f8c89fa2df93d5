"""Likelihood of ranks: "nearest", "the second", "leftmost" (section 3.2, beyond the paper).

"Nearest to the car" gives the figure a distance, and no other observed object of its type is
nearer. "The second", "the leftmost", "the farthest" and "the nearest" to the robot are ordinal:
no distance, only which objects of the type come before. Those may be unseen, so each missing
predecessor of a figure contributes the expected number of unseen objects, λ A u = α u, times the
fraction of them that would come before. "The second" needs one object before it; "the nearest"
needs another after it, or the word would be idle. "The third" presupposes three objects, and "the
leftmost" two: until that many have been observed, each unseen one that is needed surely exists.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type
from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import insert_axes, prepend_axes, skip_unless_any
from jaxlangnav.relations import degree, is_on_side, robot_frame
from jaxlangnav.relations.strength import kth_smallest
from jaxlangnav.semantic_map.counts import log_expected
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.candidates import Draws, Observed, Unexplored
from jaxlangnav.semantic_map.proposal.enumerate import Pairs
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, Query

_TIE = 1e-3  # metres within which an observed object is the figure itself
_MIN_BEFORE, _MIN_AFTER = 0.01, 0.1
"""Minimum fractions of unseen objects before and after: few samples may have none of either."""
_OFF_SIDE = 1e-3  # weight of a figure that is not on the stated side


def log_rank(
    query: Query,
    pairs: Pairs,
    seen: Observed,
    draws: Draws,
    scene: Unexplored,
    *,
    params: MapParams,
    num_known: int = 0,
) -> Array:
    """Compute the log-likelihood of a rank ("the second") for figures at given positions.

    "The nearest cone on your left" is compared with the cones on the left alone. The first
    ``num_known``² pairs combine that many figures with the landmarks of the ``num_known`` pairs
    after them: terms of the landmarks alone are computed once.

    Limits: if all is observed, the object of that rank has 0, the others nearly −∞; 0 if no rank.
    """
    is_nearest = (query.rank > 0) & ~query.is_ordinal

    def nearest(pairs: Pairs) -> Array:
        return -_excess(query, pairs, seen, num_known) / params.superlative_softness

    def ordinal(pairs: Pairs) -> Array:
        return _log_ordinal(query, pairs, seen, draws, scene, params)

    log_nearest = skip_unless_any(is_nearest, nearest, pairs, jnp.zeros_like(pairs.x))
    # Ordinal ranks are expensive to evaluate.
    return skip_unless_any(query.is_ordinal, ordinal, pairs, log_nearest)


def _excess(query: Query, pairs: Pairs, seen: Observed, num_known: int) -> Array:
    """Compute the distance of a figure in excess of the nearest rival's, f32[n, ...] metres ≥ 0."""
    dx, dy = pairs.x - pairs.landmark_x, pairs.y - pairs.landmark_y
    dist2 = dx * dx + dy * dy + 1e-9
    at_x, at_y = (leaf[num_known * num_known :] for leaf in (pairs.landmark_x, pairs.landmark_y))
    x, y = insert_axes(seen.x, dist2.ndim + 1), insert_axes(seen.y, dist2.ndim + 1)
    is_rival = insert_axes(_is_rival(seen, query), dist2.ndim + 1)
    rival_dx, rival_dy = x - at_x[None], y - at_y[None]
    rival2 = rival_dx * rival_dx + rival_dy * rival_dy + 1e-9  # [O, landmarks, ...]
    # The object nearest to the cone is not the cone itself.
    is_any = prepend_axes(is_anything(query.types[FIGURE]), rival2.ndim)
    is_landmark = is_any & (rival2 < _TIE**2)
    nearest = jnp.min(jnp.where(is_rival & ~is_landmark, rival2, jnp.inf), axis=0)
    nearest = jnp.minimum(dist2, jnp.concatenate([*[nearest[:num_known]] * num_known, nearest]))
    return jnp.sqrt(dist2) - jnp.sqrt(nearest)


def _log_ordinal(
    query: Query, pairs: Pairs, seen: Observed, draws: Draws, scene: Unexplored, params: MapParams
) -> Array:
    """Compute the log-likelihood of an ordinal rank, with expected unseen objects counted."""
    num_seen, num_others = seen.x.shape[0], seen.x.shape[0] + draws.unseen_x.shape[0]
    x = jnp.concatenate([seen.x, draws.unseen_x, pairs.x])
    y = jnp.concatenate([seen.y, draws.unseen_y, pairs.y])
    viewer_x, viewer_y, heading = (prepend_axes(v, x.ndim) for v in jnp.unstack(query.viewer))
    robot = jax.tree.map(lambda leaf: leaf[None], robot_frame(heading))
    side = insert_axes(query.sides, x.ndim + 1)
    is_on_sides = is_on_side(side, (x - viewer_x)[None], (y - viewer_y)[None], robot)
    is_on_all_sides = functools.reduce(jnp.logical_and, jnp.unstack(is_on_sides))
    score = _score(query, pairs, pairs.x[None], pairs.y[None])[0]
    others = (insert_axes(part[:num_others], score.ndim + 1) for part in (x, y))
    scores, in_scope = _score(query, pairs, *others), insert_axes(is_on_all_sides, score.ndim + 1)
    rival, unseen = scores[:num_seen], scores[num_seen:]  # [O, n, ...] and [NUM_UNSEEN, n, ...]
    type_matches, rank = _is_rival(seen, query), query.rank[None]
    is_rival = in_scope[:num_seen] & insert_axes(type_matches, rival.ndim)
    target = kth_smallest(rank, jnp.where(is_rival, rival, jnp.inf), tie=_TIE)
    excess = jnp.maximum(score - target, 0.0)

    before = jnp.sum(is_rival & (rival < score[None] - _TIE), axis=0)
    is_alone = ~jnp.any(is_rival & (jnp.abs(rival - score[None]) > _TIE), axis=0) & (rank == 1)
    missing = jnp.maximum(rank - 1 - before, 0)
    is_counted = type_matches if scene.num_pooled is None else seen.object_type != NONE
    others = jnp.maximum(jnp.sum(is_counted, axis=0) - 1, 0)
    num_pooled = None if scene.num_pooled is None else prepend_axes(scene.num_pooled, others.ndim)
    unseen_frac = jnp.exp(prepend_axes(scene.log_unseen, others.ndim))
    log_more = log_expected(others, unseen_frac, params=params, num_pooled=num_pooled)
    is_observed = jnp.any(is_rival & (jnp.abs(rival - score[None]) <= _TIE), axis=0)
    num_rivals = jnp.sum(is_rival, axis=0) + jnp.where(is_observed, 0, 1)
    log_new = prepend_axes(log_more, score.ndim) + prepend_axes(scene.log_unseen, score.ndim)
    log_new = jnp.where(num_rivals < jnp.maximum(rank, 2), jnp.maximum(log_new, 0.0), log_new)

    def log_exists(is_ahead: Array, floor: float) -> Array:
        frac = jnp.mean(in_scope[num_seen:num_others] & is_ahead, axis=0)
        return log_new + jnp.log(jnp.maximum(frac, floor))

    total = jnp.where(missing > 0, missing * log_exists(unseen < score[None], _MIN_BEFORE), 0.0)
    total = total + jnp.where(is_alone, log_exists(unseen > score[None], _MIN_AFTER), 0.0)
    total = total + jnp.where(is_on_all_sides[num_others:], 0.0, jnp.log(_OFF_SIDE))
    return total - excess / params.superlative_softness


def _is_rival(seen: Observed, query: Query) -> Array:
    """Test which objects a figure is compared with: those of its type that probably exist."""
    type_matches = is_type(seen.object_type, query.types[FIGURE][None])
    return type_matches if seen.existence is None else type_matches & (seen.existence > 0.5)


def _score(query: Query, pairs: Pairs, x: Array, y: Array) -> Array:
    """Compute the rank order's key of positions [k, n, ...] for n landmarks, smaller is earlier."""
    dx, dy = x - pairs.landmark_x[None], y - pairs.landmark_y[None]
    robot = robot_frame(prepend_axes(query.viewer[2], dx.ndim))
    distance = jnp.sqrt(dx * dx + dy * dy + 1e-9)
    sideways = dx * robot.lateral_x + dy * robot.lateral_y
    return -degree(prepend_axes(query.relation, dx.ndim), distance, sideways)
