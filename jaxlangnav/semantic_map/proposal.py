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

People err and mislead: with probability ε a relation says nothing about where its figure is, and
f is (1 − ε) times the relation's density plus ε / A. Without this the robot searches for ever for
a hydrant "in front of the cone" that stands behind it.

Everything takes one particle, or all of them with the particle axis last ("..." in shapes).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.axes import column, lead, pick
from jaxlangnav.numerics.once import once
from jaxlangnav.pytree import replace
from jaxlangnav.relations import Law, law_of, robot_frame
from jaxlangnav.semantic_map import options
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.options import Candidates, Draws, Link, Observed, Scene
from jaxlangnav.semantic_map.order import PLURAL, SIDES, Order
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.referents import Grounding, enter

_LOG_FLOOR = -60.0


class Told(NamedTuple):
    """What a relation of its reading tells each particle."""

    figure: Array  # i32[...] mention; NONE where the reading has no such relation
    landmark: Array  # i32[...] mention; NONE
    relation: Array  # i32[...] relation index; NONE
    is_superlative: Array  # bool[...]
    figure_type: Array  # i32[...] object type
    landmark_type: Array  # i32[...] object type; ROBOT; NONE
    is_side: Array  # bool[...] "on your left": a side of the robot
    order: Array  # i32[...] place in an order ("second", "leftmost"); 0 where nothing is ordered
    sides: Array  # i32[J, ...] sides of the robot on which the figure is said to be; NONE
    law: Law  # leaves f32[...]


def nothing_grounded(num_mentions: int, *batch: int) -> Grounding:
    """Build the carry before the first relation, for a batch of particles."""
    none = jnp.full((num_mentions, *batch), NONE, jnp.int32)
    zero = jnp.zeros((num_mentions, *batch), jnp.float32)
    return Grounding(none, zero, zero, none, none, jnp.zeros(none.shape, bool), jnp.zeros(batch))


def _of_reading(table: Array, reading: Array) -> Array:
    """Look up a table [K, n] by the reading that each particle believes: [n, ...]."""
    index = jnp.broadcast_to(reading, (table.shape[1], *reading.shape))
    return pick(column(table, 1 + index.ndim), index)


def _candidates(
    particle: Observed,
    grounding: Grounding,
    mention: Array,
    mention_type: Array,
    viewer: Array,
    is_place: Array,
    log_bystander: Array,
) -> Candidates:
    """List what a mention may refer to; ``is_place`` puts it where the viewer is."""
    is_grounded = pick(grounding.is_grounded, mention)
    decided = is_place | is_grounded
    fits = (particle.object_type == mention_type[None]) & ~decided[None]

    def append(objects: Array, place: Array) -> Array:
        return jnp.concatenate([objects, place[None]])

    return Candidates(
        x=append(
            particle.mean_x,
            jnp.where(is_place, viewer[0], pick(grounding.x, mention)),
        ),
        y=append(
            particle.mean_y,
            jnp.where(is_place, viewer[1], pick(grounding.y, mention)),
        ),
        log_prior=append(
            jnp.where(fits, lead(log_bystander, fits.ndim), -jnp.inf),
            jnp.where(decided, 0.0, -jnp.inf),
        ),
        is_open=~decided,
    )


def look_up(readings: Readings, reading: Array, params: MapParams) -> Told:
    """Look up all relations of the particles' readings.

    Args:
        readings: the sentence.
        reading: i32[...], the reading each particle believes.
        params: relations.

    Returns:
        What is told, leaves [J, ...].
    """
    mention_type, figure, landmark, relation, rank, is_superlative = (
        _of_reading(table, reading)
        for table in (
            readings.mention_type,
            readings.figure,
            readings.landmark,
            readings.relation,
            readings.rank,
            readings.is_superlative,
        )
    )
    landmark_type = jnp.where(landmark == NONE, NONE, pick(mention_type, landmark))
    is_robot = landmark_type == ROBOT
    is_ordered = (rank > 1) | ((rank == 1) & is_robot)
    side = jnp.where(is_robot & (rank == 0), relation, NONE)
    # One figure's sides come from all the relations it has with the robot.
    sides = jnp.where(figure[:, None] == figure[None], side[None], NONE)
    return Told(
        figure=figure,
        landmark=landmark,
        relation=relation,
        is_superlative=is_superlative,
        figure_type=pick(mention_type, figure),
        landmark_type=landmark_type,
        is_side=jnp.isin(side, jnp.asarray(SIDES)),
        order=jnp.where(is_ordered, rank, 0),
        sides=sides,
        law=law_of(params.relations, jnp.maximum(relation, 0)),
    )


