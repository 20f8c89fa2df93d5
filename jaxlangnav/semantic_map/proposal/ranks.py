"""Likelihood of ranks: "nearest", "the second", "leftmost" (section 3.2, beyond the paper).

"Nearest to the car" gives the figure a distance, and no other observed object of its type is
nearer. "The second", "the leftmost", "the farthest" and "the nearest" to the robot are ordinal:
no distance, only which objects of the type come before. Those may be unseen: the observed object
of the rank is meant only if none comes before it; otherwise the unseen one is to be found first.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type
from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import insert_axes, prepend_axes, skip_unless_any
from jaxlangnav.relations import degree, is_on_side, robot_frame
from jaxlangnav.relations.strength import kth_smallest
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.counts import log_prob_none
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.candidates import Observed, Unexplored, observed
from jaxlangnav.semantic_map.proposal.enumerate import Pairs
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, Query, Utterances, build_queries

_TIE = 1e-3  # metres within which an observed object is the figure itself
_OFF_SIDE = 1e-3  # weight of a figure that is not on the stated side
_PLURAL_ODDS = 10.0  # odds factor of an unseen figure: "the second", "the rightmost" imply several
_LAST = 1e6  # metres, score of the observed object of a rank, if there are too few


def log_rank(
    query: Query, pairs: Pairs, seen: Observed, scene: Unexplored, *, params: MapParams
) -> Array:
    """Compute the log-likelihood of a rank r ("the second") for figures at given positions.

    Of an ordinal one it is log P(a(s) = 0), with a(s) unseen objects before the score s of the
    figure, for an observed figure that is the r-th, s = s_r, and for a new one before it, s < s_r:
    the first unseen one. It falls with the distance from that.
    "The nearest cone on your left" is compared with the cones on the left alone.

    Limits: if all is observed, the object of that rank has 0, the others nearly −∞; 0 if no rank.
    """

    def nearest(pairs: Pairs) -> Array:
        return _order(query, pairs, seen, params)[-1]

    def ordinal(pairs: Pairs) -> Array:
        score, is_observed, log_before = _order(query, pairs, seen, params)
        ndim, num_pooled = score.ndim, scene.num_pooled
        x, y = (insert_axes(leaf, ndim + 1) for leaf in scene.points)
        is_before = _is_on_sides(query, x, y) & (_score(query, pairs, x, y) < score[None])
        unseen = jnp.exp(prepend_axes(scene.log_unseen, ndim))
        is_counted = _is_rival(seen, query) if num_pooled is None else seen.object_type != NONE
        count = prepend_axes(jnp.sum(is_counted, axis=0), ndim) - is_observed
        num_pooled = None if num_pooled is None else prepend_axes(num_pooled, ndim)
        frac = jnp.mean(is_before, axis=0)
        log_before += log_prob_none(count, frac, unseen, params=params, num_pooled=num_pooled)
        return log_before + jnp.where(is_observed, 0.0, jnp.log(_PLURAL_ODDS))

    log_nearest = skip_unless_any(query.rank > 0, nearest, pairs, jnp.zeros_like(pairs.x))
    # Ordinal ranks are expensive to evaluate.
    return skip_unless_any(query.is_ordinal, ordinal, pairs, log_nearest)


def log_viewer_density(utterances: Utterances, belief: ParticleBelief, x: Array, y: Array) -> Array:
    """Evaluate the log-density of mentions given their relations to the robot (eq. 7a).

    "The hydrant on your left" has no observed anchor, and yet is not uniformly distributed. For
    the relations r of a mention to the robot, with densities f_r,

        log f(x) A = Σ_r log[(1 − ε) A f_r(x) + ε]

    f32[C, M, K], for positions f32[C], metres, map frame. Of a rank A f = 1 where an unseen object
    would come before the observed one of it. Limits: 0 (uniform) without any such r.
    """
    readings, params, error = utterances.readings, utterances.params, utterances.params.misleading
    (num_readings, _), mentions = readings.figure.shape, np.arange(readings.mention_type.shape[1])
    x, y = (jnp.broadcast_to(v[:, None], (v.shape[0], num_readings)) for v in (x, y))
    log_area = jnp.log(area_size(belief.coverage))
    objects = observed(belief.particles)  # alike in most particles
    seen = jax.tree.map(lambda leaf: jnp.repeat(leaf[:, :1], num_readings, 1), objects)

    def of_relation(query: Query) -> Array:
        pairs = Pairs(x, y, *(jnp.broadcast_to(v[None], x.shape) for v in query.viewer[:2]))
        log_holds = query.log_density(*pairs) + log_area
        is_ranked = query.is_ordinal & query.is_by_robot
        log_holds = skip_unless_any(
            is_ranked, lambda at: _order(query, at, seen, params)[-1], pairs, log_holds
        )
        log_ratio = jnp.logaddexp(jnp.log1p(-error) + log_holds, jnp.log(error))
        figure = jnp.where(query.is_place_by_robot | is_ranked, query.mention[FIGURE], NONE)[None]
        return jnp.where((figure == mentions[:, None])[None], log_ratio[:, None], 0.0)

    queries = build_queries(readings, utterances.context, params.relations, log_area)
    return jnp.sum(jax.lax.map(of_relation, queries), axis=0)


def _order(query: Query, pairs: Pairs, seen: Observed, params: MapParams) -> tuple[Array, ...]:
    """Compute scores, whether observed, and 0 for s_r or before it (less for others)."""
    score = _score(query, pairs, pairs.x[None], pairs.y[None])[0]
    x, y = (insert_axes(leaf, score.ndim + 1) for leaf in (seen.x, seen.y))
    is_alike = insert_axes(_is_rival(seen, query), score.ndim + 1)
    rival, is_rival = _score(query, pairs, x, y), is_alike & _is_on_sides(query, x, y)
    # The object nearest to the cone is not the cone itself.
    is_any = prepend_axes(is_anything(query.types[FIGURE]) & ~query.is_ordinal, rival.ndim)
    is_rival &= ~(is_any & (rival < _TIE))
    target = kth_smallest(query.rank[None], jnp.where(is_rival, rival, jnp.inf), tie=_TIE)
    target = jnp.minimum(target, _LAST)
    is_observed = jnp.any(is_alike & (jnp.abs(rival - score[None]) <= _TIE), axis=0)
    log_side = jnp.where(_is_on_sides(query, pairs.x, pairs.y), 0.0, jnp.log(_OFF_SIDE))
    excess = jnp.maximum(score - target, jnp.where(is_observed, target - score, 0.0))
    return score, is_observed, log_side - excess / params.superlative_softness


def _is_on_sides(query: Query, x: Array, y: Array) -> Array:
    """Test which positions f32[n, ...] are on all sides of the robot that are stated."""
    viewer_x, viewer_y, heading = (prepend_axes(v, x.ndim) for v in jnp.unstack(query.viewer))
    side, robot = insert_axes(query.sides, x.ndim + 1), robot_frame(heading[None])
    return jnp.all(is_on_side(side, (x - viewer_x)[None], (y - viewer_y)[None], robot), axis=0)


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
