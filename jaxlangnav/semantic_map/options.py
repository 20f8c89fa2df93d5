"""Ways to ground one annotated relation, and what each weighs (section 3.2, eq. 7a).

A relation connects a figure and a landmark; each end is an observed object, a place decided by an
earlier relation, or new. ``proposal`` says what the weights mean and draws among them.

Shapes are those of one particle; with many, the particle axis is last ("...").
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import FAR, NONE
from jaxlangnav.numerics.axes import apart, column, lead
from jaxlangnav.numerics.once import once
from jaxlangnav.relations import (
    Frame,
    Law,
    RelationModel,
    log_density_of,
    sample_polar,
    to_map,
    viewer_frame,
)
from jaxlangnav.semantic_map.coverage import Coverage, log_miss_at
from jaxlangnav.semantic_map.order import PLURAL, Order, log_side

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

    object_type: Array  # i32[O, ...] NONE in empty slots
    mean_x: Array  # f32[O, ...] metres, map frame
    mean_y: Array  # f32[O, ...]


class Scene(NamedTuple):
    """What all particles of an episode share while words are grounded.

    With particles of several episodes, everything has the particle axis too, and the coverage
    maps stand one below the other.
    """

    coverage: Coverage
    first_row: Array  # i32[] where in ``coverage`` the episode's map begins
    log_unseen: Array  # f32[] log u
    viewer: Array  # f32[3] x, y, heading of the robot when it was told; map frame


class Candidates(NamedTuple):
    """What one end of a relation may be: each observed object, or the place already decided."""

    x: Array  # f32[O + 1, ...] the last entry is the place already decided
    y: Array  # f32[O + 1, ...]
    log_prior: Array  # f32[O + 1, ...] −∞ where it is no candidate
    is_open: Array  # bool[...] nothing decided: may also be a new object


class Link(NamedTuple):
    """One annotated relation in one particle: what it connects, and how it is measured."""

    figure: Array  # i32[...] mention
    landmark: Array  # i32[...] mention; NONE
    relation: Array  # i32[...] relation index; NONE
    is_superlative: Array  # bool[...]
    is_ordered: Array  # bool[...] "second", "leftmost": an order that says nothing of how far
    is_side: Array  # bool[...] "on your left": a side of the robot, however far
    is_robot: Array  # bool[...] the landmark is the robot itself
    viewer: Array  # f32[3]
    robot: Frame  # the robot's own frame
    rival_x: Array  # f32[O, ...] observed objects of the figure's type, for superlatives
    rival_y: Array  # f32[O, ...]
    is_rival: Array  # bool[O, ...]
    log_area: Array  # f32[]
    model: RelationModel  # for drawing
    law: Law  # of the relation
    softness: Array  # f32[] metres
    log_told: Array  # f32[...] log (1 − ε), that the relation holds; −∞ where none is told
    log_free: Array  # f32[...] log ε, that it says nothing; 0 where none is told
    order: Order

    def frame(self, x: Array, y: Array) -> Frame:
        """Build the frame in which the relation is meant for a landmark at (x, y)."""
        viewer_x, viewer_y, _ = (lead(one, x.ndim) for one in self.viewer)
        seen = viewer_frame(viewer_x, viewer_y, x, y)
        is_robot = lead(self.is_robot, x.ndim)
        return jax.tree.map(
            lambda own, one: jnp.where(is_robot, lead(own, x.ndim), one), self.robot, seen
        )

    def log_density(self, offset_x: Array, offset_y: Array, frame: Frame) -> Array:
        """Evaluate the relation alone, without the chance that it misleads."""
        density = log_density_of(self.law, offset_x, offset_y, frame)
        is_anyhow = lead(self.is_ordered | self.is_side, density.ndim)
        return jnp.where(is_anyhow, -lead(self.log_area, density.ndim), density)

    def log_mixture(self, log_relation: Array) -> Array:
        """Mix a relation with the uniform law over the area, which ignores what was said."""
        told = lead(self.log_told, log_relation.ndim) + log_relation
        return jnp.logaddexp(told, lead(self.log_free - self.log_area, log_relation.ndim))

    def sample(self, distance: Array, angle: Array, frame: Frame) -> tuple[Array, Array]:
        """Draw one offset from the relation and turn it into each of the frames, map axes."""
        relation = jnp.maximum(self.relation, 0)
        along, lateral = sample_polar(self.model, relation, distance, angle)
        return to_map(frame, along[None], lateral[None])

    def log_extreme(self, pairs: "Pairs", log_order: Array) -> Array:
        """Penalise a figure that has not its place: what the density leaves unsaid.

        "Nearest": no observed object of its type beats it. An order counts unseen ones too.
        """
        x, y, landmark_x, landmark_y = pairs
        sign = lead(jnp.where(self.relation == FAR, -1.0, 1.0), x.ndim)

        def squared(away_x: Array, away_y: Array) -> Array:
            return away_x * away_x + away_y * away_y + 1e-9

        rival_x, rival_y, is_rival = (
            apart(rivals, x.ndim + 1) for rivals in (self.rival_x, self.rival_y, self.is_rival)
        )
        rivals = sign[None] * squared(rival_x - landmark_x[None], rival_y - landmark_y[None])
        # The same for all figures of a landmark.
        best = once(jnp.min(jnp.where(is_rival, rivals, jnp.inf), axis=0))
        own = sign * squared(x - landmark_x, y - landmark_y)
        best = jnp.minimum(own, best)
        excess = sign * (jnp.sqrt(jnp.abs(own)) - jnp.sqrt(jnp.abs(best)))
        extreme = jnp.where(lead(self.is_superlative, own.ndim), -excess / self.softness, 0.0)
        extreme = jnp.where(lead(self.is_ordered, own.ndim), log_order, extreme)
        side = self._log_side(x - landmark_x, y - landmark_y)
        return jnp.where(lead(self.is_side, own.ndim), side, extreme)

    def log_orders(self, ways: Sequence["Pairs"]) -> list[Array]:
        """Weigh all pairs by the order that is told, f32[n, ...] for each way.

        Orders are rare and cost more than all the rest: none, no round of the loop.
        """
        shapes = [jnp.broadcast_shapes(way.x.shape, way.landmark_x.shape) for way in ways]
        batch = self.relation.shape
        sizes = [math.prod(shape[: len(shape) - len(batch)]) for shape in shapes]

        def together(index: Array, _: Array) -> Array:
            every = [
                jnp.concatenate(
                    [
                        jnp.broadcast_to(values, shape).reshape(-1, *batch)
                        for values, shape in zip(column_of, shapes, strict=True)
                    ]
                )
                for column_of in zip(*ways, strict=True)
            ]
            # The index, always 0, enters all that is read, or XLA would hoist what it can.
            return self.order(*(values + index.astype(values.dtype) for values in every))

        is_told = jnp.any(self.is_ordered).astype(jnp.int32)
        nothing = jnp.zeros((sum(sizes), *batch), jnp.float32)
        weighed = jax.lax.fori_loop(0, is_told, together, nothing)
        parts = jnp.split(weighed, np.cumsum(sizes)[:-1])
        return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

    def _log_side(self, offset_x: Array, offset_y: Array) -> Array:
        """Weigh offsets from the robot by their direction."""
        own = jax.tree.map(lambda leaf: lead(leaf, offset_x.ndim), self.robot)
        along = offset_x * own.along_x + offset_y * own.along_y
        lateral = offset_x * own.lateral_x + offset_y * own.lateral_y
        axis_along = lead(self.law.axis_along, along.ndim)
        axis_lateral = lead(self.law.axis_lateral, along.ndim)
        squared = offset_x * offset_x + offset_y * offset_y + 1e-6
        return log_side((along * axis_along + lateral * axis_lateral) * jax.lax.rsqrt(squared))

    @property
    def is_anywhere(self) -> Array:
        """Whether a new place is drawn from all that is unseen, bool[...]."""
        return self.is_ordered | self.is_side

    def log_found(self, scene: Scene, x: Array, y: Array, log_relation: Array) -> Array:
        """Weigh a place drawn for something new: the relation's, or anywhere unseen."""
        log_miss = log_miss_at(scene.coverage, x, y, scene.first_row)
        log_unseen = lead(scene.log_unseen, log_miss.ndim)
        told = jnp.where(self.is_anywhere[None], log_unseen, log_miss) + log_relation
        told = told + jnp.where(self.is_ordered[None], jnp.log(PLURAL), 0.0)
        return told + self.log_told[None]


