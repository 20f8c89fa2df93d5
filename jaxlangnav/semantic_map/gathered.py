"""Words grounded in the particles that need it, of all lanes together (section 3.2, eq. 7a).

At most steps few hypotheses are refuted, but which and how many differs from episode to episode,
so plain ``vmap`` would ground the words in every particle of every lane. Here the particles that
need it are gathered from all lanes, grounded in pieces of one size, and put back.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap

from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import pack, row_of, take, unpack
from jaxlangnav.semantic_map.candidates import Draws, Grounding, Scene, Seen, nothing_grounded
from jaxlangnav.semantic_map.choose import ground_relation
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.said import FIGURE, Said, hear

_PIECES, _LEAST_PIECE = 8, 256
"""Pieces in which the particles of all lanes are grounded, and the least size of one: more pieces
would waste less of the last one, but leave a wide device idle."""

Own = tuple[Seen, Draws, Array]
"""What is each particle's own: what it has seen, leaves [J, ..., P] of what is drawn, and the
reading that it believes, i32[P]."""


def ground_all(
    num_mentions: int, own: Own, told: Said, scene: Scene, *, params: MapParams
) -> Grounding:
    """Ground the words of all particles of one lane: leaves [..., P]."""
    seen, draws, reading = own
    return _ground(num_mentions, seen, hear(told, reading), draws, scene, params)


def _ground(
    num_mentions: int, seen: Seen, said: Said, draws: Draws, scene: Scene, params: MapParams
) -> Grounding:
    """Ground the words of particles, relation by relation; of what is said leaves [J, ..., P]."""
    num_relations = jnp.max(jnp.sum(said.mention[:, FIGURE] != NONE, axis=0))

    def body(index: Array, grounding: Grounding) -> Grounding:
        one, drawn = row_of((said, draws), index)
        return ground_relation(seen, one, grounding, drawn, scene, params=params)

    nothing = nothing_grounded(num_mentions, *said.relation.shape[1:])
    return jax.lax.fori_loop(0, num_relations, body, nothing)


@functools.cache
def ground_sparse(num_mentions: int) -> Callable[..., Grounding]:
    """Build ``ground_all`` with a rule of its own for ``vmap`` over lanes."""

    def dense(own: Own, told: Said, scene: Scene, params: MapParams) -> Grounding:
        return ground_all(num_mentions, own, told, scene, params=params)

    @custom_vmap
    def ground(is_asked: Array, *arguments: Any) -> Grounding:
        del is_asked  # of one lane all are grounded
        return dense(*arguments)

    def rule(num_lanes: int, is_batched: Any, *arguments: Any) -> tuple[Grounding, Grounding]:
        if any(jax.tree.leaves(is_batched[-1])):
            # Each lane with numbers of its own: rare, and not worth gathering them too.
            axes = jax.tree.map(lambda has_lanes: 0 if has_lanes else None, tuple(is_batched[1:]))
            grounding = jax.vmap(dense, in_axes=axes, axis_size=num_lanes)(*arguments[1:])
        else:

            def spread(leaf: Array, has_lanes: bool) -> Array:
                return leaf if has_lanes else jnp.broadcast_to(leaf, (num_lanes, *leaf.shape))

            of_lanes = jax.tree.map(spread, arguments[:-1], tuple(is_batched[:-1]))
            asked, own, told, scene = of_lanes
            grounding = _ground_gathered(num_mentions, asked, own, told, scene, arguments[-1])
        return grounding, jax.tree.map(lambda _: True, grounding)

    ground.def_vmap(rule)
    return ground


def _ground_gathered(
    num_mentions: int,
    is_asked: Array,
    own: Own,
    told: Said,
    scene: Scene,
    params: MapParams,
) -> Grounding:
    """Gather the particles asked, bool[L, P], ground them piece by piece, put back [L, ..., P]."""
    num_lanes, number = is_asked.shape
    size = num_lanes * number
    piece = min(max(_LEAST_PIECE, -(-size // _PIECES)), size)
    room = -(-size // piece) * piece
    asked = is_asked.reshape(size)
    order = jnp.nonzero(asked, size=room, fill_value=0)[0]
    side_by_side, all_told = jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1), (own, told)
    )
    table, num_readings = pack(side_by_side), told.relation.shape[-1]

    def ground_piece(start: Array) -> Array:
        chosen = jax.lax.dynamic_slice_in_dim(order, start, piece)
        seen, draws, reading = unpack(table[:, chosen], side_by_side)
        lane = chosen // number
        said, theirs = take(all_told, lane * num_readings + reading), _scene_of(scene, chosen, lane)
        return pack(_ground(num_mentions, seen, said, draws, theirs, params))

    form = jax.eval_shape(lambda: nothing_grounded(num_mentions, size))
    rows = sum(math.prod(leaf.shape[:-1]) for leaf in jax.tree.leaves(form))
    found = _piecewise(ground_piece, jnp.sum(asked), piece, jnp.zeros((rows, room), jnp.float32))
    place = jnp.maximum(jnp.cumsum(asked) - 1, 0)
    return jax.tree.map(
        lambda leaf: jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], num_lanes, number), -2, 0),
        unpack(found[:, place], form),
    )


def _scene_of(scene: Scene, chosen: Array, lane: Array) -> Scene:
    """Tell particles of several lanes, i32[n] of all and i32[n] theirs, in what scene each is."""
    maps, num_cells = scene.coverage.log_miss, scene.coverage.log_miss.shape[-1]

    def own(values: Array) -> Array:
        return values[lane] if values.ndim == 1 else values.reshape(-1)[chosen]

    return Scene(
        coverage=Coverage(log_miss=maps.reshape(-1, num_cells), area=scene.coverage.area[lane].T),
        first_row=lane * maps.shape[1] + own(scene.first_row),
        log_area=scene.log_area[lane],
        log_unseen=own(scene.log_unseen),
        num_pooled=None if scene.num_pooled is None else scene.num_pooled[lane],
    )


def _piecewise(
    ground: Callable[[Array], Array], number: Array, piece: int, nothing: Array
) -> Array:
    """Fill the first columns of a table, f32[rows, room], by pieces; at most a piece too many."""

    def is_left(carry: tuple[Array, Array]) -> Array:
        return carry[0] < number

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        start, found = carry
        found = jax.lax.dynamic_update_slice_in_dim(found, ground(start), start, axis=1)
        return start + piece, found

    return jax.lax.while_loop(is_left, body, (jnp.int32(0), nothing))[1]
