"""One relation of an utterance in the reading that a particle believes (section 3.2, eq. 7a).

A relation places a figure against a landmark. Both are its *ends*: of any leaf [2, ...] the first
entry is the figure's, the second the landmark's. What lies between two landmarks has two relations:
to a particle the first says that its landmark exists, and the second is seen from there.

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import BETWEEN, FAR, NONE, ROBOT, Readings, UtteranceContext
from jaxlangnav.numerics.batching import lookup, pack, prepend_axes, skip_unless_any, unpack
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations import (
    SIDES,
    Law,
    ReferenceFrame,
    RelationModel,
    anywhere,
    between,
    is_so,
    law_of,
    log_density_in_frame,
    log_density_of,
    robot_frame,
    sample_law,
    to_frame,
    to_map,
    viewer_frame,
)
from jaxlangnav.semantic_map.params import MapParams

FIGURE, LANDMARK = 0, 1


class Query(NamedTuple):
    """One relation of the reading that a particle believes."""

    mention: Array  # i32[2, ...] the ends; NONE where the reading has no such relation or landmark
    kind: Array  # i32[2, ...] their kinds; ROBOT; NONE
    relation: Array  # i32[...] index; NONE where the figure merely exists
    rank: Array  # i32[...] 1 "nearest", 2 "the second", ...; 0 where none is meant
    other: Array  # i32[...] mention of the other landmark of "between", grounded by then; NONE
    is_order: Array  # bool[...] "the second", "farthest": a rank that says nothing of how far
    is_anywhere: Array  # bool[...] an order or "on your left": however far
    sides: Array  # i32[J, ...] of an order: where else its figure is said to be; NONE
    law: Law  # leaves f32[...]
    viewer: Array  # f32[3, ...] x, y, heading of the robot as it heard the relation; map frame
    excluded: Array  # i32[2, ...] observed slots that the ends are not: bit s is slot s

    @property
    def is_between(self) -> Array:
        """Whether the figure lies between the landmark and another one, bool[...]."""
        return self.other != NONE

    @property
    def is_by_robot(self) -> Array:
        """Whether the landmark is the robot itself, bool[...]."""
        return self.kind[LANDMARK] == ROBOT

    @property
    def is_by_object(self) -> Array:
        """Whether the landmark is an object, bool[...]."""
        return (self.mention[LANDMARK] != NONE) & ~self.is_by_robot

    def frame(self, x: Array, y: Array) -> ReferenceFrame:
        """Build the frame in which a relation to landmarks at f32[n, ...] metres is meant.

        It is the viewer's frame, or the robot's own where the robot is the landmark.
        """
        viewer_x, viewer_y, heading = (prepend_axes(v, x.ndim) for v in jnp.unstack(self.viewer))
        is_by_robot = prepend_axes(self.is_by_robot, x.ndim)
        return jax.tree.map(
            lambda own, seen: jnp.where(is_by_robot, own, seen),
            robot_frame(heading),
            viewer_frame(viewer_x, viewer_y, x, y),
        )

    def log_density(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Evaluate how likely figures are placed against landmarks, each in its own frame.

        Places are f32[n, ...] metres, map frame; f32[n, ...], log of the density per square metre.
        """
        frame = self.frame(landmark_x, landmark_y)
        log_one = log_density_of(self.law, x - landmark_x, y - landmark_y, frame)

        def of_two(places: tuple[Array, ...]) -> Array:
            x, y, landmark_x, landmark_y = places
            other = self.viewer[0][None], self.viewer[1][None]
            return between.log_density((x, y), (landmark_x, landmark_y), other)

        log_two = skip_unless_any(self.is_between, of_two, (x, y, landmark_x, landmark_y))
        return jnp.where(self.is_between[None], log_two, log_one)

    def holds(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Tell whether people would say it of figures at places, bool[n, ...]; see ``log_density``.

        Limits: what merely exists, or has a rank, holds anywhere.
        """
        frame, dx, dy = self.frame(landmark_x, landmark_y), x - landmark_x, y - landmark_y
        along, lateral = to_frame(frame, dx, dy)
        relation, has_range = jnp.maximum(self.relation, 0)[None], self.law.has_range[None] > 0.0
        of_one = is_so(relation, along, lateral, has_range=has_range)
        other = self.viewer[0][None], self.viewer[1][None]
        of_two = between.lies_between((x, y), (landmark_x, landmark_y), other)
        says_where = (self.relation != NONE) & (self.rank <= 0)
        return jnp.where(self.is_between[None], of_two, of_one) | ~says_where[None]

    def draw(
        self, distance: Array, angle: Array, model: RelationModel
    ) -> tuple[Array, Array, Array]:
        """Draw a new figure against its landmark, and a new landmark against its figure.

        Of standard normal draws f32[2, ...] it makes along and lateral in the frame, f32[2, ...]
        from landmark to figure, and the log-density of the landmark's draw, f32[1, ...]; in the
        units of ``offset``.
        """
        relation = jnp.maximum(self.relation, 0)[None]
        along, lateral = sample_law(self.law, model, relation, distance, angle)
        log_drawn = log_density_in_frame(self.law, along[LANDMARK:], lateral[LANDMARK:])
        of_one, of_two = (along, lateral, log_drawn), between.sample(distance, angle)
        is_two = self.is_between[None]
        return jax.tree.map(lambda two, one: jnp.where(is_two, two, one), of_two, of_one)

    def offset(
        self, x: Array, y: Array, along: Array, lateral: Array
    ) -> tuple[Array, Array, Array]:
        """Turn what was drawn, f32[n, ...] units, into map axes: metres, and log m² a square unit.

        The unit is a metre; of what lies between two landmarks it is the way from the other one. x
        and y are the places that it was drawn against, metres, map frame.
        """
        way_x, way_y = x - self.viewer[0][None], y - self.viewer[1][None]
        squared = way_x * way_x + way_y * way_y + 1e-6
        squared = jnp.where(self.is_between[None], squared, 1.0)
        unit = jnp.sqrt(squared)
        offset_x, offset_y = to_map(self.frame(x, y), along, lateral)
        return unit * offset_x, unit * offset_y, jnp.log(squared)


def current_context(readings: Readings, viewer: Array) -> UtteranceContext:
    """Build the context of a sentence heard at f32[3]: all said from there, nothing ruled out."""
    return UtteranceContext(
        viewer=jnp.broadcast_to(viewer, (*readings.relation.shape, 3)),
        excluded=jnp.zeros_like(readings.mention_type),
    )


def build_queries(
    readings: Readings, context: UtteranceContext, model: RelationModel, log_area: Array
) -> Query:
    """Look up all relations of K readings, leaves [J, ..., K], in an area of f32[] log m²."""
    say = jax.vmap(_say, in_axes=(0, 0, None, None), out_axes=-1)
    return say(readings, context, model, log_area)


@pytree
class Utterances:
    """What has been said, and by what it is understood."""

    readings: Readings  # K readings of M mentions
    context: UtteranceContext  # from where they were said
    params: MapParams  # relations, ε


def log_viewer_density(spoken: Utterances, log_area: Array, x: Array, y: Array) -> Array:
    """Evaluate where relations to the robot put mentions, as eq. 7a weighs new places.

    "The hydrant on your left" hangs on nothing observed, and yet is not anywhere alike. Of the
    relations r that place a mention against the robot, with densities f_r,

        log f(x) A = Σ_r log[(1 − ε) A f_r(x) + ε]

    f32[C, M, K], for places f32[C], metres, map frame. Limits: 0 of a mention that nothing places
    so, or by an order alone: as likely anywhere.
    """
    readings, misleading = spoken.readings, spoken.params.misleading
    number, mentions = readings.figure.shape[0], np.arange(readings.mention_type.shape[1])
    at = tuple(jnp.broadcast_to(one[:, None], (x.shape[0], number)) for one in (x, y))

    def of_relation(one: Query) -> Array:
        viewer = (jnp.broadcast_to(place[None], at[0].shape) for place in one.viewer[:2])
        log_holds = one.log_density(*at, *viewer) + log_area
        log_ratio = jnp.logaddexp(jnp.log1p(-misleading) + log_holds, jnp.log(misleading))
        is_placed = one.is_by_robot & ~one.is_order & (one.relation != NONE)
        is_figure = (one.mention[FIGURE][None] == mentions[:, None]) & is_placed[None]
        return jnp.where(is_figure[None], log_ratio[:, None], 0.0)

    queries = build_queries(readings, spoken.context, spoken.params.relations, log_area)
    return jnp.sum(jax.lax.map(of_relation, queries), axis=0)


def queries_of(queries: Query, reading: Array) -> Query:
    """Look up what particles hear that believe the readings i32[P]: leaves [J, ..., P]."""
    rows = pack(queries).T[..., None]
    return unpack(lookup(rows, jnp.broadcast_to(reading, (rows.shape[1], *reading.shape))), queries)


def _paired(one: Readings) -> tuple[Readings, Array]:
    """Take the first relation of each "between" for the existence of its landmark.

    The second then has the other landmark's place to be understood by, i32[J]; NONE elsewhere.
    """
    is_between = one.relation == BETWEEN
    is_alike = (one.figure[:, None] == one.figure[None]) & is_between[:, None] & is_between[None]
    number = one.figure.shape[0]
    is_earlier = is_alike & np.tri(number, k=-1, dtype=bool)
    # A figure may have been said to lie between one pair, and between another.
    last = jnp.max(jnp.where(is_earlier, np.arange(number)[None], 0), axis=1)
    is_second = is_between & (jnp.sum(is_earlier, axis=1) % 2 == 1)
    other = jnp.where(is_second, one.landmark[last], NONE)
    is_first = is_between & ~is_second
    return replace(
        one,
        figure=jnp.where(is_first, one.landmark, one.figure),
        relation=jnp.where(is_first, NONE, one.relation),
        landmark=jnp.where(is_first, NONE, one.landmark),
    ), other


def _say(one: Readings, context: UtteranceContext, model: RelationModel, log_area: Array) -> Query:
    """Gather all that a reading says, leaves [J, ...]."""
    one, other = _paired(one)
    mention = jnp.stack([one.figure, one.landmark], axis=1)
    kind = jnp.where(mention == NONE, NONE, one.mention_type[mention])
    is_told, is_by_robot = one.relation != NONE, kind[:, LANDMARK] == ROBOT
    rank = jnp.where(is_told, one.rank, 0)
    # Who says "farthest" speaks of several, and not of one that is merely far.
    is_order = (rank > 1) | ((rank == 1) & (is_by_robot | (one.relation == FAR)))
    side = jnp.where(is_by_robot & (rank == 0), one.relation, NONE)
    is_side = jnp.any(side[:, None] == jnp.asarray(SIDES)[None], axis=1)
    # One figure's sides come from all the relations it has with the robot.
    is_alike = (one.figure[:, None] == one.figure[None]) & is_order[:, None]
    law = law_of(model, jnp.maximum(one.relation, 0))
    return Query(
        mention=mention,
        kind=kind,
        relation=one.relation,
        rank=rank,
        other=other,
        is_order=is_order,
        is_anywhere=is_order | is_side,
        sides=jnp.where(is_alike, side[None], NONE),
        law=anywhere(law, is_side, is_order, log_area),
        viewer=context.viewer,
        excluded=jnp.where(mention == NONE, 0, context.excluded[mention]),
    )