class Pairs(NamedTuple):
    """Places of a figure and of its landmark; n of them, or two axes that broadcast."""

    x: Array  # f32[n, ...] metres, map frame
    y: Array  # f32[n, ...]
    landmark_x: Array  # f32[n, ...]
    landmark_y: Array  # f32[n, ...]


class Ways(NamedTuple):
    """Ways to ground a relation: which ends are known and which are drawn."""

    known: Pairs  # [O + 1, O + 1, ...] every known figure with every known landmark
    new_figure: Pairs  # [O + 1, ...] one draw from the relation for each landmark
    new_landmark: Pairs  # [O + 1, ...] one draw for each figure
    new_pair: Pairs  # [NUM_UNSEEN, ...]
    free: Pairs  # [1, ...] what is new is anywhere unseen, for the relation says nothing
    log_backward: Array  # f32[O + 1, ...] log of the relation's density over that of the draw, for
    # a landmark drawn backwards from its figure


def propose(link: Link, figures: Candidates, landmarks: Candidates, draws: Draws) -> Ways:
    """Pair the known, and draw what is new: from the relation, and anywhere unseen.

    Args:
        link: the relation.
        figures: what the figure may be.
        landmarks: what the landmark may be.
        draws: random numbers.

    Returns:
        The pairs.
    """

    def instead(unseen: Array, told: Array) -> Array:
        return jnp.where(link.is_anywhere[None], unseen, told)

    frame = link.frame(landmarks.x, landmarks.y)
    offset_x, offset_y = link.sample(draws.distance[0], draws.angle[0], frame)
    new_figure = Pairs(
        x=instead(draws.unseen_x[:1], landmarks.x + offset_x),
        y=instead(draws.unseen_y[:1], landmarks.y + offset_y),
        landmark_x=landmarks.x,
        landmark_y=landmarks.y,
    )
    # Drawn backwards, and corrected for the frame that the landmark then has.
    frame = link.frame(figures.x, figures.y)
    offset_x, offset_y = link.sample(draws.distance[1], draws.angle[1], frame)
    x = instead(draws.unseen_x[1:], figures.x - offset_x)
    y = instead(draws.unseen_y[1:], figures.y - offset_y)
    new_landmark = Pairs(x=figures.x, y=figures.y, landmark_x=x, landmark_y=y)
    log_backward = link.log_density(offset_x, offset_y, link.frame(x, y)) - link.log_density(
        offset_x, offset_y, frame
    )
    # The landmark anywhere unexplored, and the figure where the relation has it.
    landmark_x, landmark_y = draws.unseen_x, draws.unseen_y
    frame = link.frame(landmark_x, landmark_y)
    offset_x, offset_y = link.sample(draws.distance[0], draws.angle[0], frame)
    new_pair = Pairs(
        # Of an order or a side, the figure takes the next place's draw.
        x=instead(landmark_x[::-1], landmark_x + offset_x),
        y=instead(landmark_y[::-1], landmark_y + offset_y),
        landmark_x=landmark_x,
        landmark_y=landmark_y,
    )
    known = Pairs(figures.x[:, None], figures.y[:, None], landmarks.x[None], landmarks.y[None])
    free = Pairs(landmark_x[:1], landmark_y[:1], landmark_x[1:2], landmark_y[1:2])
    return Ways(known, new_figure, new_landmark, new_pair, free, log_backward)


