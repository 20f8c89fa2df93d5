"""Ways to ground one relation: candidates for its ends, and places drawn (section 3.2, eq. 7a).

Each end is an observed object, the place that an earlier relation decided, or new. The ways to
ground the relation are counted through, and both what a way *is* and what it *means* are laid out
by the same two functions, ``_of_figures`` and ``_of_landmarks``:

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

from jaxlangnav.kinds import fits, is_anything, label_of
from jaxlangnav.messages import NONE
from jaxlangnav.numerics.batching import column, lead, pick, rarely
from jaxlangnav.relations import RelationModel
from jaxlangnav.semantic_map.counts import log_expected
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.said import FIGURE, LANDMARK, Said

NUM_UNSEEN = 2
"""Places drawn from the unexplored area for each particle and relation."""


class Draws(NamedTuple):
    """Random numbers for grounding one relation in one particle."""

    distance: Array  # f32[2, ...] standard normal: distance of a new figure; of a new landmark
    angle: Array  # f32[2, ...] standard normal: direction of a new figure; of a new landmark
    choice: Array  # f32[...] which grounding
    unseen_x: Array  # f32[NUM_UNSEEN, ...] metres, places in the unexplored area
    unseen_y: Array  # f32[NUM_UNSEEN, ...]


class Seen(NamedTuple):
    """What a particle has seen, as far as words can refer to it."""

    object_type: Array  # i32[O, ...] kinds; NONE in empty slots
    x: Array  # f32[O, ...] metres, map frame
    y: Array  # f32[O, ...]
    existence: Array | None = None  # f32[O, ...] probability that it exists; None: all of it does


class Scene(NamedTuple):
    """What all particles of an episode share while words are grounded.

    With particles of several episodes, everything has the particle axis too, and the coverage
    maps stand one below the other.
    """

    coverage: Coverage
    first_row: Array  # i32[] where in ``coverage`` the episode's map begins
    log_area: Array  # f32[] log A, square metres
    log_unseen: Array  # f32[] log u
    num_pooled: Array | None = None  # f32[] T, types that have one rate (``counts``); None: none


class Grounding(NamedTuple):
    """Carry over the relations of a reading: what the mentions refer to so far."""

    slot: Array  # i32[M, ...] observed slot; NONE while hypothesised
    x: Array  # f32[M, ...] metres
    y: Array  # f32[M, ...]
    anchor: Array  # i32[M, ...] slot in [0, N) or NONE
    root: Array  # i32[M, ...] observed slot or NONE
    is_grounded: Array  # bool[M, ...]
    log_weight: Array  # f32[...]


def nothing_grounded(num_mentions: int, *batch: int) -> Grounding:
    """Build the carry before the first relation, for a batch of particles."""
    none = jnp.full((num_mentions, *batch), NONE, jnp.int32)
    zero = jnp.zeros((num_mentions, *batch), jnp.float32)
    return Grounding(none, zero, zero, none, none, jnp.zeros(none.shape, bool), jnp.zeros(batch))


class Candidates(NamedTuple):
    """What the ends of a relation may be: each observed object, or the place already decided."""

    x: Array  # f32[2, O + 1, ...] metres; the last entry is the place already decided
    y: Array  # f32[2, O + 1, ...]
    log_prior: Array  # f32[2, O + 1, ...] −∞ where it is no candidate
    log_alike: Array  # f32[O, O, ...] what observed figures and landmarks of one type weigh more
    # than each by itself
    is_open: Array  # bool[2, ...] nothing decided: may also be a new object
    earlier: Grounding  # what they refer to already, leaves [2, ...]


class Pairs(NamedTuple):
    """Places of figures and of their landmarks, metres, map frame."""

    x: Array  # f32[W, ...]
    y: Array  # f32[W, ...]
    landmark_x: Array  # f32[W, ...]
    landmark_y: Array  # f32[W, ...]


class Ways(NamedTuple):
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
    """Lay out the figures of all ways, [W, ...].

    Args:
        known: [O + 1, ...], candidates.
        new: [2 (O + 1) + NUM_UNSEEN, ...], see ``_of_new``.
        unseen: [NUM_UNSEEN, ...], anywhere.
    """
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
    """Lay out what is new in the ways told: figures, landmarks, the figures of new pairs.

    Args:
        figure: [1, ...] or [O + 1, ...], at each known landmark.
        landmark: [1, ...] or [O + 1, ...], at each known figure.
        figure_of_pair: [1, ...] or [NUM_UNSEEN, ...], at each new landmark.
        size: O + 1.
    """
    numbers = (size, size, NUM_UNSEEN)
    return jnp.concatenate(
        [
            jnp.broadcast_to(part, (number, *part.shape[1:]))
            for part, number in zip((figure, landmark, figure_of_pair), numbers, strict=True)
        ]
    )


@functools.cache
def meaning(num_objects: int) -> tuple[np.ndarray, np.ndarray]:
    """Tell what each way stands for.

    Args:
        num_objects: O.

    Returns:
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
        return (
            np.stack([np.asarray(figure, np.int32), np.asarray(landmark, np.int32)]),
            np.stack([np.asarray(is_told), np.asarray(is_drawn)]),
        )


