"""Candidate referents of the figure and landmarks of one relation (section 3.2, eq. 7a).

Each end is an observed object, the grounding chosen by an earlier relation, or a new object.

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
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, Query

NUM_UNSEEN = 2
"""Number of positions sampled from the unexplored area for each particle and relation."""


class Draws(NamedTuple):
    """Random numbers for grounding one relation in one particle."""

    distance: Array  # f32[2, ...] standard normal: distance of a new figure; of a new landmark
    angle: Array  # f32[2, ...] standard normal: direction of a new figure; of a new landmark
    choice: Array  # f32[...] uniform: selects the grounding
    unseen_x: Array  # f32[NUM_UNSEEN, ...] metres, positions in the unexplored area
    unseen_y: Array  # f32[NUM_UNSEEN, ...]


class Observed(NamedTuple):
    """Observed objects of a particle: the candidate referents."""

    object_type: Array  # i32[O, ...] type codes; NONE in empty slots
    x: Array  # f32[O, ...] metres, map frame
    y: Array  # f32[O, ...]
    existence: Array | None = None  # f32[O, ...] existence probability; None: all exist


def observed(particles: SemanticMap) -> Observed:
    """List the observed objects of particles."""
    types, existence = particles.object_type, particles.existence
    x, y = (leaf[: types.shape[0]] for leaf in (particles.mean_x, particles.mean_y))
    return Observed(types, x, y, existence if existence.shape[0] else None)


class Unexplored(NamedTuple):
    """The unexplored area, shared by all particles of an episode during grounding.

    With a heading bias ``first_row`` and ``log_unseen`` have the particle axis, with particles of
    several episodes all fields; the coverage maps are then stacked along the row axis.
    """

    coverage: Coverage
    first_row: Array  # i32[] first row of the episode's map in ``coverage``
    log_area: Array  # f32[] log A, square metres
    log_unseen: Array  # f32[] log u, u the unseen fraction of the area
    points: Array  # f32[2, S, 1 or ...] metres, x and y of a sample of it
    num_pooled: Array | None = None  # f32[] T, types that have one rate (``counts``); None: none


class Grounding(NamedTuple):
    """Referents of the mentions so far: the carry of the loop over relations."""

    slot: Array  # i32[M, ...] observed slot; NONE while hypothesised
    x: Array  # f32[M, ...] metres
    y: Array  # f32[M, ...]
    anchor: Array  # i32[M, ...] slot in [0, N) or NONE
    root: Array  # i32[M, ...] observed slot or NONE
    is_grounded: Array  # bool[M, ...] an earlier relation has grounded the mention
    log_weight: Array  # f32[...] estimated log-evidence of the relations so far


def empty_grounding(num_mentions: int, *batch: int) -> Grounding:
    """Build the loop carry before the first relation, for a batch of particles."""
    none = jnp.full((num_mentions, *batch), NONE, jnp.int32)
    zero = jnp.zeros((num_mentions, *batch), jnp.float32)
    return Grounding(none, zero, zero, none, none, jnp.zeros(none.shape, bool), jnp.zeros(batch))


class Candidates(NamedTuple):
    """Candidates for the ends of a relation: observed objects, or the earlier grounding."""

    x: Array  # f32[2, O + 1, ...] metres; the last entry is the earlier grounding
    y: Array  # f32[2, O + 1, ...]
    log_prior: Array  # f32[2, O + 1, ...] −∞ where not a candidate
    log_pair_gain: Array  # f32[O, O, ...] log-prior of pairs of one type, less the sum of both
    is_open: Array  # bool[2, ...] not grounded earlier: may also be a new object
    earlier: Grounding  # the earlier grounding, leaves [2, ...]


def list_candidates(
    seen: Observed, query: Query, grounding: Grounding, scene: Unexplored, *, params: MapParams
) -> Candidates:
    """List candidates for both ends: earlier groundings, or observed objects of their types."""
    decided = [lookup(leaf, query.mention) for leaf in grounding[:-1]]
    earlier = Grounding(*decided, log_weight=grounding.log_weight)
    # With the robot as the landmark, or with none, the landmark is the viewer.
    is_viewer = jnp.stack([jnp.zeros_like(query.is_by_object), ~query.is_by_object])
    is_open = ~is_viewer & ~earlier.is_grounded
    type_matches = is_type(seen.object_type[None], query.types[:, None])
    slots = append_axes(jnp.arange(seen.x.shape[0]), type_matches.ndim - 1)[None]
    is_candidate = type_matches & is_open[:, None] & ((query.excluded[:, None] >> slots) & 1 == 0)
    log_prior, log_pair_gain = _log_priors(seen, query, type_matches, grounding, scene, params)

    def append(objects: Array, decided_xy: Array) -> Array:
        objects = jnp.broadcast_to(objects, is_candidate.shape)
        return jnp.concatenate([objects, decided_xy[:, None]], axis=1)

    robot_x, robot_y, _ = (prepend_axes(v, is_open.ndim) for v in jnp.unstack(query.viewer))
    log_prior = jnp.where(is_candidate, log_prior, -jnp.inf)
    return Candidates(
        x=append(seen.x[None], jnp.where(is_viewer, robot_x, earlier.x)),
        y=append(seen.y[None], jnp.where(is_viewer, robot_y, earlier.y)),
        log_prior=append(log_prior, jnp.where(is_open, -jnp.inf, 0.0)),
        log_pair_gain=log_pair_gain,
        is_open=is_open,
        earlier=earlier,
    )


def _log_priors(
    seen: Observed,
    query: Query,
    type_matches: Array,
    grounding: Grounding,
    scene: Unexplored,
    params: MapParams,
) -> tuple[Array, Array]:
    """Compute the log-prior of observed objects as referents, 1/λ, relative to none being one.

    f32[2, O, ...], and ``Candidates.log_pair_gain``.
    """
    ndim, is_counted, num_pooled, num_grounded = type_matches.ndim - 1, type_matches, None, None
    if scene.num_pooled is not None:  # objects of all types count, except grounded ones
        is_counted = jnp.broadcast_to((seen.object_type != NONE)[None], type_matches.shape)
        num_pooled = prepend_axes(scene.num_pooled, ndim)
        num_grounded = jnp.sum(grounding.slot != NONE, axis=0)[None]
    num_seen, unseen = jnp.sum(is_counted, axis=1), jnp.exp(prepend_axes(scene.log_unseen, ndim))
    num_seen = num_seen if num_grounded is None else num_seen - num_grounded
    expected = functools.partial(log_expected, params=params)
    log_area = prepend_axes(scene.log_area, ndim)
    log_one, log_two = (
        expected(jnp.maximum(num_seen - n, 0), unseen, num_pooled=num_pooled) for n in (1, 2)
    )
    log_prior = (log_area - log_one)[:, None]
    if seen.existence is not None:
        existence = jnp.where(is_counted, seen.existence[None], 0.0)
        others = jnp.sum(existence, axis=1, keepdims=True) - existence
        if num_pooled is not None and num_grounded is not None:
            others, num_pooled = others - num_grounded[:, None], num_pooled[:, None]
        log_others = expected(jnp.maximum(others, 0.0), unseen[:, None], num_pooled=num_pooled)
        log_prior = log_area[:, None] - log_others
        log_prior = log_prior + jnp.log(jnp.maximum(seen.existence, 1e-9))[None]
    is_any, label = is_anything(query.types), label_of(seen.object_type)
    is_alike = label[:, None] == label[None]
    records = is_alike, seen, scene.log_area, scene.log_unseen, scene.num_pooled
    log_typed = jnp.broadcast_to((log_one - log_two)[FIGURE], seen.x.shape)
    default, untyped = jnp.concatenate([log_typed] * 2), functools.partial(_log_untyped, params)
    log_untyped = skip_unless_any(jnp.any(is_any, axis=0), untyped, records, default)
    log_of_any, log_gain = jnp.split(log_untyped, 2)
    # With a pooled rate, objects of different types are correlated like those of one type.
    shares_rate = is_alike if scene.num_pooled is None else jnp.ones_like(is_alike)
    log_pair_gain = jnp.where(shares_rate, log_gain[:, None], 0.0)
    return jnp.where(is_any[:, None], log_of_any[None], log_prior), log_pair_gain


def _log_untyped(
    params: MapParams, records: tuple[Array, Observed, Array, Array, Array | None]
) -> Array:
    """Compute log-prior and pair gain of objects, f32[2 O, ...], for a mention without a type."""
    is_alike, seen, log_area, log_unseen, num_pooled = records
    # The type is one of the k observed ones or an unobserved one, all equally probable. So an
    # object has 1 / (k + 1) of the weight that it has for a mention of its type.
    is_filled = seen.object_type != NONE
    unseen = prepend_axes(jnp.exp(log_unseen), is_filled.ndim)
    precedes = append_axes(jnp.asarray(np.tri(len(is_filled), k=-1, dtype=bool)), is_alike.ndim)
    is_new_type = is_filled & ~jnp.any(is_alike & precedes, axis=1)
    existence = is_filled.astype(jnp.float32) if seen.existence is None else seen.existence
    if num_pooled is not None:
        is_alike, num_pooled = is_filled[None], prepend_axes(num_pooled, is_filled.ndim)
    num_alike = jnp.sum(jnp.where(is_alike, existence[None], 0.0), axis=1)
    others = jnp.maximum(num_alike - existence, 0.0)
    expected = functools.partial(log_expected, unseen=unseen, params=params, num_pooled=num_pooled)
    log_one = expected(others)
    log_two = expected(jnp.maximum(others - 1.0, 0.0))
    log_type_prob = -jnp.log1p(jnp.sum(is_new_type, axis=0).astype(jnp.float32))
    log_weight = prepend_axes(log_area, log_one.ndim) - log_one + log_type_prob[None]
    if seen.existence is not None:
        log_weight = log_weight + jnp.log(jnp.maximum(seen.existence, 1e-9))
    return jnp.concatenate([log_weight, log_one - log_two])