def weigh(
    link: Link, figures: Candidates, landmarks: Candidates, ways: Ways, scene: Scene
) -> Array:
    """Weigh every way to ground a relation.

    Args:
        link: the relation.
        figures: what the figure may be.
        landmarks: what the landmark may be.
        ways: from ``propose``.
        scene: where the robot has looked.

    Returns:
        f32[(O + 1)² + 4 (O + 1) + NUM_UNSEEN + 1, ...] log-weights: known pairs, new figures, new
        landmarks, new pairs; figures, landmarks and a pair anywhere, of which nothing is told.
    """
    proposed = (ways.known, ways.new_figure, ways.new_landmark, ways.new_pair)
    extremes = once(
        [
            link.log_extreme(pairs, log_order)
            for pairs, log_order in zip(proposed, link.log_orders(proposed), strict=True)
        ]
    )
    figure, landmark, pair = ways.new_figure, ways.new_landmark, ways.new_pair
    # A landmark in a pair is uniform over the area: its share of unexplored area, times A for the
    # root of the chain.
    log_pair = scene.log_unseen + link.log_area - jnp.log(float(NUM_UNSEEN))
    log_figure = link.log_found(scene, figure.x, figure.y, extremes[1]) + landmarks.log_prior
    log_landmark = figures.log_prior + link.log_found(
        scene, landmark.landmark_x, landmark.landmark_y, ways.log_backward + extremes[2]
    )
    log_both = link.log_found(scene, pair.x, pair.y, extremes[3])
    log_both = log_both + lead(log_pair, log_both.ndim)
    is_open = figures.is_open & landmarks.is_open
    # That the relation says nothing is weighed in every particle and not drawn: a draw in twenty
    # leaves what it alone explains to two or three particles, which soon die out.
    log_free = (link.log_free + scene.log_unseen)[None]
    log_anywhere = log_free + lead(scene.log_unseen + link.log_area, log_free.ndim)
    known = _both_known(link, figures, landmarks, ways.known, extremes[0])
    return jnp.concatenate(
        [
            known.reshape(-1, *known.shape[2:]),
            jnp.where(figures.is_open[None], log_figure, -jnp.inf),
            jnp.where(landmarks.is_open[None], log_landmark, -jnp.inf),
            jnp.where(is_open[None], log_both, -jnp.inf),
            jnp.where(figures.is_open[None], log_free + landmarks.log_prior, -jnp.inf),
            jnp.where(landmarks.is_open[None], log_free + figures.log_prior, -jnp.inf),
            jnp.where(is_open[None], log_anywhere, -jnp.inf),
        ]
    )