def list_candidates(
    seen: Seen, said: Said, grounding: Grounding, scene: Scene, *, params: MapParams
) -> Candidates:
    """List what the ends may be: what has been decided, or each seen object of their types.

    Args:
        seen: objects.
        said: the relation.
        grounding: what earlier relations have decided.
        scene: area and viewer.
        params: concentration, clumping.

    Returns:
        The candidates.
    """
    decided = [pick(leaf, said.mention) for leaf in grounding[:-1]]
    earlier = Grounding(*decided, log_weight=grounding.log_weight)
    # With the robot as the landmark, or with none, the figure stands against the viewer.
    is_viewer = jnp.stack([jnp.zeros_like(said.is_by_object), ~said.is_by_object])
    is_open = ~is_viewer & ~earlier.is_grounded
    is_kind = fits(seen.object_type[None], said.kind[:, None])
    slots = column(jnp.arange(seen.x.shape[0]), is_kind.ndim - 1)[None]
    may_be = is_kind & is_open[:, None] & ((said.excluded[:, None] >> slots) & 1 == 0)
    log_bystander, log_one, log_two = _log_bystanders(
        seen, is_kind, grounding, scene, params=params
    )
    is_any, label = is_anything(said.kind), label_of(seen.object_type)
    is_alike = label[:, None] == label[None]
    places = scene.log_area, scene.log_unseen, scene.num_pooled
    records = (jnp.concatenate([seen.x, seen.x]), is_alike, seen, *places)
    found = rarely(
        jnp.any(is_any, axis=0), lambda given: _of_any_type(*given[1:], params=params), records
    )
    log_of_any, log_gain_of_any = jnp.split(found, 2)
    log_bystander = jnp.where(is_any[:, None], log_of_any[None], log_bystander)
    log_gain = jnp.where(jnp.any(is_any, axis=0), log_gain_of_any, (log_one - log_two)[FIGURE])
    # Of one rate things of two types hang together as those of one type do.
    hang_together = is_alike if scene.num_pooled is None else jnp.ones_like(is_alike)

    def append(objects: Array, place: Array) -> Array:
        objects = jnp.broadcast_to(objects, may_be.shape)
        return jnp.concatenate([objects, place[:, None]], axis=1)

    viewer_x, viewer_y, _ = (lead(one, is_open.ndim) for one in jnp.unstack(said.viewer))
    return Candidates(
        x=append(seen.x[None], jnp.where(is_viewer, viewer_x, earlier.x)),
        y=append(seen.y[None], jnp.where(is_viewer, viewer_y, earlier.y)),
        log_prior=append(
            jnp.where(may_be, log_bystander, -jnp.inf),
            jnp.where(is_open, -jnp.inf, 0.0),
        ),
        log_alike=jnp.where(hang_together, log_gain[:, None], 0.0),
        is_open=is_open,
        earlier=earlier,
    )


def _log_bystanders(
    seen: Seen, is_kind: Array, grounding: Grounding, scene: Scene, *, params: MapParams
) -> tuple[Array, Array, Array]:
    """Weigh what has been seen as what is meant rather than as one of the bystanders.

    Args:
        seen: objects.
        is_kind: bool[2, O, ...], of the type of each end.
        grounding: what earlier relations have decided.
        scene: area, and how much of it is unseen.
        params: concentration, clumping.

    Returns:
        f32[2, O, ...], log 1/λ; f32[2, ...], log λ A with one of them meant, and with two.
    """
    ndim, num_pooled, is_counted = is_kind.ndim - 1, None, is_kind
    num_meant = jnp.zeros((), jnp.int32)
    if scene.num_pooled is not None:
        is_counted = jnp.broadcast_to((seen.object_type != NONE)[None], is_kind.shape)
        num_pooled = lead(scene.num_pooled, ndim)
        # What earlier relations have taken is no bystander of any type.
        num_meant = jnp.sum(grounding.slot != NONE, axis=0)[None]
    # Of those of its type that have been seen all but one are bystanders; of a pair all but two.
    number, unseen = jnp.sum(is_counted, axis=1), jnp.exp(lead(scene.log_unseen, ndim))
    if num_pooled is not None:
        number = number - num_meant
    log_one, log_two = (
        log_expected(jnp.maximum(number - but, 0), unseen, params=params, num_pooled=num_pooled)
        for but in (1, 2)
    )
    log_bystander = (lead(scene.log_area, ndim) - log_one)[:, None]
    if seen.existence is not None:
        real = jnp.where(is_counted, seen.existence[None], 0.0)
        others = jnp.sum(real, axis=1, keepdims=True) - real
        if num_pooled is not None:
            others, num_pooled = others - num_meant[:, None], num_pooled[:, None]
        others = jnp.maximum(others, 0.0)
        log_others = log_expected(others, unseen[:, None], params=params, num_pooled=num_pooled)
        log_bystander = lead(scene.log_area, is_kind.ndim) - log_others
        log_bystander = log_bystander + jnp.log(jnp.maximum(seen.existence, 1e-9))[None]
    return log_bystander, log_one, log_two


