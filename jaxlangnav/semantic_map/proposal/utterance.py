"""Ground an utterance in particles: draw a reading and what its words refer to (eq. 7a).

Plain ``vmap`` would ground the words in every particle of every lane. Instead the particles whose
hypothesis was refuted, few at most steps, are gathered across the batch into chunks of fixed size.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

from jaxlangnav.messages import NONE, Readings, UtteranceContext
from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import pack, select_row, take, unpack
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, is_led, mean_drift
from jaxlangnav.semantic_map.coverage import Coverage, area_size, sample_unseen
from jaxlangnav.semantic_map.heading_bias import both_ways
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.candidates import (
    NUM_UNSEEN,
    Draws,
    Grounding,
    Observed,
    Unexplored,
    nothing_grounded,
)
from jaxlangnav.semantic_map.proposal.relation_query import (
    FIGURE,
    Query,
    build_queries,
    current_context,
    queries_of,
)
from jaxlangnav.semantic_map.proposal.sample import ground_relation

_PIECES, _LEAST_PIECE = 8, 256
"""Pieces in which the particles of all lanes are grounded, and the least size of one."""

_STEPS = np.array([0.61803399, 0.41421356, 0.73205081, 0.64575131], np.float32)
"""Steps of additive recurrences, fractions of roots of 5, 2, 3, 7: together they fill the cube."""
Own = tuple[Observed, Draws, Array]
"""What each particle has seen, leaves [J, ..., P] of what is drawn, and its reading, i32[P]."""


def _unseen(belief: ParticleBelief, uniform: Array, jitter: Array) -> tuple[Unexplored, Array]:
    """Draw places that are unseen, f32[2, n]; with a steady drift f32[2, n, P], by its own sign."""
    coverage, log_area = belief.coverage, jnp.log(area_size(belief.coverage))
    x, y, log_unseen = sample_unseen(coverage, uniform, jitter)
    places = jnp.stack([x, y])
    if mean_drift(belief) is None:
        return Unexplored(coverage, jnp.int32(0), log_area, log_unseen), places
    stacked, rows = both_ways(belief)
    is_ours = is_led(belief)
    other = replace(coverage, log_miss=belief.alternate_miss)
    x, y, log_other = sample_unseen(other, uniform, jitter)
    places = jnp.where(is_ours, places[..., None], jnp.stack([x, y])[..., None])
    log_unseen = jnp.where(is_ours, log_unseen, log_other)
    return Unexplored(stacked, rows, log_area, log_unseen), places


def _draw_places(
    key: Array, belief: ParticleBelief, num_relations: int
) -> tuple[Array, Draws, Unexplored]:
    """Draw the random numbers of all particles and relations.

    f32[P] that decides which reading a particle takes; leaves [J, ...]; what is unexplored.
    """
    number = belief.log_weight.shape[0]
    pool = NUM_UNSEEN * number
    reading_key, draws_key = jax.random.split(key)
    pool_key, loop_key = jax.random.split(draws_key)
    index = np.arange(num_relations)
    keys = jax.vmap(lambda one: jax.random.split(jax.random.fold_in(loop_key, one)))(index)
    keys_of_all = jnp.concatenate([jnp.stack([reading_key, pool_key]), keys[:, 0]])
    uniforms = batching.uniforms(keys_of_all, max(2 * NUM_UNSEEN, 5) * number)
    comb = uniforms[1, : 2 * pool].reshape(2, pool)
    scene, places = _unseen(belief, comb[0, 0], comb)
    steps = jnp.asarray(_STEPS[index % len(_STEPS)])
    of_all = jax.vmap(_of_relation, in_axes=(0, 0, 0, None))
    return uniforms[0, :number], of_all(uniforms[2:], keys[:, 1], steps, places), scene


def _of_relation(uniform: Array, shuffle_key: Array, step: Array, places: Array) -> Draws:
    """Draw the random numbers of one relation, for all particles; leaves [..., P]."""
    pool = places.shape[1]
    number = pool // NUM_UNSEEN
    stride = next(step for step in range(int(0.618 * number), 0, -1) if math.gcd(step, number) == 1)
    # Which place of the comb goes to which particle is random: a fixed assignment would tie
    # particles to regions. Each row is dealt over the whole comb.
    dealt = NUM_UNSEEN * (stride * np.arange(number) % number) + np.arange(NUM_UNSEEN)[:, None]
    start = jax.random.randint(shuffle_key, (), 0, pool)
    chosen = jax.lax.rem(start + dealt.astype(np.int32), pool)
    unit = batching.between(uniform[: 5 * number], 1e-6, 1.0 - 1e-6).reshape(5, number)
    normal = jax.scipy.special.ndtri(unit[:4])
    own = chosen if places.ndim == 2 else (chosen, np.arange(number))
    return Draws(
        distance=normal[:2],
        angle=normal[2:],
        # Evenly spread over the particles: what they choose stays for the episode, and with it the
        # error of independent draws. Each relation has a step of its own, or what a particle
        # chooses for one would tell what it chooses for the next.
        choice=jax.lax.rem(unit[4, 0] + step * np.arange(number, dtype=np.float32), 1.0),
        unseen_x=places[0][own],
        unseen_y=places[1][own],
    )


def _ground(
    num_mentions: int, own: Own, query: Query, scene: Unexplored, params: MapParams
) -> Grounding:
    """Ground the words of particles, relation by relation; of what is said leaves [J, ..., P]."""
    seen, draws, _ = own
    num_relations = jnp.max(jnp.sum(query.mention[:, FIGURE] != NONE, axis=0))

    def body(index: Array, grounding: Grounding) -> Grounding:
        one, drawn = select_row((query, draws), index)
        return ground_relation(seen, one, grounding, drawn, scene, params=params)

    nothing = nothing_grounded(num_mentions, *query.relation.shape[1:])
    return jax.lax.fori_loop(0, num_relations, body, nothing)


@functools.cache
def _ground_sparse(num_mentions: int) -> Callable[..., Grounding]:
    """Build ``_ground`` of all particles, with a rule of its own for ``vmap`` over lanes."""

    def dense(own: Own, queries: Query, *numbers: Any) -> Grounding:
        return _ground(num_mentions, own, queries_of(queries, own[2]), *numbers)

    @custom_vmap
    def ground(is_asked: Array, *arguments: Any) -> Grounding:
        return dense(*arguments)  # of one lane all are grounded

    def rule(num_lanes: int, is_batched: Any, *arguments: Any) -> tuple[Grounding, Grounding]:
        if any(jax.tree.leaves(is_batched[-1])):
            # Each lane with numbers of its own: rare, and not worth gathering them too.
            axes = jax.tree.map(lambda has_lanes: 0 if has_lanes else None, tuple(is_batched[1:]))
            grounding = jax.vmap(dense, in_axes=axes, axis_size=num_lanes)(*arguments[1:])
        else:

            def spread(leaf: Array, has_lanes: bool) -> Array:
                return leaf if has_lanes else jnp.broadcast_to(leaf, (num_lanes, *leaf.shape))

            of_lanes = jax.tree.map(spread, arguments[:-1], tuple(is_batched[:-1]))
            asked, own, queries, scene = of_lanes
            grounding = _ground_gathered(num_mentions, asked, own, queries, scene, arguments[-1])
        return grounding, jax.tree.map(lambda _: True, grounding)

    ground.def_vmap(rule)
    return ground


def _ground_gathered(
    num_mentions: int,
    is_asked: Array,
    own: Own,
    queries: Query,
    scene: Unexplored,
    params: MapParams,
) -> Grounding:
    """Gather the particles asked, bool[L, P], ground them piece by piece, put back [L, ..., P]."""
    num_lanes, number = is_asked.shape
    size = num_lanes * number
    piece = min(max(_LEAST_PIECE, -(-size // _PIECES)), size)
    room = -(-size // piece) * piece
    asked = is_asked.reshape(size)
    order = jnp.nonzero(asked, size=room, fill_value=0)[0]
    side_by_side, all_queries = jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1), (own, queries)
    )
    table, num_readings = pack(side_by_side), queries.relation.shape[-1]

    def ground_piece(start: Array) -> Array:
        chosen = jax.lax.dynamic_slice_in_dim(order, start, piece)
        theirs, lane = unpack(table[:, chosen], side_by_side), chosen // number
        heard, there = lane * num_readings + theirs[2], _scene_of(scene, chosen, lane)
        return pack(_ground(num_mentions, theirs, take(all_queries, heard), there, params))

    form = jax.eval_shape(lambda: nothing_grounded(num_mentions, size))
    rows = sum(math.prod(leaf.shape[:-1]) for leaf in jax.tree.leaves(form))
    number_asked = jnp.sum(asked)

    def is_left(carry: tuple[Array, Array]) -> Array:
        return carry[0] < number_asked

    def fill(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        start, found = carry
        found = jax.lax.dynamic_update_slice_in_dim(found, ground_piece(start), start, axis=1)
        return start + piece, found

    nothing = jnp.int32(0), jnp.zeros((rows, room), jnp.float32)
    found = jax.lax.while_loop(is_left, fill, nothing)[1]
    place = jnp.maximum(jnp.cumsum(asked) - 1, 0)
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], num_lanes, number), -2, 0),
        unpack(found[:, place], form),
    )


def _scene_of(scene: Unexplored, chosen: Array, lane: Array) -> Unexplored:
    """Tell particles of several lanes, i32[n] of all and i32[n] theirs, in what scene each is."""
    maps, num_cells = scene.coverage.log_miss, scene.coverage.log_miss.shape[-1]

    def own(values: Array) -> Array:
        return values[lane] if values.ndim == 1 else values.reshape(-1)[chosen]

    return Unexplored(
        coverage=Coverage(log_miss=maps.reshape(-1, num_cells), area=scene.coverage.area[lane].T),
        first_row=lane * maps.shape[1] + own(scene.first_row),
        log_area=scene.log_area[lane],
        log_unseen=own(scene.log_unseen),
        num_pooled=None if scene.num_pooled is None else scene.num_pooled[lane],
    )


def ground_words(
    key: Array,
    belief: ParticleBelief,
    readings: Readings,
    *,
    params: MapParams,
    context: UtteranceContext | None = None,
    is_asked: Array | None = None,
    is_sparse: bool = False,
    num_pooled: Array | None = None,
) -> tuple[SemanticMap, Array]:
    """Draw for particles a reading and what its words refer to (eq. 7a).

    Args:
        key: random key.
        belief: the observed map and where the robot has looked.
        readings: the sentence.
        params: relations, concentration.
        context: from where relations were said; all from the belief's viewer by default.
        is_asked: bool[P], the particles whose words are grounded; all by default.
        is_sparse: under ``vmap``, compute only those; no gradient in reverse mode.
        num_pooled: f32[], types that have one rate of how many there are; None: each its own.

    Returns:
        Particles with fresh groundings, and f32[P], log of the evidence estimated by each. Of
        particles that were not asked the groundings mean nothing and the evidence is −∞.
    """
    particles, num_objects = belief.particles, belief.particles.object_type.shape[0]
    asked = jnp.ones(belief.log_weight.shape, bool) if is_asked is None else is_asked
    uniform, draws, scene = _draw_places(key, belief, readings.figure.shape[1])
    scene = scene._replace(num_pooled=num_pooled)
    share = jnp.cumsum(jnp.exp(readings.log_probability))
    point = uniform * share[-1]
    reading = jnp.sum(share[:-1, None] <= point[None, :], axis=0).astype(jnp.int32)
    seen_x, seen_y = particles.mean_x[:num_objects], particles.mean_y[:num_objects]
    existence = particles.existence if particles.existence.shape[0] else None
    own = Observed(particles.object_type, seen_x, seen_y, existence), draws, reading
    context = current_context(readings, belief.viewer) if context is None else context
    queries = build_queries(readings, context, params.relations, scene.log_area)
    num_mentions = readings.mention_type.shape[1]
    if is_sparse:
        grounding = _ground_sparse(num_mentions)(asked, own, queries, scene, params)
    else:
        grounding = _ground(num_mentions, own, queries_of(queries, reading), scene, params)
    fresh = replace(
        particles,
        reading=reading,
        referent=grounding.slot,
        anchor=grounding.anchor,
        root=grounding.root,
        hypothesis_x=grounding.x,
        hypothesis_y=grounding.y,
        is_mentioned=grounding.is_grounded,
    )
    return fresh, jnp.where(asked, grounding.log_weight, -jnp.inf)
