"""Ground an utterance in particles: sample an interpretation and its referents (eq. 7a).

Plain ``vmap`` would ground the words in every particle of every lane. Instead the particles whose
hypothesis was refuted, usually few, are gathered across the batch into chunks of fixed size.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap

from jaxlangnav.messages import NONE, Readings, UtteranceContext
from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import pack, select_row, take, unpack
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, is_active, mean_drift
from jaxlangnav.semantic_map.coverage import Coverage, area_size, sample_unseen
from jaxlangnav.semantic_map.heading_bias import stack_coverage
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.candidates import (
    NUM_UNSEEN,
    Draws,
    Grounding,
    Observed,
    Unexplored,
    empty_grounding,
    observed,
)
from jaxlangnav.semantic_map.proposal.relation_query import (
    FIGURE,
    Query,
    build_queries,
    current_context,
    pick_queries,
    split_robot_relations,
)
from jaxlangnav.semantic_map.proposal.sample import ground_relation

_NUM_CHUNKS, _MIN_CHUNK = 8, 256
"""Number of chunks in which the particles of all lanes are grounded, and minimum chunk size."""

_RECURRENCES = np.array([0.61803399, 0.41421356, 0.73205081, 0.64575131], np.float32)
"""Steps of additive recurrences, fractional parts of (1 + √5) / 2, √2, √3, √7: low-discrepancy."""


class ParticleInputs(NamedTuple):
    """What grounding reads of each particle."""

    seen: Observed
    draws: Draws  # leaves [J, ..., P]
    reading: Array  # i32[P]


def _draw_unseen(belief: ParticleBelief, uniform: Array, jitter: Array) -> tuple[Unexplored, Array]:
    """Draw unseen points, f32[2, n]; with a heading bias f32[2, n, P], by the particle's sign."""
    coverage, log_area = belief.coverage, jnp.log(area_size(belief.coverage))
    x, y, log_unseen = sample_unseen(coverage, uniform, jitter)
    points = jnp.stack([x, y])
    sample = points[..., None]
    if mean_drift(belief) is None:
        return Unexplored(coverage, jnp.int32(0), log_area, log_unseen, sample), points
    stacked, first_row = stack_coverage(belief)
    active = is_active(belief)
    other_map = replace(coverage, log_miss=belief.alternate_miss)
    x, y, log_other = sample_unseen(other_map, uniform, jitter)
    points = jnp.where(active, points[..., None], jnp.stack([x, y])[..., None])
    log_unseen = jnp.where(active, log_unseen, log_other)
    return Unexplored(stacked, first_row, log_area, log_unseen, sample), points


def _draw_randoms(
    key: Array, belief: ParticleBelief, num_relations: int
) -> tuple[Array, Draws, Unexplored]:
    """Draw the random numbers of all particles and relations.

    f32[P], which selects the reading; draws, leaves [J, ...]; the unexplored area.
    """
    count = belief.log_weight.shape[0]
    pool = NUM_UNSEEN * count
    reading_key, draws_key = jax.random.split(key)
    pool_key, loop_key = jax.random.split(draws_key)
    index = np.arange(num_relations)
    keys = jax.vmap(lambda j: jax.random.split(jax.random.fold_in(loop_key, j)))(index)
    all_keys = jnp.concatenate([jnp.stack([reading_key, pool_key]), keys[:, 0]])
    uniforms = batching.uniforms(all_keys, max(2 * NUM_UNSEEN, 5) * count)
    jitter = uniforms[1, : 2 * pool].reshape(2, pool)
    scene, points = _draw_unseen(belief, jitter[0, 0], jitter)
    steps = jnp.asarray(_RECURRENCES[index % len(_RECURRENCES)])
    draw_all = jax.vmap(_relation_draws, in_axes=(0, 0, 0, None))
    return uniforms[0, :count], draw_all(uniforms[2:], keys[:, 1], steps, points), scene