def _of_any_type(
    is_alike: Array,
    seen: Seen,
    log_area: Array,
    log_unseen: Array,
    num_pooled: Array | None,
    *,
    params: MapParams,
) -> Array:
    """Weigh what has been seen as a thing that a sentence calls by no type.

    Its type is one of the k that have been seen or one that has not, each as probable. So a thing
    of a type weighs 1 / (k + 1) of what it would as one called by that type.

    Args:
        is_alike: bool[O, O, ...], slots that hold things of one type, or nothing.
        seen: objects.
        log_area: f32[...], log A.
        log_unseen: f32[...], log u.
        num_pooled: see ``Scene``.
        params: concentration, clumping.

    Returns:
        f32[2 O, ...]: what each weighs, and how much more as one of two.
    """
    is_there = seen.object_type != NONE
    unseen = lead(jnp.exp(log_unseen), is_there.ndim)
    is_earlier = column(jnp.asarray(np.tri(is_there.shape[0], k=-1, dtype=bool)), is_alike.ndim)
    is_new_type = is_there & ~jnp.any(is_alike & is_earlier, axis=1)
    real = is_there.astype(jnp.float32) if seen.existence is None else seen.existence
    if num_pooled is not None:
        is_alike, num_pooled = is_there[None], lead(num_pooled, is_there.ndim)
    number = jnp.sum(jnp.where(is_alike, real[None], 0.0), axis=1)
    others = jnp.maximum(number - real, 0.0)
    expected = functools.partial(log_expected, unseen=unseen, params=params, num_pooled=num_pooled)
    log_one = expected(others)
    log_two = expected(jnp.maximum(others - 1.0, 0.0))
    log_share = -jnp.log1p(jnp.sum(is_new_type, axis=0).astype(jnp.float32))
    log_weight = lead(log_area, log_one.ndim) - log_one + log_share[None]
    if seen.existence is not None:
        log_weight = log_weight + jnp.log(jnp.maximum(seen.existence, 1e-9))
    return jnp.concatenate([log_weight, log_one - log_two])


def propose(said: Said, ends: Candidates, draws: Draws, model: RelationModel) -> Ways:
    """Pair what is known, and draw what is new: from the relation, and anywhere unseen.

    Args:
        said: the relation.
        ends: what its ends may be.
        draws: random numbers.
        model: prepared relations, for drawing.

    Returns:
        The places of all ways.
    """
    size = ends.x.shape[1]
    along, lateral, log_drawn = said.draw(draws.distance, draws.angle, model)
    at_x = _of_new(ends.x[LANDMARK], ends.x[FIGURE], draws.unseen_x, size)
    at_y = _of_new(ends.y[LANDMARK], ends.y[FIGURE], draws.unseen_y, size)

    def of_ends(values: Array) -> Array:
        # A landmark is drawn backwards from its figure, in a frame that is not its own: the weight
        # makes up for it.
        return _of_new(values[:1], -values[1:], values[:1], size)

    def instead(unseen: Array, told: Array) -> Array:
        # Of an order or a side, the figure of a new landmark takes the next place's draw.
        anywhere = _of_new(unseen[:1], unseen[1:2], unseen[::-1], size)
        return jnp.where(said.is_anywhere[None], anywhere, told)

    offset_x, offset_y, log_unit = said.offset(at_x, at_y, of_ends(along), of_ends(lateral))
    new_x = instead(draws.unseen_x, at_x + offset_x)
    new_y = instead(draws.unseen_y, at_y + offset_y)
    return Ways(
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