def _both_known(
    link: Link, figures: Candidates, landmarks: Candidates, pairs: Pairs, log_extreme: Array
) -> Array:
    """Weigh every pair of known figure and landmark, f32[O + 1, O + 1, ...]."""
    size = figures.x.shape[0]
    frame = link.frame(landmarks.x, landmarks.y)
    columns = Frame(
        along_x=frame.along_x[None],
        along_y=frame.along_y[None],
        lateral_x=frame.lateral_x[None],
        lateral_y=frame.lateral_y[None],
    )
    log_relation = link.log_density(pairs.x - pairs.landmark_x, pairs.y - pairs.landmark_y, columns)
    table = (
        link.log_mixture(log_relation + log_extreme)
        + figures.log_prior[:, None]
        + landmarks.log_prior[None]
    )
    # Nothing is its own landmark; the last entries are places, not objects.
    same = jnp.eye(size, dtype=bool).at[size - 1, size - 1].set(False)
    return jnp.where(column(same, table.ndim), -jnp.inf, table)


def log_root(link: Link, figures: Candidates, landmarks: Candidates) -> Array:
    """Give the uniform prior over the area to one thing of each chain of relations.

    A figure grounded earlier that is now placed against the robot gives its share back.
    """
    is_placed = ~figures.is_open & (link.is_robot | (link.relation == NONE))
    both_open = figures.is_open & landmarks.is_open
    return jnp.where(both_open, -link.log_area, jnp.where(is_placed, link.log_area, 0.0))
