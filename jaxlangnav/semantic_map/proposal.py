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

from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.numerics import categorical
from jaxlangnav.pytree import replace
from jaxlangnav.relations import robot_frame
from jaxlangnav.semantic_map import options
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.options import Candidates, Draws, Link, Option, Scene
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap

_LOG_FLOOR = -60.0


class Grounding(NamedTuple):
    """Carry over the relations of a reading: what the mentions refer to so far."""

    slot: Array  # i32[M] observed slot; NONE while hypothesised
    x: Array  # f32[M] metres
    y: Array  # f32[M]
    anchor: Array  # i32[M] slot in [0, N) or NONE
    root: Array  # i32[M] observed slot or NONE
    is_grounded: Array  # bool[M]
    log_weight: Array  # f32[]


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
    known = options.both_known(link, figures, landmarks)
    ways = (
        options.new_figure(link, figures, landmarks, draws, scene),
        options.new_landmark(link, figures, landmarks, draws, scene),
        options.new_pair(link, figures, landmarks, draws, scene),
    )
    log_weights = [known.reshape(-1), *(way.log_weight for way in ways)]
    choice, log_total = categorical.draw(jnp.concatenate(log_weights), draws.choice)
    log_total = jnp.maximum(log_total + options.log_root(link, figures, landmarks), _LOG_FLOOR)
    # Where no grounding is possible (a drawn figure fell outside the area), the words stay a
    # hypothesis somewhere unexplored, of hardly any weight, that the next looks can refute.
    is_dead = log_total <= _LOG_FLOOR
    after = _enter(particle, link, figures, landmarks, grounding, ways, choice)
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
    ways: tuple[Option, Option, Option],
    choice: Array,
) -> Grounding:
    """Enter the chosen figure and landmark into the carry; ends decided earlier stay."""
    num_objects, size = particle.object_type.shape[0], particle.object_type.shape[0] + 1
    new_figure, new_landmark, new_pair = ways
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