def _link(particle: Observed, told: Told, draws: Draws, scene: Scene, params: MapParams) -> Link:
    """Gather what the ways to ground a relation need to know of it."""
    rival_x, rival_y = particle.mean_x, particle.mean_y
    is_rival = particle.object_type == told.figure_type[None]
    is_told = told.relation != NONE
    order = Order(
        relation=told.relation,
        rank=told.order,
        viewer_x=scene.viewer[0],
        viewer_y=scene.viewer[1],
        robot=robot_frame(scene.viewer[2]),
        sides=told.sides,
        rival_x=rival_x,
        rival_y=rival_y,
        is_rival=is_rival,
        unseen_x=draws.unseen_x,
        unseen_y=draws.unseen_y,
        log_new=jnp.log(PLURAL * params.concentration) + scene.log_unseen,
        softness=params.superlative_softness,
    )
    return Link(
        figure=told.figure,
        landmark=told.landmark,
        relation=told.relation,
        is_superlative=told.is_superlative & is_told,
        is_ordered=told.order > 0,
        is_side=told.is_side,
        is_robot=told.landmark_type == ROBOT,
        viewer=scene.viewer,
        robot=robot_frame(scene.viewer[2]),
        rival_x=rival_x,
        rival_y=rival_y,
        is_rival=is_rival,
        log_area=jnp.log(area_size(scene.coverage)),
        model=params.relations,
        law=told.law,
        softness=params.superlative_softness,
        log_told=jnp.where(is_told, jnp.log1p(-params.misleading), -jnp.inf),
        log_free=jnp.where(is_told, jnp.log(params.misleading), 0.0),
        order=order,
    )


def ground_relation(
    particle: Observed,
    told: Told,
    grounding: Grounding,
    draws: Draws,
    scene: Scene,
    params: MapParams,
) -> Grounding:
    """Ground one annotated relation of one particle's reading (eq. 7a).

    Args:
        particle: what it has seen.
        told: the relation, from ``look_up``.
        grounding: what earlier relations have decided.
        draws: random numbers.
        scene: coverage and viewer.
        params: relations, concentration.

    Returns:
        The carry with figure and landmark decided; unchanged where the reading has no such
        relation.
    """
    told = once(told)
    link = _link(particle, told, draws, scene, params)
    log_bystander = link.log_area - jnp.log(params.concentration)  # 1/λ
    batch = told.relation.shape
    none_fixed = jnp.zeros(batch, bool)
    figures = _candidates(
        particle, grounding, link.figure, told.figure_type, scene.viewer, none_fixed, log_bystander
    )
    is_place = link.is_robot | (link.relation == NONE)
    landmarks = _candidates(
        particle,
        grounding,
        link.landmark,
        told.landmark_type,
        scene.viewer,
        is_place,
        log_bystander,
    )
    ways = once(options.propose(link, figures, landmarks, draws))
    log_weight = options.weigh(link, figures, landmarks, ways, scene)
    choice, log_total = categorical.draw(log_weight, draws.choice)
    log_total = jnp.maximum(log_total + options.log_root(link, figures, landmarks), _LOG_FLOOR)
    # Where no grounding is possible (a drawn figure fell outside the area), the words stay a
    # hypothesis somewhere unexplored, of hardly any weight, that the next looks can refute.
    is_dead = (log_total <= _LOG_FLOOR)[None]
    after = enter(grounding, link, figures, landmarks, ways, choice)
    after = after._replace(
        slot=jnp.where(is_dead & after.is_grounded & ~grounding.is_grounded, NONE, after.slot),
        anchor=jnp.where(is_dead, grounding.anchor, after.anchor),
        root=jnp.where(is_dead, grounding.root, after.root),
        x=jnp.where(is_dead & ~grounding.is_grounded, draws.unseen_x[:1], after.x),
        y=jnp.where(is_dead & ~grounding.is_grounded, draws.unseen_y[:1], after.y),
    )
    is_valid = link.figure != NONE
    after = after._replace(log_weight=grounding.log_weight + log_total)
    return Grounding(
        *(
            jnp.where(lead(is_valid, new.ndim), new, old)
            for new, old in zip(after, grounding, strict=True)
        )
    )


def adopt(
    particle: SemanticMap, readings: Readings, reading: Array, grounding: Grounding
) -> SemanticMap:
    """Give a particle a reading and what its mentions refer to.

    Args:
        particle: its former hypotheses are taken back.
        readings: the sentence.
        reading: i32[...], the reading.
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
        is_mentioned=(_of_reading(readings.mention_type, reading) >= 0) & grounding.is_grounded,
    )
