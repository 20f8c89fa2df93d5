"""Proposal for annotations: to what do the words refer? (section 3.2, eq. 7a).

Each annotated relation samples its figure and landmark jointly from the observed objects or from
new ones under a Dirichlet-process prior, and the metric constraint of a new one from the
relation's likelihood. The prior behind it: every thing mentioned exists once, anywhere in the
operating area A or where a relation places it; further objects of each type are scattered at a
density λ = α / A. Against "all observed objects are bystanders", the groundings weigh

    both observed     f(x_f − x_l) A / α²          figure new      E_f[m] / α
    landmark new      E_f[m] / α                   both new        u E_f[m]

(f the relation's density, m the probability of having missed something, u its mean over A), and
with no relation 1/α against u: the Dirichlet process, with "new" scaled by what is unexplored.
Expectations are taken by sampling the place itself, so the draw is properly weighted and the
total is an unbiased estimate of the evidence of the sentence given the observed map.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import FAR, NONE, ROBOT, Readings
from jaxlangnav.numerics import categorical
from jaxlangnav.pytree import replace
from jaxlangnav.relations import (
    Frame,
    RelationModel,
    log_density,
    robot_frame,
    sample_polar,
    to_map,
    viewer_frame,
)
from jaxlangnav.semantic_map.coverage import Coverage, area_size, log_miss_at
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap

NUM_UNSEEN = 2
"""Places drawn from the unexplored area for each particle and relation."""
_LOG_FLOOR = -60.0


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


class Grounding(NamedTuple):
    """Carry over the relations of a reading: what the mentions refer to so far."""

    slot: Array  # i32[M] observed slot; NONE while hypothesised
    x: Array  # f32[M] metres
    y: Array  # f32[M]
    anchor: Array  # i32[M] slot in [0, N) or NONE
    root: Array  # i32[M] observed slot or NONE
    is_grounded: Array  # bool[M]
    log_weight: Array  # f32[]


class Candidates(NamedTuple):
    """What one end of a relation may be: each observed object, or the place already decided."""

    x: Array  # f32[O + 1] the last entry is the place already decided
    y: Array  # f32[O + 1]
    log_prior: Array  # f32[O + 1] −∞ where it is no candidate
    is_open: Array  # bool[] nothing decided: may also be a new object


def nothing_grounded(num_mentions: int) -> Grounding:
    """Build the carry before the first relation."""
    none = jnp.full(num_mentions, NONE, jnp.int32)
    zero = jnp.zeros(num_mentions, jnp.float32)
    return Grounding(none, zero, zero, none, none, jnp.zeros(num_mentions, bool), jnp.float32(0.0))


def _pick(values: Array, index: Array) -> Array:
    """Read ``values[index]`` by a one-hot sum, which vectorises over particles."""
    one_hot = jnp.arange(values.shape[0]) == index
    if values.dtype == bool:
        return jnp.any(values & one_hot)
    return jnp.sum(jnp.where(one_hot, values, jnp.zeros((), values.dtype)))


def _candidates(
    particle: SemanticMap,
    grounding: Grounding,
    mention: Array,
    mention_type: Array,
    viewer: Array,
    is_place: Array,
    log_bystander: Array,
) -> Candidates:
    """List what a mention may refer to; ``is_place`` puts it where the viewer is."""
    num_objects = particle.object_type.shape[0]
    is_grounded = _pick(grounding.is_grounded, mention)
    decided = is_place | is_grounded
    fits = (particle.object_type == mention_type) & ~decided
    return Candidates(
        x=jnp.append(
            particle.mean_x[:num_objects],
            jnp.where(is_place, viewer[0], _pick(grounding.x, mention)),
        ),
        y=jnp.append(
            particle.mean_y[:num_objects],
            jnp.where(is_place, viewer[1], _pick(grounding.y, mention)),
        ),
        log_prior=jnp.append(
            jnp.where(fits, log_bystander, -jnp.inf), jnp.where(decided, 0.0, -jnp.inf)
        ),
        is_open=~decided,
    )


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


def _read_link(
    particle: SemanticMap, readings: Readings, reading: Array, index: Array, scene: Scene,
    params: MapParams,
) -> tuple[Link, Array, Array]:  # fmt: skip
    """Look up a relation of a reading; also the types of its figure and landmark."""
    num_objects = particle.object_type.shape[0]
    figure, landmark = readings.figure[reading, index], readings.landmark[reading, index]
    relation = readings.relation[reading, index]
    figure_type = readings.mention_type[reading, figure]
    landmark_type = readings.mention_type[reading, jnp.maximum(landmark, 0)]
    landmark_type = jnp.where(landmark == NONE, NONE, landmark_type)
    link = Link(
        figure=figure,
        landmark=landmark,
        relation=relation,
        is_superlative=readings.is_superlative[reading, index] & (relation != NONE),
        is_robot=landmark_type == ROBOT,
        viewer=scene.viewer,
        robot=robot_frame(scene.viewer[2]),
        rival_x=particle.mean_x[:num_objects],
        rival_y=particle.mean_y[:num_objects],
        is_rival=particle.object_type == figure_type,
        log_area=jnp.log(area_size(scene.coverage)),
        model=params.relations,
        softness=params.superlative_softness,
    )
    return link, figure_type, landmark_type


def _both_known(link: Link, figures: Candidates, landmarks: Candidates) -> Array:
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


def _new_figure(
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


def _new_landmark(
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


def _new_pair(
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


def _log_root(link: Link, figures: Candidates, landmarks: Candidates) -> Array:
    """Give the uniform prior over the area to one thing of each chain of relations.

    A figure grounded earlier that is now placed against the robot gives its share back.
    """
    is_placed = ~figures.is_open & (link.is_robot | (link.relation == NONE))
    both_open = figures.is_open & landmarks.is_open
    return jnp.where(both_open, -link.log_area, jnp.where(is_placed, link.log_area, 0.0))


def ground_relation(
    particle: SemanticMap,
    readings: Readings,
    reading: Array,
    index: Array,
    grounding: Grounding,
    draws: Draws,
    scene: Scene,
    params: MapParams,
) -> Grounding:
    """Ground one annotated relation of one particle's reading (eq. 7a).

    Args:
        particle: one particle, with the observed map.
        readings: the sentence.
        reading: i32[], the reading this particle believes.
        index: i32[], which of the J relations.
        grounding: what earlier relations have decided.
        draws: random numbers.
        scene: coverage and viewer.
        params: relations, concentration.

    Returns:
        The carry with figure and landmark decided; unchanged where the reading has no such
        relation.
    """
    link, figure_type, landmark_type = _read_link(particle, readings, reading, index, scene, params)
    log_bystander = link.log_area - jnp.log(params.concentration)  # 1/λ
    none_fixed = jnp.zeros((), bool)
    figures = _candidates(
        particle, grounding, link.figure, figure_type, scene.viewer, none_fixed, log_bystander
    )
    is_place = link.is_robot | (link.relation == NONE)
    landmarks = _candidates(
        particle, grounding, link.landmark, landmark_type, scene.viewer, is_place, log_bystander
    )
    known = _both_known(link, figures, landmarks)
    options = (
        _new_figure(link, figures, landmarks, draws, scene),
        _new_landmark(link, figures, landmarks, draws, scene),
        _new_pair(link, figures, landmarks, draws, scene),
    )
    log_weights = [known.reshape(-1), *(option.log_weight for option in options)]
    choice, log_total = categorical.draw(jnp.concatenate(log_weights), draws.choice)
    log_total = jnp.maximum(log_total + _log_root(link, figures, landmarks), _LOG_FLOOR)
    # Where no grounding is possible (a drawn figure fell outside the area), the words stay a
    # hypothesis somewhere unexplored, of hardly any weight, that the next looks can refute.
    is_dead = log_total <= _LOG_FLOOR
    after = _enter(particle, link, figures, landmarks, grounding, options, choice)
    after = after._replace(
        slot=jnp.where(is_dead & after.is_grounded & ~grounding.is_grounded, NONE, after.slot),
        anchor=jnp.where(is_dead, grounding.anchor, after.anchor),
        root=jnp.where(is_dead, grounding.root, after.root),
        x=jnp.where(is_dead & ~grounding.is_grounded, draws.unseen_x[0], after.x),
        y=jnp.where(is_dead & ~grounding.is_grounded, draws.unseen_y[0], after.y),
    )
    is_valid = link.figure != NONE
    after = after._replace(log_weight=grounding.log_weight + log_total)
    return Grounding(
        *(jnp.where(is_valid, new, old) for new, old in zip(after, grounding, strict=True))
    )


def _enter(
    particle: SemanticMap,
    link: Link,
    figures: Candidates,
    landmarks: Candidates,
    grounding: Grounding,
    options: tuple[Option, Option, Option],
    choice: Array,
) -> Grounding:
    """Enter the chosen figure and landmark into the carry; ends decided earlier stay."""
    num_objects, size = particle.object_type.shape[0], particle.object_type.shape[0] + 1
    new_figure, new_landmark, new_pair = options
    rest = choice - size * size
    is_known, is_figure = rest < 0, (rest >= 0) & (rest < size)
    is_landmark, is_pair = (rest >= size) & (rest < 2 * size), rest >= 2 * size
    other = jnp.where(is_figure, rest, rest - size)
    figure_index = jnp.where(is_known, choice // size, other)
    landmark_index = jnp.where(is_known, choice % size, other)

    def place(known: Array, hung: Array, paired: Array, index: Array, is_hung: Array) -> Array:
        value = jnp.where(is_hung, _pick(hung, other), _pick(known, index))
        return jnp.where(is_pair, _pick(paired, rest - 2 * size), value)

    def slot(mention: Array, ends: Candidates, index: Array, is_new: Array) -> Array:
        chosen = jnp.where(is_new | is_pair | (index == num_objects), NONE, index)
        return jnp.where(
            ends.is_open, chosen, jnp.where(mention == NONE, NONE, _pick(grounding.slot, mention))
        )

    figure_slot = slot(link.figure, figures, figure_index, is_figure)
    landmark_slot = slot(link.landmark, landmarks, landmark_index, is_landmark)

    def root(mention: Array, ends: Candidates, own_slot: Array) -> Array:
        """Observed slot at which the chain of an end finishes; NONE for the ground."""
        inherited = jnp.where(ends.is_open, NONE, _pick(grounding.root, mention))
        return jnp.where(own_slot == NONE, inherited, own_slot)

    def own_place(mention: Array, own_slot: Array) -> Array:
        return jnp.where(own_slot == NONE, num_objects + mention, own_slot)

    is_object = (link.landmark != NONE) & ~link.is_robot
    figure_anchor = jnp.where(is_object, own_place(link.landmark, landmark_slot), NONE)
    figure_root = jnp.where(is_object, root(link.landmark, landmarks, landmark_slot), NONE)
    landmark_anchor = jnp.where(is_landmark, own_place(link.figure, figure_slot), NONE)
    landmark_root = jnp.where(is_landmark, root(link.figure, figures, figure_slot), NONE)
    mentions = jnp.arange(grounding.slot.shape[0])
    set_figure = (mentions == link.figure) & figures.is_open
    set_landmark = (mentions == link.landmark) & landmarks.is_open & is_object

    def enter(old: Array, for_figure: Array, for_landmark: Array) -> Array:
        return jnp.where(set_figure, for_figure, jnp.where(set_landmark, for_landmark, old))

    return Grounding(
        slot=enter(grounding.slot, figure_slot, landmark_slot),
        x=enter(
            grounding.x,
            place(figures.x, new_figure.figure_x, new_pair.figure_x, figure_index, is_figure),
            place(
                landmarks.x, new_landmark.landmark_x, new_pair.landmark_x, landmark_index,
                is_landmark,
            ),
        ),
        y=enter(
            grounding.y,
            place(figures.y, new_figure.figure_y, new_pair.figure_y, figure_index, is_figure),
            place(
                landmarks.y, new_landmark.landmark_y, new_pair.landmark_y, landmark_index,
                is_landmark,
            ),
        ),
        anchor=enter(grounding.anchor, figure_anchor, landmark_anchor),
        root=enter(grounding.root, figure_root, landmark_root),
        is_grounded=grounding.is_grounded | set_figure | set_landmark,
        log_weight=grounding.log_weight,
    )  # fmt: skip


def adopt(
    particle: SemanticMap, readings: Readings, reading: Array, grounding: Grounding
) -> SemanticMap:
    """Give a particle a reading and what its mentions refer to.

    Args:
        particle: one particle; its former hypotheses are taken back.
        readings: the sentence.
        reading: i32[], the reading.
        grounding: from ``ground_relation`` over all relations.

    Returns:
        The particle with new hypotheses.
    """
    return replace(
        particle,
        reading=reading,
        referent=grounding.slot,
        anchor=grounding.anchor,
        root=grounding.root,
        hypothesis_x=grounding.x,
        hypothesis_y=grounding.y,
        is_mentioned=(readings.mention_type[reading] >= 0) & grounding.is_grounded,
    )
