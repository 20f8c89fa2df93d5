"""What mentions refer to, entered relation by relation (section 3.2, eq. 7a).

``proposal`` draws a grounding of each relation; here it is taken apart and carried to the next.

Everything takes one particle, or all of them with the particle axis last ("..." in shapes).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.numerics.axes import column, pick
from jaxlangnav.numerics.once import once
from jaxlangnav.semantic_map.options import NUM_UNSEEN, Candidates, Link, Ways


class Grounding(NamedTuple):
    """Carry over the relations of a reading: what the mentions refer to so far."""

    slot: Array  # i32[M, ...] observed slot; NONE while hypothesised
    x: Array  # f32[M, ...] metres
    y: Array  # f32[M, ...]
    anchor: Array  # i32[M, ...] slot in [0, N) or NONE
    root: Array  # i32[M, ...] observed slot or NONE
    is_grounded: Array  # bool[M, ...]
    log_weight: Array  # f32[...]


class _Chosen(NamedTuple):
    """The grounding that was drawn, taken apart."""

    is_free: Array  # bool[...] the relation says nothing: what is new may be anywhere
    is_figure: Array  # bool[...] the figure alone is new
    is_landmark: Array  # bool[...] the landmark alone is new
    is_pair: Array  # bool[...] both are new
    figure: Array  # i32[...] which candidate; of a new figure: which landmark it was drawn for
    landmark: Array  # i32[...] which candidate; of a new landmark: which figure
    pair: Array  # i32[...] which of the new pairs

    def place(
        self, known: Array, hung: Array, paired: Array, free: Array, index: Array, is_hung: Array
    ) -> Array:
        """Take an end's coordinate, f32[...], from what was known, or as it was drawn."""
        drawn = jnp.where(self.is_pair, pick(paired, self.pair), pick(hung, index))
        drawn = jnp.where(self.is_free, free[0], drawn)
        return once(jnp.where(is_hung | self.is_pair, drawn, pick(known, index)))


def _take_apart(choice: Array, size: int) -> _Chosen:
    """Tell what an index into all groundings, i32[...], stands for; ``size`` candidates an end."""
    num_told = size * size + 2 * size + NUM_UNSEEN
    is_free = choice >= num_told
    rest = choice - jnp.where(is_free, num_told, size * size)
    is_known, is_figure = rest < 0, (rest >= 0) & (rest < size)
    other = jnp.where(is_figure, rest, rest - size)
    return _Chosen(
        is_free=is_free,
        is_figure=is_figure,
        is_landmark=(rest >= size) & (rest < 2 * size),
        is_pair=rest >= 2 * size,
        figure=jnp.where(is_known, choice // size, other),
        landmark=jnp.where(is_known, choice % size, other),
        pair=rest - 2 * size,
    )


class _End(NamedTuple):
    """One end of a relation: what it was, and what it refers to now; leaves [...]."""

    mention: Array  # i32 NONE where there is no such end
    is_open: Array  # bool nothing was decided before
    slot: Array  # i32 observed slot; NONE where it is new
    root: Array  # i32 observed slot at which its chain finishes; NONE for the ground

    def hang(self, is_hung: Array, num_objects: int) -> tuple[Array, Array]:
        """Build anchor and root, i32[...], of the other end, where that hangs on this one."""
        own_place = jnp.where(self.slot == NONE, num_objects + self.mention, self.slot)
        return jnp.where(is_hung, own_place, NONE), jnp.where(is_hung, self.root, NONE)


def _end(
    grounding: Grounding, mention: Array, ends: Candidates, index: Array, is_new: Array
) -> _End:
    """Look up what an end refers to: the chosen candidate, or what was decided earlier."""
    chosen = jnp.where(is_new | (index == ends.x.shape[0] - 1), NONE, index)
    earlier = jnp.where(mention == NONE, NONE, pick(grounding.slot, mention))
    slot = jnp.where(ends.is_open, chosen, earlier)
    inherited = jnp.where(ends.is_open, NONE, pick(grounding.root, mention))
    return _End(
        mention=mention,
        is_open=ends.is_open,
        slot=slot,
        root=jnp.where(slot == NONE, inherited, slot),
    )


def enter(
    grounding: Grounding,
    link: Link,
    figures: Candidates,
    landmarks: Candidates,
    ways: Ways,
    choice: Array,
) -> Grounding:
    """Enter the chosen figure and landmark of a relation; ends decided earlier stay.

    Args:
        grounding: what earlier relations have decided.
        link: the relation.
        figures: O + 1 candidates.
        landmarks: O + 1 candidates.
        ways: to ground the relation.
        choice: i32[...], which of them, counted through as ``options.weigh`` lists them.

    Returns:
        What is decided now; its weight as it was.
    """
    size = figures.x.shape[0]
    new_figure, new_landmark, new_pair = ways.new_figure, ways.new_landmark, ways.new_pair
    free = ways.free
    one = _take_apart(choice, size)
    figure = _end(grounding, link.figure, figures, one.figure, one.is_figure | one.is_pair)
    landmark = _end(
        grounding, link.landmark, landmarks, one.landmark, one.is_landmark | one.is_pair
    )
    # A figure hangs on its landmark; a landmark hangs on its figure only if it was drawn for it.
    is_object = (link.landmark != NONE) & ~link.is_robot
    figure_anchor, figure_root = landmark.hang(is_object & ~one.is_free, size - 1)
    landmark_anchor, landmark_root = figure.hang(one.is_landmark & ~one.is_free, size - 1)

    mentions = column(jnp.arange(grounding.slot.shape[0]), grounding.slot.ndim)
    set_figure = (mentions == figure.mention[None]) & figure.is_open[None]
    set_landmark = (mentions == landmark.mention[None]) & (landmark.is_open & is_object)[None]

    def put(old: Array, for_figure: Array, for_landmark: Array) -> Array:
        kept = jnp.where(set_landmark, for_landmark[None], old)
        return jnp.where(set_figure, for_figure[None], kept)

    return Grounding(
        slot=put(grounding.slot, figure.slot, landmark.slot),
        x=put(
            grounding.x,
            one.place(figures.x, new_figure.x, new_pair.x, free.x, one.figure, one.is_figure),
            one.place(
                landmarks.x, new_landmark.landmark_x, new_pair.landmark_x, free.landmark_x,
                one.landmark, one.is_landmark,
            ),
        ),
        y=put(
            grounding.y,
            one.place(figures.y, new_figure.y, new_pair.y, free.y, one.figure, one.is_figure),
            one.place(
                landmarks.y, new_landmark.landmark_y, new_pair.landmark_y, free.landmark_y,
                one.landmark, one.is_landmark,
            ),
        ),
        anchor=put(grounding.anchor, figure_anchor, landmark_anchor),
        root=put(grounding.root, figure_root, landmark_root),
        is_grounded=grounding.is_grounded | set_figure | set_landmark,
        log_weight=grounding.log_weight,
    )  # fmt: skip
