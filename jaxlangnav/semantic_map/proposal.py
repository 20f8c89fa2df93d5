"""Proposal for annotations: to what do the words refer? (section 3.2, eq. 7a)

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
    return Grounding(
        none, zero, zero, none, none, jnp.zeros(num_mentions, bool), jnp.float32(0.0)
    )


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
    fixed_x: Array,
    fixed_y: Array,
    is_fixed: Array,
    log_new_object: Array,
) -> Candidates:
    """List what a mention may refer to; ``is_fixed`` places it without an object."""
    num_objects = particle.object_type.shape[0]
    is_grounded = _pick(grounding.is_grounded, mention)
    decided = is_fixed | is_grounded
    fits = (particle.object_type == mention_type) & ~decided
    return Candidates(
        x=jnp.append(
            particle.mean_x[:num_objects],
            jnp.where(is_fixed, fixed_x, _pick(grounding.x, mention)),
        ),
        y=jnp.append(
            particle.mean_y[:num_objects],
            jnp.where(is_fixed, fixed_y, _pick(grounding.y, mention)),
        ),
        log_prior=jnp.append(
            jnp.where(fits, log_new_object, -jnp.inf), jnp.where(decided, 0.0, -jnp.inf)
        ),
        is_open=~decided,
    )


def _log_superlative(
    particle: SemanticMap,
    figure_type: Array,
    relation: Array,
    is_superlative: Array,
    softness: Array,
    figure_x: Array,
    figure_y: Array,
    landmark_x: Array,
    landmark_y: Array,
) -> Array:
    """Penalise a figure that another observed object of its type beats ("nearest")."""
    num_objects = particle.object_type.shape[0]
    rivals = particle.object_type == figure_type

    def distance(offset_x: Array, offset_y: Array) -> Array:
        return jnp.sqrt(offset_x * offset_x + offset_y * offset_y + 1e-9)

    sign = jnp.where(relation == FAR, -1.0, 1.0)
    own = sign * distance(figure_x - landmark_x, figure_y - landmark_y)
    shape = (num_objects,) + (1,) * own.ndim
    rival_x = particle.mean_x[:num_objects].reshape(shape) - landmark_x[None]
    rival_y = particle.mean_y[:num_objects].reshape(shape) - landmark_y[None]
    rival = jnp.where(rivals.reshape(shape), sign * distance(rival_x, rival_y), jnp.inf)
    excess = own - jnp.minimum(jnp.min(rival, axis=0), own)
    return jnp.where(is_superlative, -excess / softness, 0.0)


def _relation_log_density(
    model: RelationModel, relation: Array, x: Array, y: Array, frame: Frame, log_area: Array
) -> Array:
    """Evaluate a relation, or the uniform law over the area where there is none."""
    density = log_density(model, jnp.maximum(relation, 0), x, y, frame)
    return jnp.where(relation == NONE, -log_area, density)


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
    num_objects = particle.object_type.shape[0]
    size = num_objects + 1
    figure, landmark = readings.figure[reading, index], readings.landmark[reading, index]
    relation = readings.relation[reading, index]
    figure_type = readings.mention_type[reading, figure]
    landmark_type = jnp.where(
        landmark == NONE, NONE, readings.mention_type[reading, jnp.maximum(landmark, 0)]
    )
    is_superlative = readings.is_superlative[reading, index] & (relation != NONE)
    is_robot = landmark_type == ROBOT
    log_area = jnp.log(area_size(scene.coverage))
    log_bystander = log_area - jnp.log(params.concentration)  # log 1/λ
    viewer_x, viewer_y, heading = scene.viewer[0], scene.viewer[1], scene.viewer[2]

    figures = _candidates(
        particle, grounding, figure, figure_type, viewer_x, viewer_y,
        jnp.asarray(False), log_bystander,
    )  # fmt: skip
    landmarks = _candidates(
        particle, grounding, landmark, landmark_type, viewer_x, viewer_y,
        is_robot | (relation == NONE), log_bystander,
    )  # fmt: skip
    # One of the two ends has the uniform prior over the area, unless an earlier relation gave it.
    # A figure grounded earlier that is now placed against the robot gives its share back.
    is_placed = ~figures.is_open & (is_robot | (relation == NONE))
    log_root = jnp.where(is_placed, log_area, 0.0)
    log_root = jnp.where(figures.is_open & landmarks.is_open, -log_area, log_root)

    own_frame = robot_frame(heading)

    def frame_at(x: Array, y: Array) -> Frame:
        seen = viewer_frame(viewer_x, viewer_y, x, y)
        return Frame(
            along_x=jnp.where(is_robot, own_frame.along_x, seen.along_x),
            along_y=jnp.where(is_robot, own_frame.along_y, seen.along_y),
            lateral_x=jnp.where(is_robot, own_frame.lateral_x, seen.lateral_x),
            lateral_y=jnp.where(is_robot, own_frame.lateral_y, seen.lateral_y),
        )

    def log_relation(offset_x: Array, offset_y: Array, frame: Frame) -> Array:
        return _relation_log_density(
            params.relations, relation, offset_x, offset_y, frame, log_area
        )

    def log_extreme(fx: Array, fy: Array, lx: Array, ly: Array) -> Array:
        return _log_superlative(
            particle, figure_type, relation, is_superlative, params.superlative_softness,
            fx, fy, lx, ly,
        )  # fmt: skip

    landmark_frame = frame_at(landmarks.x, landmarks.y)
    columns = Frame(
        along_x=landmark_frame.along_x[None, :],
        along_y=landmark_frame.along_y[None, :],
        lateral_x=landmark_frame.lateral_x[None, :],
        lateral_y=landmark_frame.lateral_y[None, :],
    )
    # Both known: a table of figures × landmarks; nothing is its own landmark.
    table = (
        log_relation(
            figures.x[:, None] - landmarks.x[None, :],
            figures.y[:, None] - landmarks.y[None, :],
            columns,
        )
        + figures.log_prior[:, None]
        + landmarks.log_prior[None, :]
        + log_root
        + log_extreme(
            figures.x[:, None], figures.y[:, None], landmarks.x[None, :], landmarks.y[None, :]
        )
    )
    same = jnp.eye(size, dtype=bool).at[size - 1, size - 1].set(False)
    table = jnp.where(same, -jnp.inf, table)

    # New figure: one draw from the relation, hung on each landmark.
    safe_relation = jnp.maximum(relation, 0)
    along, lateral = sample_polar(
        params.relations, safe_relation, draws.distance[0], draws.angle[0]
    )
    hung_x, hung_y = to_map(landmark_frame, along, lateral)
    is_free = relation == NONE
    new_figure_x = jnp.where(is_free, draws.unseen_x[0], landmarks.x + hung_x)
    new_figure_y = jnp.where(is_free, draws.unseen_y[0], landmarks.y + hung_y)
    log_missed = log_miss_at(scene.coverage, new_figure_x, new_figure_y)
    log_new_figure = jnp.where(
        figures.is_open,
        jnp.where(is_free, scene.log_unseen, log_missed)
        + landmarks.log_prior
        + log_root
        + log_extreme(new_figure_x, new_figure_y, landmarks.x, landmarks.y),
        -jnp.inf,
    )

    # New landmark: the same, drawn backwards from each figure and corrected for the frame.
    along, lateral = sample_polar(
        params.relations, safe_relation, draws.distance[1], draws.angle[1]
    )
    figure_frame = frame_at(figures.x, figures.y)
    back_x, back_y = to_map(figure_frame, along, lateral)
    new_landmark_x, new_landmark_y = figures.x - back_x, figures.y - back_y
    log_correction = log_relation(
        back_x, back_y, frame_at(new_landmark_x, new_landmark_y)
    ) - log_relation(back_x, back_y, figure_frame)
    log_new_landmark = jnp.where(
        landmarks.is_open,
        log_miss_at(scene.coverage, new_landmark_x, new_landmark_y)
        + log_correction
        + figures.log_prior
        + log_root
        + log_extreme(figures.x, figures.y, new_landmark_x, new_landmark_y),
        -jnp.inf,
    )

    # Both new: the landmark anywhere unexplored, the figure where the relation puts it.
    pair_landmark_x, pair_landmark_y = draws.unseen_x, draws.unseen_y
    along, lateral = sample_polar(
        params.relations, safe_relation, draws.distance[0], draws.angle[0]
    )
    step_x, step_y = to_map(frame_at(pair_landmark_x, pair_landmark_y), along, lateral)
    pair_figure_x, pair_figure_y = pair_landmark_x + step_x, pair_landmark_y + step_y
    log_new_pair = jnp.where(
        figures.is_open & landmarks.is_open,
        scene.log_unseen
        - jnp.log(float(NUM_UNSEEN))
        + log_miss_at(scene.coverage, pair_figure_x, pair_figure_y)
        + log_extreme(pair_figure_x, pair_figure_y, pair_landmark_x, pair_landmark_y),
        -jnp.inf,
    )

    weights = jnp.concatenate([table.reshape(-1), log_new_figure, log_new_landmark, log_new_pair])
    choice, log_total = categorical.draw(weights, draws.choice)
    in_table = choice < size * size
    in_figure = ~in_table & (choice < size * size + size)
    in_landmark = ~in_table & ~in_figure & (choice < size * size + 2 * size)
    in_pair = choice >= size * size + 2 * size
    rest = jnp.where(in_figure, choice - size * size, choice - size * size - size)
    pair = jnp.maximum(choice - size * size - 2 * size, 0)
    figure_index = jnp.where(in_table, choice // size, rest)
    landmark_index = jnp.where(in_table, choice % size, rest)

    def place(known: Array, from_new: Array, from_pair: Array, index: Array, is_new: Array) -> Array:
        value = jnp.where(is_new, _pick(from_new, rest), _pick(known, index))
        return jnp.where(in_pair, _pick(from_pair, pair), value)

    figure_x = place(figures.x, new_figure_x, pair_figure_x, figure_index, in_figure)
    figure_y = place(figures.y, new_figure_y, pair_figure_y, figure_index, in_figure)
    landmark_x = place(landmarks.x, new_landmark_x, pair_landmark_x, landmark_index, in_landmark)
    landmark_y = place(landmarks.y, new_landmark_y, pair_landmark_y, landmark_index, in_landmark)
    figure_slot = jnp.where(in_figure | in_pair | (figure_index == num_objects), NONE, figure_index)
    landmark_slot = jnp.where(
        in_landmark | in_pair | (landmark_index == num_objects), NONE, landmark_index
    )
    # Enter figure and landmark; an end decided earlier, or the robot, keeps what it had.
    is_valid = figure != NONE
    mentions = jnp.arange(grounding.slot.shape[0])
    old_landmark_slot = jnp.where(landmark == NONE, NONE, _pick(grounding.slot, landmark))
    landmark_now = jnp.where(landmarks.is_open, landmark_slot, old_landmark_slot)
    old_figure_slot = _pick(grounding.slot, figure)
    figure_now = jnp.where(figures.is_open, figure_slot, old_figure_slot)
    is_landmark_object = (landmark != NONE) & ~is_robot
    landmark_place = jnp.where(landmark_now == NONE, num_objects + landmark, landmark_now)
    figure_place = jnp.where(figure_now == NONE, num_objects + figure, figure_now)
    new_figure_anchor = jnp.where(is_landmark_object, landmark_place, NONE)
    landmark_root = jnp.where(
        landmark_now == NONE, jnp.where(landmarks.is_open, NONE, _pick(grounding.root, landmark)),
        landmark_now,
    )  # fmt: skip
    figure_root = jnp.where(is_landmark_object, landmark_root, NONE)
    new_landmark_anchor = jnp.where(in_landmark, figure_place, NONE)
    new_landmark_root = jnp.where(
        in_landmark,
        jnp.where(figure_now == NONE, _pick(grounding.root, figure), figure_now),
        NONE,
    )
    set_figure = (mentions == figure) & figures.is_open & is_valid
    set_landmark = (mentions == landmark) & landmarks.is_open & is_landmark_object & is_valid

    def enter(old: Array, for_figure: Array, for_landmark: Array) -> Array:
        return jnp.where(set_figure, for_figure, jnp.where(set_landmark, for_landmark, old))

    log_weight = jnp.maximum(log_total, _LOG_FLOOR)
    return Grounding(
        slot=enter(grounding.slot, figure_slot, landmark_slot),
        x=enter(grounding.x, figure_x, landmark_x),
        y=enter(grounding.y, figure_y, landmark_y),
        anchor=enter(grounding.anchor, new_figure_anchor, new_landmark_anchor),
        root=enter(grounding.root, figure_root, new_landmark_root),
        is_grounded=grounding.is_grounded | set_figure | set_landmark,
        log_weight=grounding.log_weight + jnp.where(is_valid, log_weight, 0.0),
    )


def adopt(particle: SemanticMap, readings: Readings, reading: Array, grounding: Grounding) -> SemanticMap:
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