def _relation_draws(uniform: Array, shuffle_key: Array, step: Array, points: Array) -> Draws:
    """Draw the random numbers of one relation, for all particles; leaves [..., P]."""
    pool, count = points.shape[1], points.shape[1] // NUM_UNSEEN
    stride = next(k for k in range(int(0.618 * count), 0, -1) if math.gcd(k, count) == 1)
    # The assignment of points to particles is shifted at random: a fixed one would tie particles
    # to regions. Each row is spread over the whole pool.
    assigned = NUM_UNSEEN * (stride * np.arange(count) % count) + np.arange(NUM_UNSEEN)[:, None]
    shift = jax.random.randint(shuffle_key, (), 0, pool)
    chosen = jax.lax.rem(shift + assigned.astype(np.int32), pool)
    unit = batching.to_interval(uniform[: 5 * count], 1e-6, 1.0 - 1e-6).reshape(5, count)
    normal = jax.scipy.special.ndtri(unit[:4])
    pick = chosen if points.ndim == 2 else (chosen, np.arange(count))
    return Draws(
        distance=normal[:2],
        angle=normal[2:],
        # Evenly spread over the particles: the choices last for the episode, and so would the
        # sampling error of independent draws. Each relation has its own step, or the choices for
        # different relations would be correlated.
        choice=jax.lax.rem(unit[4, 0] + step * np.arange(count, dtype=np.float32), 1.0),
        unseen_x=points[0][pick],
        unseen_y=points[1][pick],
    )


def _ground(
    num_mentions: int, inputs: ParticleInputs, queries: Query, scene: Unexplored, params: MapParams
) -> Grounding:
    """Ground the words in particles, relation by relation; queries have leaves [J, ..., P]."""
    num_relations = jnp.max(jnp.sum(queries.mention[:, FIGURE] != NONE, axis=0))
    queries, by_robot = split_robot_relations(queries)

    def body(index: Array, grounding: Grounding) -> Grounding:
        query, draws = select_row((queries, inputs.draws), index)
        return ground_relation(inputs.seen, query, by_robot, grounding, draws, scene, params=params)

    start = empty_grounding(num_mentions, *queries.relation.shape[1:])
    return jax.lax.fori_loop(0, num_relations, body, start)


@functools.cache
def _ground_sparse(num_mentions: int) -> Callable[..., Grounding]:
    """Build ``_ground`` of all particles, with a custom ``vmap`` rule for a batch of lanes."""

    def dense(inputs: ParticleInputs, queries: Query, *rest: Any) -> Grounding:
        return _ground(num_mentions, inputs, pick_queries(queries, inputs.reading), *rest)

    @custom_vmap
    def ground(is_asked: Array, *args: Any) -> Grounding:
        return dense(*args)  # a single lane grounds all its particles

    def rule(num_lanes: int, is_batched: Any, *args: Any) -> tuple[Grounding, Grounding]:
        def batch(leaf: Array, has_lanes: bool) -> Array:
            return leaf if has_lanes else jnp.broadcast_to(leaf, (num_lanes, *leaf.shape))

        if any(jax.tree.leaves(is_batched[-1])):
            # Parameters that differ between lanes: rare, and not worth gathering them too.
            axes = jax.tree.map(lambda has_lanes: 0 if has_lanes else None, tuple(is_batched[1:]))
            grounding = jax.vmap(dense, in_axes=axes, axis_size=num_lanes)(*args[1:])
        else:
            batched = jax.tree.map(batch, args[:-1], tuple(is_batched[:-1]))
            grounding = _ground_gathered(num_mentions, *batched, params=args[-1])
        return grounding, jax.tree.map(lambda _: True, grounding)

    ground.def_vmap(rule)
    return ground


