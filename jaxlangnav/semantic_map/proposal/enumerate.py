"""Enumerate groundings of a relation: observed objects paired, unseen ones sampled (eq. 7a).

The W proposals are rows of a table; both their positions and their slots (``proposal_layout``) are
laid out by the same two functions, ``_figure_rows`` and ``_landmark_rows``:

    the relation holds     both ends candidates · figure new, at each landmark · landmark new, at
                           each figure · both new
    it does not hold       figure new, anywhere · landmark new, anywhere · both new, anywhere

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import skip_unless_any
from jaxlangnav.relations import RelationModel
from jaxlangnav.semantic_map.proposal.candidates import NUM_UNSEEN, Candidates, Draws
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, LANDMARK, Query


class Pairs(NamedTuple):
    """Positions of figures and of their landmarks, metres, map frame."""

    x: Array  # f32[W, ...] of the figure
    y: Array  # f32[W, ...]
    landmark_x: Array  # f32[W, ...]
    landmark_y: Array  # f32[W, ...]


class Proposals(NamedTuple):
    """The W proposed groundings of a relation, with the draws of their new objects."""

    pairs: Pairs
    new_x: Array  # f32[2 (O + 1) + NUM_UNSEEN, ...] metres, positions drawn for new objects
    new_y: Array  # f32[2 (O + 1) + NUM_UNSEEN, ...]
    log_proposal: Array  # f32[O + 1, ...] log-density with which a new landmark was drawn, 1/m²

    @property
    def related(self) -> Pairs:
        """The pairs of the proposals in which the relation holds."""
        size = (self.new_x.shape[0] - NUM_UNSEEN) // 2
        return Pairs(*(leaf[: size * size + self.new_x.shape[0]] for leaf in self.pairs))


def _figure_rows(cand: Array, new: Array, unseen: Array) -> Array:
    """Lay out the figures of all proposals, [W, ...]: candidates, new ones, those anywhere."""
    size, rest = cand.shape[0], cand.shape[1:]
    pairs = jnp.broadcast_to(cand[:, None], (size, size, *rest)).reshape(-1, *rest)
    free = jnp.broadcast_to(unseen[:1], cand.shape)
    return jnp.concatenate([pairs, new[:size], cand, new[2 * size :], free, cand, unseen[:1]])


def _landmark_rows(cand: Array, new: Array, unseen: Array) -> Array:
    """Lay out the landmarks of all proposals, [W, ...]; arguments as for ``_figure_rows``."""
    size, rest = cand.shape[0], cand.shape[1:]
    pairs = jnp.broadcast_to(cand[None], (size, size, *rest)).reshape(-1, *rest)
    free = jnp.broadcast_to(unseen[1:2], cand.shape)
    return jnp.concatenate([pairs, cand, new[size : 2 * size], unseen, cand, free, unseen[1:2]])


def _new_rows(figure: Array, landmark: Array, pair_figure: Array, size: int) -> Array:
    """Lay out new objects where the relation holds: figures, landmarks, figures of new pairs."""
    parts = (figure, size), (landmark, size), (pair_figure, NUM_UNSEEN)
    return jnp.concatenate(
        [jnp.broadcast_to(part, (count, *part.shape[1:])) for part, count in parts]
    )


@functools.cache
def proposal_layout(num_objects: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the meaning of each proposal, with O slots for objects.

    i32[2, W], the observed slot of each end; NONE where it is new or grounded earlier; and
    bool[2, W], whether the end is anchored to the other, by the relation or by being drawn there.
    """
    with jax.ensure_compile_time_eval():
        slots = jnp.append(jnp.arange(num_objects), NONE)
        new = jnp.full(2 * slots.size + NUM_UNSEEN, NONE)
        figure = _figure_rows(slots, new, new[:NUM_UNSEEN])
        landmark = _landmark_rows(slots, new, new[:NUM_UNSEEN])
        is_related = jnp.arange(figure.size) < slots.size**2 + new.size
        false = jnp.zeros(slots.size, bool)
        is_drawn = _landmark_rows(false, new == NONE, false[:NUM_UNSEEN])
        return np.stack([figure, landmark], dtype=np.int32), np.stack([is_related, is_drawn])


def propose(query: Query, ends: Candidates, draws: Draws, model: RelationModel) -> Proposals:
    """Pair candidates; draw new objects from the relation's density and from the unseen area."""
    size = ends.x.shape[1]
    along, lateral, log_drawn = query.draw(draws.distance, draws.angle, model)
    spans = (at[FIGURE] - v[None] for at, v in zip((ends.x, ends.y), query.viewer[:2], strict=True))
    distance = jnp.hypot(along[LANDMARK:], lateral[LANDMARK:])
    is_near = (jnp.hypot(*spans) < distance) & ~query.is_between[None]
    is_near &= ends.log_prior[FIGURE] > -jnp.inf

    def on_ring(drawn: tuple[Array, ...]) -> Array:
        # A figure nearer to the viewer than to its landmark may have that on any side: what stands
        # beside the viewer is in front of all around.
        distance, normal, angle = drawn
        turn, log_sd = 2.0 * jnp.pi * jax.scipy.special.ndtr(angle), query.pdf.log_distance_sd[None]
        log_pdf = -0.5 * normal**2 - jnp.log(log_sd * distance**2) - 1.5 * np.log(2.0 * np.pi)
        return jnp.concatenate([distance * jnp.cos(turn), distance * jnp.sin(turn), log_pdf])

    drawn = distance, draws.distance[LANDMARK:], draws.angle[LANDMARK:]
    zeros = jnp.zeros((3, *distance.shape[1:]))
    ring = skip_unless_any(jnp.any(is_near, axis=0), on_ring, drawn, zeros)
    at_x = _new_rows(ends.x[LANDMARK], ends.x[FIGURE], draws.unseen_x, size)
    at_y = _new_rows(ends.y[LANDMARK], ends.y[FIGURE], draws.unseen_y, size)

    def directed(values: Array, any_side: Array) -> Array:
        # A landmark is drawn backwards from its figure, in the figure's frame; the importance
        # weight corrects for it.
        backwards = jnp.where(is_near, any_side, -values[LANDMARK:])
        return _new_rows(values[:1], backwards, values[:1], size)

    def unless_rangeless(unseen: Array, related: Array) -> Array:
        # For a rank or a side, a new landmark takes the draw after its figure's.
        anywhere = _new_rows(unseen[:1], unseen[1:2], unseen[::-1], size)
        return jnp.where(query.is_rangeless[None], anywhere, related)

    along, lateral = directed(along, ring[:1]), directed(lateral, ring[1:2])
    offset_x, offset_y, log_unit = query.offset(at_x, at_y, along, lateral)
    new_x = unless_rangeless(draws.unseen_x, at_x + offset_x)
    new_y = unless_rangeless(draws.unseen_y, at_y + offset_y)
    return Proposals(
        pairs=Pairs(
            x=_figure_rows(ends.x[FIGURE], new_x, draws.unseen_x),
            y=_figure_rows(ends.y[FIGURE], new_y, draws.unseen_y),
            landmark_x=_landmark_rows(ends.x[LANDMARK], new_x, draws.unseen_x),
            landmark_y=_landmark_rows(ends.y[LANDMARK], new_y, draws.unseen_y),
        ),
        new_x=new_x,
        new_y=new_y,
        log_proposal=jnp.where(is_near, ring[2:], log_drawn) - log_unit[size : 2 * size],
    )
