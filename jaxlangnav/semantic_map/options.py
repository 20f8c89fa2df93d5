"""Ways to ground one annotated relation, and what each weighs (section 3.2, eq. 7a).

A relation connects a figure and a landmark; each end is an observed object, a place decided by an
earlier relation, or new. ``proposal`` says what the weights mean and draws among them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import FAR, NONE
from jaxlangnav.relations import (
    Frame,
    RelationModel,
    log_density,
    sample_polar,
    to_map,
    viewer_frame,
)
from jaxlangnav.semantic_map.coverage import Coverage, log_miss_at

NUM_UNSEEN = 2
"""Places drawn from the unexplored area for each particle and relation."""


class Draws(NamedTuple):
    """Random numbers for grounding one relation in one particle."""

    distance: Array  # f32[2] standard normal: distance of a new figure; of a new landmark
    angle: Array  # f32[2] standard normal: direction of a new figure; of a new landmark
    choice: Array  # f32[] which grounding
    unseen_x: Array  # f32[NUM_UNSEEN] metres, places in the unexplored area
    unseen_y: Array  # f32[NUM_UNSEEN]


class Scene(NamedTuple):
    """What all particles of an episode share while words are grounded."""

    coverage: Coverage
    log_unseen: Array  # f32[] log u
    viewer: Array  # f32[3] x, y, heading of the robot when it was told; map frame


class Candidates(NamedTuple):
    """What one end of a relation may be: each observed object, or the place already decided."""

    x: Array  # f32[O + 1] the last entry is the place already decided
    y: Array  # f32[O + 1]
    log_prior: Array  # f32[O + 1] −∞ where it is no candidate
    is_open: Array  # bool[] nothing decided: may also be a new object


class Link(NamedTuple):
    """One annotated relation in one particle: what it connects, and how it is measured."""

    figure: Array  # i32[] mention
    landmark: Array  # i32[] mention; NONE
    relation: Array  # i32[] relation index; NONE
    is_superlative: Array  # bool[]
    is_robot: Array  # bool[] the landmark is the robot itself
    viewer: Array  # f32[3]
    robot: Frame  # the robot's own frame
    rival_x: Array  # f32[O] observed objects of the figure's type, for superlatives
    rival_y: Array  # f32[O]
    is_rival: Array  # bool[O]
    log_area: Array  # f32[]
    model: RelationModel
    softness: Array  # f32[] metres

    def frame(self, x: Array, y: Array) -> Frame:
        """Build the frame in which the relation is meant for a landmark at (x, y)."""
        seen = viewer_frame(self.viewer[0], self.viewer[1], x, y)
        return Frame(
            along_x=jnp.where(self.is_robot, self.robot.along_x, seen.along_x),
            along_y=jnp.where(self.is_robot, self.robot.along_y, seen.along_y),
            lateral_x=jnp.where(self.is_robot, self.robot.lateral_x, seen.lateral_x),
            lateral_y=jnp.where(self.is_robot, self.robot.lateral_y, seen.lateral_y),
        )

    def log_density(self, offset_x: Array, offset_y: Array, frame: Frame) -> Array:
        """Evaluate the relation, or the uniform law over the area where there is none."""
        density = log_density(self.model, jnp.maximum(self.relation, 0), offset_x, offset_y, frame)
        return jnp.where(self.relation == NONE, -self.log_area, density)

    def sample(self, distance: Array, angle: Array, frame: Frame) -> tuple[Array, Array]:
        """Draw an offset from the relation, map axes."""
        relation = jnp.maximum(self.relation, 0)
        along, lateral = sample_polar(self.model, relation, distance, angle)
        return to_map(frame, along, lateral)

    def log_extreme(self, x: Array, y: Array, landmark_x: Array, landmark_y: Array) -> Array:
        """Penalise a figure that another observed object of its type beats ("nearest")."""
        sign = jnp.where(self.relation == FAR, -1.0, 1.0)

        def signed_distance(from_x: Array, from_y: Array) -> Array:
            squared = (from_x - landmark_x[None]) ** 2 + (from_y - landmark_y[None]) ** 2
            return sign * jnp.sqrt(squared + 1e-9)

        own = signed_distance(x[None], y[None])[0]
        shape = (-1,) + (1,) * own.ndim
        rival = signed_distance(self.rival_x.reshape(shape), self.rival_y.reshape(shape))
        rival = jnp.where(self.is_rival.reshape(shape), rival, jnp.inf)
        excess = own - jnp.minimum(jnp.min(rival, axis=0), own)
        return jnp.where(self.is_superlative, -excess / self.softness, 0.0)


class Option(NamedTuple):
    """Ways to ground a relation in which some end is new; n of them."""

    log_weight: Array  # f32[n]
    figure_x: Array  # f32[n] metres
    figure_y: Array  # f32[n]
    landmark_x: Array  # f32[n]
    landmark_y: Array  # f32[n]


def both_known(link: Link, figures: Candidates, landmarks: Candidates) -> Array:
    """Weigh every pair of known figure and landmark, f32[O + 1, O + 1]."""
    size = figures.x.shape[0]
    frame = link.frame(landmarks.x, landmarks.y)
    columns = Frame(
        along_x=frame.along_x[None, :],
        along_y=frame.along_y[None, :],
        lateral_x=frame.lateral_x[None, :],
        lateral_y=frame.lateral_y[None, :],
    )
    figure_x, figure_y = figures.x[:, None], figures.y[:, None]
    landmark_x, landmark_y = landmarks.x[None, :], landmarks.y[None, :]
    table = (
        link.log_density(figure_x - landmark_x, figure_y - landmark_y, columns)
        + link.log_extreme(figure_x, figure_y, landmark_x, landmark_y)
        + figures.log_prior[:, None]
        + landmarks.log_prior[None, :]
    )
    # Nothing is its own landmark; the last entries are places, not objects.
    same = jnp.eye(size, dtype=bool).at[size - 1, size - 1].set(False)
    return jnp.where(same, -jnp.inf, table)


def new_figure(
    link: Link, figures: Candidates, landmarks: Candidates, draws: Draws, scene: Scene
) -> Option:
    """Hang one draw from the relation on each landmark; with no relation, anywhere unseen."""
    frame = link.frame(landmarks.x, landmarks.y)
    offset_x, offset_y = link.sample(draws.distance[0], draws.angle[0], frame)
    is_free = link.relation == NONE
    x = jnp.where(is_free, draws.unseen_x[0], landmarks.x + offset_x)
    y = jnp.where(is_free, draws.unseen_y[0], landmarks.y + offset_y)
    log_missed = jnp.where(is_free, scene.log_unseen, log_miss_at(scene.coverage, x, y))
    log_weight = log_missed + landmarks.log_prior + link.log_extreme(x, y, landmarks.x, landmarks.y)
    log_weight = jnp.where(figures.is_open, log_weight, -jnp.inf)
    return Option(log_weight, x, y, landmarks.x, landmarks.y)


def new_landmark(
    link: Link, figures: Candidates, landmarks: Candidates, draws: Draws, scene: Scene
) -> Option:
    """Hang a landmark on each figure: drawn backwards, corrected for the frame it then has."""
    frame = link.frame(figures.x, figures.y)
    offset_x, offset_y = link.sample(draws.distance[1], draws.angle[1], frame)
    x, y = figures.x - offset_x, figures.y - offset_y
    log_correction = link.log_density(offset_x, offset_y, link.frame(x, y)) - link.log_density(
        offset_x, offset_y, frame
    )
    log_weight = (
        log_miss_at(scene.coverage, x, y)
        + log_correction
        + figures.log_prior
        + link.log_extreme(figures.x, figures.y, x, y)
    )
    log_weight = jnp.where(landmarks.is_open, log_weight, -jnp.inf)
    return Option(log_weight, figures.x, figures.y, x, y)


def new_pair(
    link: Link, figures: Candidates, landmarks: Candidates, draws: Draws, scene: Scene
) -> Option:
    """Put the landmark anywhere unexplored and the figure where the relation has it."""
    landmark_x, landmark_y = draws.unseen_x, draws.unseen_y
    frame = link.frame(landmark_x, landmark_y)
    offset_x, offset_y = link.sample(draws.distance[0], draws.angle[0], frame)
    x, y = landmark_x + offset_x, landmark_y + offset_y
    # The landmark is uniform over the area: its share of unexplored area, times A for the root.
    log_weight = (
        scene.log_unseen
        + link.log_area
        - jnp.log(float(NUM_UNSEEN))
        + log_miss_at(scene.coverage, x, y)
        + link.log_extreme(x, y, landmark_x, landmark_y)
    )
    log_weight = jnp.where(figures.is_open & landmarks.is_open, log_weight, -jnp.inf)
    return Option(log_weight, x, y, landmark_x, landmark_y)


def log_root(link: Link, figures: Candidates, landmarks: Candidates) -> Array:
    """Give the uniform prior over the area to one thing of each chain of relations.

    A figure grounded earlier that is now placed against the robot gives its share back.
    """
    is_placed = ~figures.is_open & (link.is_robot | (link.relation == NONE))
    both_open = figures.is_open & landmarks.is_open
    return jnp.where(both_open, -link.log_area, jnp.where(is_placed, link.log_area, 0.0))