def _ground_gathered(
    num_mentions: int,
    is_asked: Array,
    inputs: ParticleInputs,
    queries: Query,
    scene: Unexplored,
    params: MapParams,
) -> Grounding:
    """Gather the selected particles, bool[L, P], ground them in chunks, scatter to [L, ..., P]."""
    num_lanes, count = is_asked.shape
    size = num_lanes * count
    chunk = min(max(_MIN_CHUNK, -(-size // _NUM_CHUNKS)), size)
    padded = -(-size // chunk) * chunk
    is_selected = is_asked.reshape(size)
    order = jnp.nonzero(is_selected, size=padded, fill_value=0)[0]
    flat, all_queries = jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1), (inputs, queries)
    )
    table, num_readings = pack(flat), queries.relation.shape[-1]

    def ground_chunk(start: Array) -> Array:
        idx = jax.lax.dynamic_slice_in_dim(order, start, chunk)
        part, lane = unpack(table[:, idx], flat), idx // count
        column, local = lane * num_readings + part.reading, _gather_scene(scene, idx, lane)
        return pack(_ground(num_mentions, part, take(all_queries, column), local, params))

    template = jax.eval_shape(lambda: empty_grounding(num_mentions, size))
    num_rows = sum(math.prod(leaf.shape[:-1]) for leaf in jax.tree.leaves(template))
    num_asked = jnp.sum(is_selected)

    def is_unfinished(carry: tuple[Array, Array]) -> Array:
        return carry[0] < num_asked

    def process_chunk(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        start, result = carry
        result = jax.lax.dynamic_update_slice_in_dim(result, ground_chunk(start), start, axis=1)
        return start + chunk, result

    start = jnp.int32(0), jnp.zeros((num_rows, padded), jnp.float32)
    result = jax.lax.while_loop(is_unfinished, process_chunk, start)[1]
    row = jnp.maximum(jnp.cumsum(is_selected) - 1, 0)
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], num_lanes, count), -2, 0),
        unpack(result[:, row], template),
    )


def _gather_scene(scene: Unexplored, idx: Array, lane: Array) -> Unexplored:
    """Gather each particle's unexplored area, by flat index i32[n] and lane i32[n]."""
    maps, num_cells = scene.coverage.log_miss, scene.coverage.log_miss.shape[-1]

    def gather(values: Array) -> Array:
        return values[lane] if values.ndim == 1 else values.reshape(-1)[idx]

    return Unexplored(
        coverage=Coverage(log_miss=maps.reshape(-1, num_cells), area=scene.coverage.area[lane].T),
        first_row=lane * maps.shape[1] + gather(scene.first_row),
        log_area=scene.log_area[lane],
        log_unseen=gather(scene.log_unseen),
        points=jnp.moveaxis(scene.points[lane, ..., 0], 0, -1),
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
    num_pooled: Array | None = None,
) -> tuple[SemanticMap, Array]:
    """Sample an interpretation and its grounding for each particle (eq. 7a).

    Args:
        key: random key.
        belief: the observed map and the coverage map.
        readings: interpretations of the sentence.
        params: relations, concentration.
        context: poses at which relations were heard; all at the belief's viewer by default.
        is_asked: bool[P], the particles to ground; all by default. Under ``vmap`` no others are.
        num_pooled: f32[], number of types that share one rate (``counts``); None: no sharing.

    Returns:
        Particles with fresh groundings, and f32[P], log of the evidence estimated by each. In
        particles that were not selected the groundings are undefined and the evidence is −∞.
    """
    particles = belief.particles
    is_asked = jnp.ones(belief.log_weight.shape, bool) if is_asked is None else is_asked
    uniform, draws, scene = _draw_randoms(key, belief, readings.figure.shape[1])
    scene = scene._replace(num_pooled=num_pooled)
    cumulative = jnp.cumsum(jnp.exp(readings.log_probability))
    is_later = cumulative[:-1, None] <= (uniform * cumulative[-1])[None]
    reading = jnp.sum(is_later, axis=0).astype(jnp.int32)
    inputs = ParticleInputs(observed(particles), draws, reading)
    context = current_context(readings, belief.viewer) if context is None else context
    queries = build_queries(readings, context, params.relations, scene.log_area)
    ground = _ground_sparse(readings.mention_type.shape[1])
    grounding = ground(is_asked, inputs, queries, scene, params)
    grounded = replace(
        particles,
        reading=reading,
        referent=grounding.slot,
        anchor=grounding.anchor,
        root=grounding.root,
        hypothesis_x=grounding.x,
        hypothesis_y=grounding.y,
        is_mentioned=grounding.is_grounded,
    )
    return grounded, jnp.where(is_asked, grounding.log_weight, -jnp.inf)
