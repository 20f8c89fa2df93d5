"""Candidate referents of the figure and landmarks of one relation (section 3.2, eq. 7a).

Each end is an observed object, the place that an earlier relation decided, or new.

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type, label_of
from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import append_axes, lookup, prepend_axes, skip_unless_any
from jaxlangnav.semantic_map.counts import log_expected
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, Query

NUM_UNSEEN = 2
"""Places drawn from the unexplored area for each particle and relation."""


class Draws(NamedTuple):
    """Random numbers for grounding one relation in one particle."""

    distance: Array  # f32[2, ...] standard normal: distance of a new figure; of a new landmark
    angle: Array  # f32[2, ...] standard normal: direction of a new figure; of a new landmark
    choice: Array  # f32[...] which grounding
    unseen_x: Array  # f32[NUM_UNSEEN, ...] metres, places in the unexplored area
    unseen_y: Array  # f32[NUM_UNSEEN, ...]


class Observed(NamedTuple):
    """What a particle has seen, as far as words can refer to it."""

    object_type: Array  # i32[O, ...] kinds; NONE in empty slots
    x: Array  # f32[O, ...] metres, map frame
    y: Array  # f32[O, ...]
    existence: Array | None = None  # f32[O, ...] probability that it exists; None: all of it does


class Unexplored(NamedTuple):
    """What all particles of an episode share while words are grounded.

    With particles of several episodes, everything has the particle axis too, and the coverage
    maps stand one below the other.
    """

    coverage: Coverage
    first_row: Array  # i32[] where in ``coverage`` the episode's map begins
    log_area: Array  # f32[] log A, square metres
    log_unseen: Array  # f32[] log u
    num_pooled: Array | None = None  # f32[] T, types that have one rate (``counts``); None: none


class Grounding(NamedTuple):
    """Carry over the relations of a reading: what the mentions refer to so far."""

    slot: Array  # i32[M, ...] observed slot; NONE while hypothesised
    x: Array  # f32[M, ...] metres
    y: Array  # f32[M, ...]
    anchor: Array  # i32[M, ...] slot in [0, N) or NONE
    root: Array  # i32[M, ...] observed slot or NONE
    is_grounded: Array  # bool[M, ...]
    log_weight: Array  # f32[...]


def nothing_grounded(num_mentions: int, *batch: int) -> Grounding:
    """Build the carry before the first relation, for a batch of particles."""
    none = jnp.full((num_mentions, *batch), NONE, jnp.int32)
    zero = jnp.zeros((num_mentions, *batch), jnp.float32)
    return Grounding(none, zero, zero, none, none, jnp.zeros(none.shape, bool), jnp.zeros(batch))


class Candidates(NamedTuple):
    """What the ends of a relation may be: each observed object, or the place already decided."""

    x: Array  # f32[2, O + 1, ...] metres; the last entry is the place already decided
    y: Array  # f32[2, O + 1, ...]
    log_prior: Array  # f32[2, O + 1, ...] −∞ where it is no candidate
    log_alike: Array  # f32[O, O, ...] what observed figures and landmarks of one type weigh more
    # than each by itself
    is_open: Array  # bool[2, ...] nothing decided: may also be a new object
    earlier: Grounding  # what they refer to already, leaves [2, ...]


def list_candidates(
    seen: Observed, query: Query, grounding: Grounding, scene: Unexplored, *, params: MapParams
) -> Candidates:
    """List what the ends may be: what has been decided, or each seen object of their types."""
    decided = [lookup(leaf, query.mention) for leaf in grounding[:-1]]
    earlier = Grounding(*decided, log_weight=grounding.log_weight)
    # With the robot as the landmark, or with none, the figure stands against the viewer.
    is_viewer = jnp.stack([jnp.zeros_like(query.is_by_object), ~query.is_by_object])
    is_open = ~is_viewer & ~earlier.is_grounded
    is_kind = is_type(seen.object_type[None], query.kind[:, None])
    slots = append_axes(jnp.arange(seen.x.shape[0]), is_kind.ndim - 1)[None]
    may_be = is_kind & is_open[:, None] & ((query.excluded[:, None] >> slots) & 1 == 0)
    log_bystander, log_alike = _log_bystanders(seen, query, is_kind, grounding, scene, params)

    def append(objects: Array, place: Array) -> Array:
        objects = jnp.broadcast_to(objects, may_be.shape)
        return jnp.concatenate([objects, place[:, None]], axis=1)

    viewer_x, viewer_y, _ = (prepend_axes(one, is_open.ndim) for one in jnp.unstack(query.viewer))
    log_bystander = jnp.where(may_be, log_bystander, -jnp.inf)
    return Candidates(
        x=append(seen.x[None], jnp.where(is_viewer, viewer_x, earlier.x)),
        y=append(seen.y[None], jnp.where(is_viewer, viewer_y, earlier.y)),
        log_prior=append(log_bystander, jnp.where(is_open, -jnp.inf, 0.0)),
        log_alike=log_alike,
        is_open=is_open,
        earlier=earlier,
    )


def _log_bystanders(
    seen: Observed,
    query: Query,
    is_kind: Array,
    grounding: Grounding,
    scene: Unexplored,
    params: MapParams,
) -> tuple[Array, Array]:
    """Weigh what has been seen against being a bystander, 1/λ: of its type all but one are.

    f32[2, 1, ...] or f32[2, O, ...]; and ``Candidates.log_alike``: of a pair all but two are.
    """
    ndim, is_counted, pooled, num_meant = is_kind.ndim - 1, is_kind, None, None
    if scene.num_pooled is not None:  # things of all types count, but those meant already
        is_counted = jnp.broadcast_to((seen.object_type != NONE)[None], is_kind.shape)
        pooled = prepend_axes(scene.num_pooled, ndim)
        num_meant = jnp.sum(grounding.slot != NONE, axis=0)[None]
    number, unseen = jnp.sum(is_counted, axis=1), jnp.exp(prepend_axes(scene.log_unseen, ndim))
    number = number if num_meant is None else number - num_meant
    expected = functools.partial(log_expected, params=params)
    log_area = prepend_axes(scene.log_area, ndim)
    log_one, log_two = (
        expected(jnp.maximum(number - but, 0), unseen, num_pooled=pooled) for but in (1, 2)
    )
    log_bystander = (log_area - log_one)[:, None]
    if seen.existence is not None:
        real = jnp.where(is_counted, seen.existence[None], 0.0)
        others = jnp.sum(real, axis=1, keepdims=True) - real
        if pooled is not None and num_meant is not None:
            others, pooled = others - num_meant[:, None], pooled[:, None]
        log_others = expected(jnp.maximum(others, 0.0), unseen[:, None], num_pooled=pooled)
        log_bystander = log_area[:, None] - log_others
        log_bystander = log_bystander + jnp.log(jnp.maximum(seen.existence, 1e-9))[None]
    is_any, label = is_anything(query.kind), label_of(seen.object_type)
    is_alike = label[:, None] == label[None]
    places = scene.log_area, scene.log_unseen, scene.num_pooled
    records = (jnp.concatenate([seen.x, seen.x]), is_alike, seen, *places)
    found = skip_unless_any(
        jnp.any(is_any, axis=0), lambda given: _of_any_type(*given[1:], params=params), records
    )
    log_of_any, log_gain_of_any = jnp.split(found, 2)
    log_gain = jnp.where(jnp.any(is_any, axis=0), log_gain_of_any, (log_one - log_two)[FIGURE])
    # Of one rate things of two types hang together as those of one type do.
    hang_together = is_alike if scene.num_pooled is None else jnp.ones_like(is_alike)
    log_alike = jnp.where(hang_together, log_gain[:, None], 0.0)
    return jnp.where(is_any[:, None], log_of_any[None], log_bystander), log_alike


def _of_any_type(
    is_alike: Array,
    seen: Observed,
    log_area: Array,
    log_unseen: Array,
    num_pooled: Array | None,
    *,
    params: MapParams,
) -> Array:
    """Weigh what has been seen, f32[2 O, ...], as a thing that a sentence calls by no type."""
    # Its type is one of the k that have been seen or one that has not, each as probable. So a thing
    # of a type weighs 1 / (k + 1) of what it would as one called by that type.
    is_there = seen.object_type != NONE
    unseen = prepend_axes(jnp.exp(log_unseen), is_there.ndim)
    is_earlier = append_axes(jnp.asarray(np.tri(len(is_there), k=-1, dtype=bool)), is_alike.ndim)
    is_new_type = is_there & ~jnp.any(is_alike & is_earlier, axis=1)
    real = is_there.astype(jnp.float32) if seen.existence is None else seen.existence
    if num_pooled is not None:
        is_alike, num_pooled = is_there[None], prepend_axes(num_pooled, is_there.ndim)
    number = jnp.sum(jnp.where(is_alike, real[None], 0.0), axis=1)
    others = jnp.maximum(number - real, 0.0)
    expected = functools.partial(log_expected, unseen=unseen, params=params, num_pooled=num_pooled)
    log_one = expected(others)
    log_two = expected(jnp.maximum(others - 1.0, 0.0))
    log_share = -jnp.log1p(jnp.sum(is_new_type, axis=0).astype(jnp.float32))
    log_weight = prepend_axes(log_area, log_one.ndim) - log_one + log_share[None]
    if seen.existence is not None:
        log_weight = log_weight + jnp.log(jnp.maximum(seen.existence, 1e-9))
    return jnp.concatenate([log_weight, log_one - log_two])
