"""Relation queries: one relation of a particle's sampled interpretation (section 3.2, eq. 7a).

A relation locates a figure with respect to a landmark. Both are its *ends*: of any leaf [2, ...]
the first entry is the figure's, the second the landmark's. "Between" has two relations, one per
landmark: the first asserts that its landmark exists; the second has that as its other landmark.

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings, UtteranceContext
from jaxlangnav.numerics.batching import lookup, pack, prepend_axes, skip_unless_any, unpack
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations import (
    SIDES,
    Density,
    ReferenceFrame,
    RelationModel,
    between,
    density_of,
    holds_at,
    log_density,
    log_density_in_frame,
    robot_frame,
    sample_pdf,
    to_frame,
    to_map,
    viewer_frame,
    without_range,
)
from jaxlangnav.semantic_map.params import MapParams

FIGURE, LANDMARK = 0, 1
_Pairs = tuple[Array, Array, Array, Array]


class Query(NamedTuple):
    """One relation of a particle's sampled interpretation."""

    mention: Array  # i32[2, ...] the ends; NONE where the reading has no such relation or landmark
    types: Array  # i32[2, ...] their object types; ROBOT; NONE
    relation: Array  # i32[...] index; NONE where the figure merely exists
    rank: Array  # i32[...] 1 "nearest", 2 "the second", ...; 0 without a rank
    other: Array  # i32[...] mention of the other landmark of "between", grounded before; NONE
    is_ordinal: Array  # bool[...] "the second", "farthest": a rank without a distance
    is_rangeless: Array  # bool[...] ordinal or "on your left": at any distance
    sides: Array  # i32[J, ...] of an ordinal rank: the side relations of its figure; NONE
    pdf: Density  # leaves f32[...]
    viewer: Array  # f32[3, ...] robot's pose when heard, map frame; see ``other_landmark``
    excluded: Array  # i32[2, ...] observed slots excluded for the ends: bit s is slot s

    @property
    def is_between(self) -> Array:
        """Whether the figure lies between the landmark and another one, bool[...]."""
        return self.other != NONE

    @property
    def other_landmark(self) -> tuple[Array, Array]:
        """Position of the other landmark of "between", f32[1, ...] metres: it is the viewer."""
        return self.viewer[0][None], self.viewer[1][None]

    @property
    def is_by_robot(self) -> Array:
        """Whether the landmark is the robot itself, bool[...]."""
        return self.types[LANDMARK] == ROBOT

    @property
    def is_by_object(self) -> Array:
        """Whether the landmark is an object, bool[...]."""
        return (self.mention[LANDMARK] != NONE) & ~self.is_by_robot

    def frame(self, x: Array, y: Array) -> ReferenceFrame:
        """Build the frame of reference of a relation to landmarks at f32[n, ...] metres.

        It is the viewer's frame, or the robot's intrinsic one where the robot is the landmark.
        """
        viewer_x, viewer_y, heading = (prepend_axes(v, x.ndim) for v in jnp.unstack(self.viewer))
        is_by_robot = prepend_axes(self.is_by_robot, x.ndim)
        return jax.tree.map(
            lambda robot, viewer: jnp.where(is_by_robot, robot, viewer),
            robot_frame(heading),
            viewer_frame(viewer_x, viewer_y, x, y),
        )

    def log_density(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Evaluate the relation's log-density of figures, each in the frame of its landmark.

        Positions are f32[n, ...] metres, map frame; f32[n, ...], log-density per square metre.
        """
        frame = self.frame(landmark_x, landmark_y)
        log_single = log_density(self.pdf, x - landmark_x, y - landmark_y, frame)

        def log_between(positions: _Pairs) -> Array:
            return between.log_density(positions[:2], positions[2:], self.other_landmark)

        ends = x, y, landmark_x, landmark_y
        return skip_unless_any(self.is_between, log_between, ends, log_single)

    @property
    def is_place_by_robot(self) -> Array:
        """Whether it is a density of places around the robot, no rank, bool[...]."""
        return self.is_by_robot & ~self.is_ordinal & (self.relation != NONE)

    def log_by_robot(self, x: Array, y: Array, log_area: Array, error_rate: Array) -> Array:
        """Evaluate log[(1 − ε) A f + ε] of figures related to the robot, f32[n, ...]."""
        viewer = (jnp.broadcast_to(v[None], x.shape) for v in self.viewer[:2])
        log_holds = self.log_density(x, y, *viewer) + prepend_axes(log_area, x.ndim)
        return jnp.logaddexp(jnp.log1p(-error_rate) + log_holds, jnp.log(error_rate))

    def holds(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Test whether the relation holds for figures, bool[n, ...]; see ``log_density``.

        Limits: without a relation, or with a rank, it holds anywhere.
        """
        frame, dx, dy = self.frame(landmark_x, landmark_y), x - landmark_x, y - landmark_y
        along, lateral = to_frame(frame, dx, dy)
        relation, has_range = jnp.maximum(self.relation, 0)[None], self.pdf.has_range[None] > 0.0
        is_single = holds_at(relation, along, lateral, has_range=has_range)
        is_between = between.lies_between((x, y), (landmark_x, landmark_y), self.other_landmark)
        has_position = (self.relation != NONE) & (self.rank <= 0)
        return jnp.where(self.is_between[None], is_between, is_single) | ~has_position[None]

    def draw(
        self, distance: Array, angle: Array, model: RelationModel
    ) -> tuple[Array, Array, Array]:
        """Sample a new figure relative to its landmark, and a new landmark relative to its figure.

        From standard normals f32[2, ...]: along and lateral offset from landmark to figure in the
        frame, f32[2, ...], and log-density of the landmark, f32[1, ...]; in units of ``offset``.
        """
        relation = jnp.maximum(self.relation, 0)[None]
        along, lateral = sample_pdf(self.pdf, model, relation, distance, angle)
        log_drawn = log_density_in_frame(self.pdf, along[LANDMARK:], lateral[LANDMARK:])
        single, pair = (along, lateral, log_drawn), between.sample(distance, angle)
        return jax.tree.map(lambda a, b: jnp.where(self.is_between[None], b, a), single, pair)

    def offset(
        self, x: Array, y: Array, along: Array, lateral: Array
    ) -> tuple[Array, Array, Array]:
        """Rotate drawn offsets, f32[n, ...] units, into map axes: metres, and log m² per unit².

        The unit is a metre; for "between" it is the distance from the other landmark. x and y are
        the positions that the offsets are relative to, metres, map frame.
        """
        other_x, other_y = self.other_landmark
        base_x, base_y = x - other_x, y - other_y
        squared = base_x * base_x + base_y * base_y + 1e-6
        squared = jnp.where(self.is_between[None], squared, 1.0)
        unit = jnp.sqrt(squared)
        offset_x, offset_y = to_map(self.frame(x, y), along, lateral)
        return unit * offset_x, unit * offset_y, jnp.log(squared)


def current_context(readings: Readings, viewer: Array) -> UtteranceContext:
    """Build the context of an utterance heard at pose f32[3], with no objects excluded."""
    return UtteranceContext(
        viewer=jnp.broadcast_to(viewer, (*readings.relation.shape, 3)),
        excluded=jnp.zeros_like(readings.mention_type),
    )


def build_queries(
    readings: Readings, context: UtteranceContext, model: RelationModel, log_area: Array
) -> Query:
    """Build the queries of all relations of K readings, leaves [J, ..., K]; area in log m²."""
    build = jax.vmap(_build_query, in_axes=(0, 0, None, None), out_axes=-1)
    return build(readings, context, model, log_area)


@pytree
class Utterances:
    """Utterances with the context and parameters of their interpretation."""

    readings: Readings  # K interpretations with M mentions
    context: UtteranceContext  # poses at which they were heard
    params: MapParams  # relations, ε


def pick_queries(queries: Query, reading: Array) -> Query:
    """Select the queries of each particle's reading, i32[P]: leaves [J, ..., P]."""
    rows = pack(queries).T[..., None]
    return unpack(lookup(rows, jnp.broadcast_to(reading, (rows.shape[1], *reading.shape))), queries)


def split_robot_relations(queries: Query) -> tuple[Query, Query]:
    """Split off relations to the robot, so that they weigh referents before one is chosen.

    Of mentions that an earlier relation grounds. The rest, and what is split off, leaves [J, ...];
    in either, a relation of the other is none. Weighed only once chosen, referents on the stated
    side would be left to a few particles: all others would have chosen the likelier pair.
    """
    ends, figures = queries.mention, enumerate(queries.mention[:, None, None, FIGURE])
    is_grounded = jnp.stack([jnp.any(ends[:j] == one, axis=(0, 1)) for j, one in figures])
    is_split = (is_grounded & jax.vmap(lambda query: query.is_place_by_robot)(queries))[:, None]
    rest, split = (jnp.where(is_split == out, NONE, queries.mention) for out in (True, False))
    return queries._replace(mention=rest), queries._replace(mention=split)


def weigh_by_robot(
    log_weight: Array, queries: Query, mention: Array, pairs: _Pairs, log_area: Array, rate: Array
) -> Array:
    """Add ``log_by_robot`` of J relations to the robot to the log-weights of pairs, f32[n, ...].

    Leaves of ``queries`` are [J, ...]; the ends' mentions i32[2, ...], NONE if not to be weighed.
    """

    def evaluate(records: tuple[Array, _Pairs]) -> Array:
        log_weight, pairs = records

        def of_relation(query: Query) -> Array:
            is_end = (query.mention[:LANDMARK] == mention) & (mention != NONE)
            ends = (query.log_by_robot(*at, log_area, rate) for at in (pairs[:2], pairs[2:]))
            return jnp.sum(jnp.where(is_end[:, None], jnp.stack([*ends]), 0.0), axis=0)

        return log_weight + jnp.sum(jax.lax.map(of_relation, queries), axis=0)

    is_end = (queries.mention[:, :LANDMARK] == mention[None]) & (mention != NONE)[None]
    is_any = jnp.any(is_end, axis=(0, 1))
    return skip_unless_any(is_any, evaluate, (log_weight, pairs), log_weight)


def _split_between(reading: Readings) -> tuple[Readings, Array]:
    """Split each "between": its first relation asserts only that its landmark exists.

    The second gets that mention as its other landmark, i32[J]; NONE elsewhere.
    """
    is_between, figure = reading.relation == BETWEEN, reading.figure
    same = (figure[:, None] == figure[None]) & is_between[:, None] & is_between[None]
    is_earlier = same & np.tri(figure.size, k=-1, dtype=bool)
    # A figure may have several "between" relations, each with two landmarks.
    last = jnp.max(jnp.where(is_earlier, np.arange(figure.size)[None], 0), axis=1)
    second = is_between & (jnp.sum(is_earlier, axis=1) % 2 == 1)
    other = jnp.where(second, reading.landmark[last], NONE)
    first = is_between & ~second
    return replace(
        reading,
        figure=jnp.where(first, reading.landmark, figure),
        relation=jnp.where(first, NONE, reading.relation),
        landmark=jnp.where(first, NONE, reading.landmark),
    ), other


def _build_query(
    reading: Readings, context: UtteranceContext, model: RelationModel, log_area: Array
) -> Query:
    """Build the queries of one interpretation's relations, leaves [J, ...]."""
    reading, other = _split_between(reading)
    mention = jnp.stack([reading.figure, reading.landmark], axis=1)
    types = jnp.where(mention == NONE, NONE, reading.mention_type[mention])
    is_by_robot, is_ordinal = types[:, LANDMARK] == ROBOT, reading.is_ordinal
    rank = jnp.where(reading.relation != NONE, reading.rank, 0)
    side = jnp.where(is_by_robot & (rank == 0), reading.relation, NONE)
    is_side = jnp.any(side[:, None] == jnp.asarray(SIDES)[None], axis=1)
    # A figure's sides come from all its relations to the robot.
    same_figure = (reading.figure[:, None] == reading.figure[None]) & is_ordinal[:, None]
    pdf = density_of(model, jnp.maximum(reading.relation, 0))
    return Query(
        mention=mention,
        types=types,
        relation=reading.relation,
        rank=rank,
        other=other,
        is_ordinal=is_ordinal,
        is_rangeless=is_ordinal | is_side,
        sides=jnp.where(same_figure, side[None], NONE),
        pdf=without_range(pdf, is_side, is_ordinal, log_area),
        viewer=context.viewer,
        excluded=jnp.where(mention == NONE, 0, context.excluded[mention]),
    )
