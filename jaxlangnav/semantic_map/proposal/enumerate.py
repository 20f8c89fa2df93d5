"""Enumerate groundings of a relation: observed objects paired, unseen ones sampled (eq. 7a).

The ways are counted through, and both what a way *is* and what it *means* are laid out by the same
two functions, ``_of_figures`` and ``_of_landmarks``:

    the relation holds     both ends known · figure new, at each landmark · landmark new, at each
                           figure · both new
    it says nothing        figure new, anywhere · landmark new, anywhere · both new, anywhere

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.relations import RelationModel
from jaxlangnav.semantic_map.proposal.candidates import NUM_UNSEEN, Candidates, Draws
from jaxlangnav.semantic_map.proposal.relation_query import FIGURE, LANDMARK, Query


class Pairs(NamedTuple):
    """Places of figures and of their landmarks, metres, map frame."""

    x: Array  # f32[W, ...]
    y: Array  # f32[W, ...]
    landmark_x: Array  # f32[W, ...]
    landmark_y: Array  # f32[W, ...]


class Proposals(NamedTuple):
    """The W ways to ground a relation, and how what is new in them was drawn."""

    pairs: Pairs
    new_x: Array  # f32[2 (O + 1) + NUM_UNSEEN, ...] metres, what was drawn for the relation
    new_y: Array  # f32[2 (O + 1) + NUM_UNSEEN, ...]
    log_drawn: Array  # f32[O + 1, ...] log-density with which a new landmark was drawn, 1/m²

    @property
    def told(self) -> Pairs:
        """The pairs of the ways in which the relation holds."""
        size = (self.new_x.shape[0] - NUM_UNSEEN) // 2
        return Pairs(*(leaf[: size * size + self.new_x.shape[0]] for leaf in self.pairs))


def _of_figures(known: Array, new: Array, unseen: Array) -> Array:
    """Lay out the figures of all ways, [W, ...]: candidates, new ones, those anywhere."""
    size, rest = known.shape[0], known.shape[1:]
    each = jnp.broadcast_to(known[:, None], (size, size, *rest)).reshape(-1, *rest)
    free = jnp.broadcast_to(unseen[:1], known.shape)
    return jnp.concatenate([each, new[:size], known, new[2 * size :], free, known, unseen[:1]])


def _of_landmarks(known: Array, new: Array, unseen: Array) -> Array:
    """Lay out the landmarks of all ways, [W, ...]; arguments as for ``_of_figures``."""
    size, rest = known.shape[0], known.shape[1:]
    each = jnp.broadcast_to(known[None], (size, size, *rest)).reshape(-1, *rest)
    free = jnp.broadcast_to(unseen[1:2], known.shape)
    return jnp.concatenate([each, known, new[size : 2 * size], unseen, known, free, unseen[1:2]])


def _of_new(figure: Array, landmark: Array, figure_of_pair: Array, size: int) -> Array:
    """Lay out what is new in the ways told: figures, landmarks, the figures of new pairs."""
    parts = (figure, size), (landmark, size), (figure_of_pair, NUM_UNSEEN)
    return jnp.concatenate(
        [jnp.broadcast_to(part, (number, *part.shape[1:])) for part, number in parts]
    )


@functools.cache
def proposal_layout(num_objects: int) -> tuple[np.ndarray, np.ndarray]:
    """Tell what each way stands for, with O slots for objects.

    i32[2, W], the observed slot that each end is; NONE where it is new or decided already; and
    bool[2, W], whether the end hangs on the other, having been drawn there or being said of it.
    """
    with jax.ensure_compile_time_eval():
        slots = jnp.append(jnp.arange(num_objects), NONE)
        new = jnp.full(2 * slots.size + NUM_UNSEEN, NONE)
        figure = _of_figures(slots, new, new[:NUM_UNSEEN])
        landmark = _of_landmarks(slots, new, new[:NUM_UNSEEN])
        is_told = jnp.arange(figure.size) < slots.size**2 + new.size
        no = jnp.zeros(slots.size, bool)
        is_drawn = _of_landmarks(no, new == NONE, no[:NUM_UNSEEN])
        return np.stack([figure, landmark], dtype=np.int32), np.stack([is_told, is_drawn])


def propose(query: Query, ends: Candidates, draws: Draws, model: RelationModel) -> Proposals:
    """Pair what is known, and draw what is new: from the relation, and anywhere unseen."""
    size = ends.x.shape[1]
    along, lateral, log_drawn = query.draw(draws.distance, draws.angle, model)
    at_x = _of_new(ends.x[LANDMARK], ends.x[FIGURE], draws.unseen_x, size)
    at_y = _of_new(ends.y[LANDMARK], ends.y[FIGURE], draws.unseen_y, size)

    def of_ends(values: Array) -> Array:
        # A landmark is drawn backwards from its figure, in a frame that is not its own: the weight
        # makes up for it.
        return _of_new(values[:1], -values[1:], values[:1], size)

    def instead(unseen: Array, told: Array) -> Array:
        # Of an order or a side, the figure of a new landmark takes the next place's draw.
        anywhere = _of_new(unseen[:1], unseen[1:2], unseen[::-1], size)
        return jnp.where(query.is_anywhere[None], anywhere, told)

    offset_x, offset_y, log_unit = query.offset(at_x, at_y, of_ends(along), of_ends(lateral))
    new_x = instead(draws.unseen_x, at_x + offset_x)
    new_y = instead(draws.unseen_y, at_y + offset_y)
    return Proposals(
        pairs=Pairs(
            x=_of_figures(ends.x[FIGURE], new_x, draws.unseen_x),
            y=_of_figures(ends.y[FIGURE], new_y, draws.unseen_y),
            landmark_x=_of_landmarks(ends.x[LANDMARK], new_x, draws.unseen_x),
            landmark_y=_of_landmarks(ends.y[LANDMARK], new_y, draws.unseen_y),
        ),
        new_x=new_x,
        new_y=new_y,
        log_drawn=log_drawn - log_unit[size : 2 * size],
    )
