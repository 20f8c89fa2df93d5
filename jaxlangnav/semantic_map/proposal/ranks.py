"""Ranks: "nearest", "the second", "leftmost" (section 3.2, beyond the paper).

"Nearest to the car" says where its figure is, and that no other seen thing of its type is nearer.
"The second", "the leftmost", "the farthest" and, of the robot, "the nearest" are orders, which say
nothing of how far: only which of their type come before. What comes before may be unseen, so a
figure with too few seen things before it is worth as much as unseen ones there are expected:
λ A u = α u for each, of which the share that would come before counts. "The second" needs one
before it; "the nearest" needs another one after it, or nobody would say so. Who says "the third"
speaks of three, and who says "the leftmost" of two: until so many have been seen, each unseen one
that is needed is there for sure.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type
from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import insert_axes, prepend_axes, skip_unless_any
from jaxlangnav.relations import degree, is_on_side, robot_frame
from jaxlangnav.relations.strength import value_of_rank
from jaxlangnav.semantic_map.counts import log_expected
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.candidates import Draws, Observed, Unexplored
from jaxlangnav.semantic_map.proposal.enumerate import Pairs
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, Query

_TIE = 1e-3  # metres within which a seen thing is the figure itself
_LEAST_BEFORE, _LEAST_AFTER = 0.01, 0.1
"""Share of the unseen that may come before, and after, where neither of few draws does."""
_OFF_SIDE = 1e-3  # weight of a figure that is not on the side where it is said to be


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
    """Weigh figures at places by how well they fit their rank.

    "The nearest cone on your left" is compared with the cones on the left alone. The first
    ``num_known``² pairs are of so many figures, each with the landmarks of the first so many pairs
    behind them: what depends on these alone is worked out once.

    Limits: with all seen, the one of that rank has 0 and the others nearly −∞; 0 where no rank is
    meant.
    """
    is_nearest = (query.rank > 0) & ~query.is_order
    softness = params.superlative_softness
    log_nearest = skip_unless_any(
        is_nearest, lambda here: -_excess(query, here, seen, num_known) / softness, pairs
    )
    # Orders cost more than all the rest.
    log_order = skip_unless_any(
        query.is_order, lambda here: _log_order(query, here, seen, draws, scene, params), pairs
    )
    return log_nearest + log_order


def _excess(query: Query, pairs: Pairs, seen: Observed, num_known: int) -> Array:
    """Measure by how many metres a seen rival is nearer, f32[n, ...]; "farthest" is an order."""
    dx, dy = pairs.x - pairs.landmark_x, pairs.y - pairs.landmark_y
    own = dx * dx + dy * dy + 1e-9
    at_x, at_y = (leaf[num_known * num_known :] for leaf in (pairs.landmark_x, pairs.landmark_y))
    x, y = insert_axes(seen.x, own.ndim + 1), insert_axes(seen.y, own.ndim + 1)
    is_rival = insert_axes(_is_rival(seen, query), own.ndim + 1)
    away_x, away_y = x - at_x[None], y - at_y[None]
    squared = away_x * away_x + away_y * away_y + 1e-9  # [O, landmarks, ...]
    # The thing nearest to the cone is not the cone.
    is_any = prepend_axes(is_anything(query.kind[FIGURE]), squared.ndim)
    is_landmark = is_any & (squared < _TIE**2)
    best = jnp.min(jnp.where(is_rival & ~is_landmark, squared, jnp.inf), axis=0)
    best = jnp.minimum(own, jnp.concatenate([*[best[:num_known]] * num_known, best]))
    return jnp.sqrt(own) - jnp.sqrt(best)


def _log_order(
    query: Query, pairs: Pairs, seen: Observed, draws: Draws, scene: Unexplored, params: MapParams
) -> Array:
    """Weigh figures by an order, which counts what is unseen."""
    num_seen, num_others = seen.x.shape[0], seen.x.shape[0] + draws.unseen_x.shape[0]
    x = jnp.concatenate([seen.x, draws.unseen_x, pairs.x])
    y = jnp.concatenate([seen.y, draws.unseen_y, pairs.y])
    viewer_x, viewer_y, heading = (prepend_axes(one, x.ndim) for one in jnp.unstack(query.viewer))
    robot = jax.tree.map(lambda leaf: leaf[None], robot_frame(heading))
    side = insert_axes(query.sides, x.ndim + 1)
    is_on_sides = is_on_side(side, (x - viewer_x)[None], (y - viewer_y)[None], robot)
    is_where_said = functools.reduce(jnp.logical_and, jnp.unstack(is_on_sides))
    own = _merit(query, pairs, pairs.x[None], pairs.y[None])[0]
    others = (insert_axes(part[:num_others], own.ndim + 1) for part in (x, y))
    merit, counts = _merit(query, pairs, *others), insert_axes(is_where_said, own.ndim + 1)
    rival, unseen = merit[:num_seen], merit[num_seen:]  # [O, n, ...] and [NUM_UNSEEN, n, ...]
    is_kind, rank = _is_rival(seen, query), query.rank[None]
    is_rival = counts[:num_seen] & insert_axes(is_kind, rival.ndim)
    meant = value_of_rank(rank, jnp.where(is_rival, rival, jnp.inf), tie=_TIE)
    excess = jnp.maximum(own - meant, 0.0)

    before = jnp.sum(is_rival & (rival < own[None] - _TIE), axis=0)
    is_alone = ~jnp.any(is_rival & (jnp.abs(rival - own[None]) > _TIE), axis=0) & (rank == 1)
    lacking = jnp.maximum(rank - 1 - before, 0)
    is_counted = is_kind if scene.num_pooled is None else seen.object_type != NONE
    others = jnp.maximum(jnp.sum(is_counted, axis=0) - 1, 0)
    num_pooled = None if scene.num_pooled is None else prepend_axes(scene.num_pooled, others.ndim)
    unseen_share = jnp.exp(prepend_axes(scene.log_unseen, others.ndim))
    log_more = log_expected(others, unseen_share, params=params, num_pooled=num_pooled)
    log_unseen = prepend_axes(scene.log_unseen, own.ndim)
    is_seen = jnp.any(is_rival & (jnp.abs(rival - own[None]) <= _TIE), axis=0)
    number = jnp.sum(is_rival, axis=0) + jnp.where(is_seen, 0, 1)
    log_new = prepend_axes(log_more, own.ndim) + log_unseen
    log_new = jnp.where(number < jnp.maximum(rank, 2), jnp.maximum(log_new, 0.0), log_new)

    def log_there(is_there: Array, least: float) -> Array:
        share = jnp.mean(counts[num_seen:num_others] & is_there, axis=0)
        return log_new + jnp.log(jnp.maximum(share, least))

    price = jnp.where(lacking > 0, lacking * log_there(unseen < own[None], _LEAST_BEFORE), 0.0)
    price = price + jnp.where(is_alone, log_there(unseen > own[None], _LEAST_AFTER), 0.0)
    price = price + jnp.where(is_where_said[num_others:], 0.0, jnp.log(_OFF_SIDE))
    return price - excess / params.superlative_softness


def _is_rival(seen: Observed, query: Query) -> Array:
    """Tell what figures are compared with: of their type, and likelier there than not."""
    is_kind = is_type(seen.object_type, query.kind[FIGURE][None])
    return is_kind if seen.existence is None else is_kind & (seen.existence > 0.5)


def _merit(query: Query, pairs: Pairs, x: Array, y: Array) -> Array:
    """Measure places [k, n, ...] along the order of n landmarks, smaller is earlier."""
    dx, dy = x - pairs.landmark_x[None], y - pairs.landmark_y[None]
    robot = robot_frame(prepend_axes(query.viewer[2], dx.ndim))
    distance = jnp.sqrt(dx * dx + dy * dy + 1e-9)
    sideways = dx * robot.lateral_x + dy * robot.lateral_y
    return -degree(prepend_axes(query.relation, dx.ndim), distance, sideways)
