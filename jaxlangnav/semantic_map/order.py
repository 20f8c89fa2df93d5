"""Relations to the robot that say nothing of how far (section 3.2, beyond the paper).

"On your left" is a side, however far: any place of the area, weighed by a wide von Mises about the
direction. "The nearest cone", "the second", "the leftmost" are orders: which of their type come
before. What comes before may be unseen, so a figure with too few seen things before it is worth as
much as unseen ones there are probable: λ A u = α u for each, of which the share that would come
before counts. "The second" needs one before it; "the nearest" needs another one after it, or
nobody would say so.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, RIGHT
from jaxlangnav.numerics.axes import apart, lead
from jaxlangnav.relations import Frame

_TIE = 1e-3
"""Metres within which a seen thing is the figure itself."""
_LEAST_SHARE = 0.1
"""Share of the unseen that may come before or after where neither of few draws does."""
_OFF_SIDE = 1e-3
"""Weight of a figure that is not on the side where it is said to be."""
NUM_RANKS = 4
PLURAL = 10.0
"""Who says "the second" or "the rightmost" speaks of several: so much likelier are unseen ones."""
SIDES = (FRONT, BEHIND, LEFT, RIGHT)
SIDE_CONCENTRATION = 4.0
"""κ of a side of the robot: 30 degrees off still fits, the opposite side does not."""


class Order(NamedTuple):
    """An order among the things of a type, seen and unseen."""

    relation: Array  # i32[...] relation index
    rank: Array  # i32[...] 1 the first in the order, 2 the second, ...; 0 where nothing is ordered
    viewer_x: Array  # f32[] metres, map frame: where the robot was told. Of several episodes:
    # f32[...], as the other scalars
    viewer_y: Array  # f32[]
    robot: Frame  # the robot's own frame then
    sides: Array  # i32[J, ...] sides of the robot on which the figure is said to be, else NONE
    rival_x: Array  # f32[O, ...] metres, seen things
    rival_y: Array  # f32[O, ...]
    is_rival: Array  # bool[O, ...] of the figure's type
    unseen_x: Array  # f32[U, ...] metres, places drawn from the unexplored area
    unseen_y: Array  # f32[U, ...]
    log_new: Array  # f32[] log α u, probability of something unseen of the type
    softness: Array  # f32[] metres

    def __call__(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Weigh figures at places by how well they fit their rank.

        "The nearest cone on your left" is compared with the cones on the left alone. Limits: with
        all seen, the one of that rank has 0 and the others nearly −∞.

        Args:
            x: f32[n, ...] metres, map frame; as the other three, which broadcast with it. With
                many particles, their axis is the last.
            y: f32[n, ...]
            landmark_x: f32[n, ...]
            landmark_y: f32[n, ...]

        Returns:
            f32[n, ...] log-weight.
        """
        own = self._merit(x, y, landmark_x, landmark_y)
        x_there, y_there = landmark_x[None], landmark_y[None]

        def rows(values: Array) -> Array:
            return apart(values, own.ndim + 1)

        rival = self._merit(rows(self.rival_x), rows(self.rival_y), x_there, y_there)
        unseen = self._merit(rows(self.unseen_x), rows(self.unseen_y), x_there, y_there)
        is_rival = rows(self.is_rival & self._is_where_said(self.rival_x, self.rival_y))
        counts = rows(self._is_where_said(self.unseen_x, self.unseen_y))
        rank = lead(self.rank, own.ndim)
        before = jnp.sum(is_rival & (rival < own[None] - _TIE), axis=0)
        others = jnp.sum(is_rival & (jnp.abs(rival - own[None]) > _TIE), axis=0)
        lacking = jnp.maximum(rank - 1 - before, 0)
        is_alone = (rank == 1) & (others == 0)
        share_before = jnp.mean(counts & (unseen < own[None]), axis=0)
        share_after = jnp.mean(counts & (unseen > own[None]), axis=0)
        log_new = lead(self.log_new, own.ndim)
        log_before = log_new + jnp.log(jnp.maximum(share_before, _LEAST_SHARE))
        log_after = log_new + jnp.log(jnp.maximum(share_after, _LEAST_SHARE))
        excess = jnp.maximum(own - self._of_rank(jnp.where(is_rival, rival, jnp.inf)), 0.0)
        price = jnp.where(lacking > 0, lacking * log_before, 0.0)
        price = price + jnp.where(is_alone, log_after, 0.0) - excess / self.softness
        is_there = jnp.broadcast_to(self._is_where_said(x, y), price.shape)
        price = jnp.where(is_there, price, price + jnp.log(_OFF_SIDE))
        return jnp.where(rank > 0, price, 0.0)

    def _is_where_said(self, x: Array, y: Array) -> Array:
        """Tell which places are on the sides where the figure is said to be."""
        offset_x, offset_y = x - lead(self.viewer_x, x.ndim), y - lead(self.viewer_y, y.ndim)
        robot = jax.tree.map(lambda leaf: lead(leaf, x.ndim + 1), self.robot)
        holds = is_on_side(apart(self.sides, x.ndim + 1), offset_x[None], offset_y[None], robot)
        return functools.reduce(jnp.logical_and, jnp.unstack(holds))

    def _merit(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Measure places along the order, smaller is earlier."""
        dx, dy = x - landmark_x, y - landmark_y
        distance = jnp.sqrt(dx * dx + dy * dy + 1e-9)
        lateral_x, lateral_y = self.robot.lateral_x, self.robot.lateral_y
        side = dx * lead(lateral_x, dx.ndim) + dy * lead(lateral_y, dy.ndim)
        relation = lead(self.relation, distance.ndim)
        merit = jnp.where(relation == FAR, -distance, distance)
        merit = jnp.where(relation == LEFT, -side, merit)
        return jnp.where(relation == RIGHT, side, merit)

    def _of_rank(self, rival: Array) -> Array:
        """Find the rank-th smallest over the first axis; ∞ where there are fewer."""
        last = jnp.full(rival.shape[1:], -jnp.inf)
        found = last
        wanted = lead(self.rank, last.ndim)
        for rank in range(1, NUM_RANKS + 1):
            last = jnp.min(jnp.where(rival > last[None] + _TIE, rival, jnp.inf), axis=0)
            found = jnp.where(wanted == rank, last, found)
        return jnp.where(wanted > NUM_RANKS, jnp.inf, found)


def log_side(cosine: Array) -> Array:
    """Weigh directions by how well they fit a side of the robot, over those of all directions.

        log w = κ (cos Δ − 1) − log(I₀(κ) e^−κ)

    Limits: the mean of w over all directions is 1.

    Args:
        cosine: f32[...] of the angle Δ from the side's axis.

    Returns:
        f32[...]
    """
    constant = jnp.log(jax.scipy.special.i0e(jnp.float32(SIDE_CONCENTRATION)))
    return SIDE_CONCENTRATION * (cosine - 1.0) - constant


def is_on_side(relation: Array, offset_x: Array, offset_y: Array, robot: Frame) -> Array:
    """Tell on which side of the robot something is, to compare things there: half-planes.

    Args:
        relation: i32[...], relation index; all but front, behind, left, right hold everywhere.
        offset_x: f32[...] from the robot, metres, map axes.
        offset_y: f32[...]
        robot: the robot's own frame.

    Returns:
        bool[...]
    """
    backward = offset_x * robot.along_x + offset_y * robot.along_y
    leftward = offset_x * robot.lateral_x + offset_y * robot.lateral_y
    sides = (backward < 0, backward > 0, leftward > 0, leftward < 0)
    holds = jnp.ones(jnp.broadcast_shapes(relation.shape, offset_x.shape), bool)
    for index, is_there in enumerate(sides):
        holds = jnp.where(relation == index, is_there, holds)
    return holds
