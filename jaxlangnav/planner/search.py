"""Where looking is worth while: the belief folded into a *search map* (section 5; ours).

It has for each cell of the operating area the probability that a thing spoken of, and not seen yet,
lies there. ``tours`` plans the way that finds it soonest.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import ROBOT
from jaxlangnav.numerics.batching import materialize, skip_unless_any
from jaxlangnav.planner import prior
from jaxlangnav.planner.constraints import Forbidden
from jaxlangnav.planner.relevance import groups
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import Coverage, area_size, cell_size
from jaxlangnav.semantic_map.proposal.relation_query import Utterances, log_viewer_density
from jaxlangnav.terrain import OPEN, Eye, Terrain

CELLS = 12
"""Cells of the search map a side; must divide the cells of the coverage."""
LATTICE = 6
"""Viewpoints a side, for first drafts of tours."""
_TILT = 2e-3
"""Share by which cells count for more from end to end of the area: else rounding would choose
between a tour and its mirror image, otherwise in each compiled program."""
_OFF_CENTRE = 1e-3  # nats by which a part of a cell must be seen less than one nearer its centre


@pytree
class SearchMap:
    """Where looking is worth while; C = CELLS² cells."""

    x: Array  # f32[C] metres, map frame: what of each cell has been looked at least
    y: Array  # f32[C]
    unanchored: Array  # f32[C] probability that what hangs on nothing observed lies there
    anchored: Array  # f32[C] probability that what hangs on an observed object lies there
    partner_x: Array  # f32[C] metres: where the other one of a free pair then is; else as x
    partner_y: Array  # f32[C]
    unseen: Array  # f32[] probability that what is there as said would still be unseen
    terrain: Terrain = OPEN  # how far one sees and walks there
    forbidden: Forbidden | None = None  # what is to be kept away from
    nowhere: Array | np.float32 = np.float32(0.0)  # f32[] q, that it is nowhere (``termination``)
    missed: Array | np.float32 = np.float32(0.0)  # f32[] that a thing anywhere would be unseen
    elsewhere: Array | np.float32 = np.float32(0.0)  # f32[C] where it then is; sums to one

    @property
    def mass(self) -> Array:
        """Probability that an object not yet seen, but spoken of, lies in each cell, f32[C]."""
        return self.unanchored + self.anchored

    def doubted(self, share: Array | float, least: Array | float) -> "SearchMap":
        """Put what is not as is said anywhere that has not been looked at.

        Args:
            share: f32[] of the mass that lies there.
            least: f32[], the mass there is at least, where few particles show none.
        """
        total, kept = jnp.sum(self.mass), 1.0 - share
        moved = jnp.maximum(share * total, least - kept * total)
        anchored = kept * self.anchored + jnp.multiply(moved, self.elsewhere)
        return replace(self, unanchored=kept * self.unanchored, anchored=anchored)


def grid(area: Array, number: int) -> tuple[Array, Array]:
    """Place points at the centres of number × number equal parts of an area f32[4].

    f32[number²] x and y, metres, map frame.
    """
    steps = (jnp.arange(number) + 0.5) / number
    x = area[0] + steps * (area[1] - area[0])
    y = area[2] + steps * (area[3] - area[2])
    return jnp.tile(x, number), jnp.repeat(y, number)


def _partner_scale(belief: ParticleBelief, is_free: Array, x: Array, y: Array) -> Array:
    """Tell where the second one of an unseen pair is: f32[C], as a factor along the line of sight.

    It is the mean difference of their ranges from the viewer, over the particles in which both hang
    on nothing observed.
    """
    viewer_x, viewer_y = belief.viewer[0], belief.viewer[1]
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    off_x, off_y = particles.hypothesis_x - viewer_x, particles.hypothesis_y - viewer_y
    away = jnp.sqrt(off_x**2 + off_y**2 + 1e-9)  # [M, P]
    is_pair = jnp.sum(is_free, axis=0) == 2
    sign = jnp.where(is_free, jnp.where(jnp.cumsum(is_free, axis=0) == 1, 1.0, -1.0), 0.0)
    gap = jnp.sum(jnp.where(is_pair, weight, 0.0) * jnp.sum(sign * away, axis=0))
    free = jnp.sum(jnp.where(jnp.any(is_free, axis=0), weight, 0.0))
    nearer = jnp.abs(gap) / jnp.maximum(free, 1e-6)
    return 1.0 - nearer / jnp.sqrt((x - viewer_x) ** 2 + (y - viewer_y) ** 2 + 1e-9)


def _unseen(coverage: Coverage, anchored: Array, density: Array) -> Array:
    """Compute the probability, f32[], that what is there would have escaped every look."""
    # Anywhere in the area, as the order of search weighs it; or, if that is more, at the places on
    # observed objects where it is said to be, for they are little of the whole area.
    # Of its own, so that the search map is computed to the bit as it would be without.
    coverage, anchored, density = materialize((coverage, anchored, density))
    size = coverage.log_miss.shape[0] // CELLS
    cells = jnp.exp(coverage.log_miss).reshape(CELLS, size, CELLS, size)
    missed = cells.mean(axis=(1, 3)).reshape(-1)
    anywhere = jnp.sum(missed * density) / jnp.maximum(jnp.sum(density), 1e-9)
    return jnp.minimum(jnp.maximum(anywhere, jnp.sum(anchored * missed)), 1.0)


def _least_looked_at(coverage: Coverage, x: Array, y: Array) -> tuple[Array, Array]:
    """Find in each cell of the search map what of it has been looked at least, f32[C] x and y."""
    # In view of its centre much of a cell may be out of view, and a tour that has all centres in
    # view would never go there. Of a cell nobody has looked at, or all of it alike, it is what is
    # nearest its centre.
    size = coverage.log_miss.shape[0] // CELLS
    parts = coverage.log_miss.reshape(CELLS, size, CELLS, size)
    parts = parts.transpose(0, 2, 1, 3).reshape(CELLS**2, size * size)
    steps = np.arange(size, dtype=np.float32) - 0.5 * (size - 1)
    along, across = np.tile(steps, size), np.repeat(steps, size)
    off_centre = _OFF_CENTRE * (along**2 + across**2)
    worst = jnp.argmax(parts - off_centre[None], axis=1)
    width, depth = cell_size(coverage)
    return x + width * jnp.asarray(along)[worst], y + depth * jnp.asarray(across)[worst]


def _by_words(
    belief: ParticleBelief, is_free: Array, x: Array, y: Array, density: Array, spoken: Utterances
) -> Array:
    """Weigh the cells, f32[C] > 0, by what the words have of what hangs on nothing observed."""
    readings, mentions = spoken.readings, np.arange(spoken.readings.mention_type.shape[1])
    log_area = jnp.log(area_size(belief.coverage))

    def raised(places: tuple[Array, Array]) -> Array:
        log_told = log_viewer_density(spoken, log_area, *places)
        is_tied = (groups(readings)[:, None] >> mentions[None, :, None]) & 1  # [M, M, K]
        log_told = jnp.sum(jnp.where(is_tied[None] > 0, log_told[:, None], 0.0), axis=2)
        told = jnp.exp(log_told - jnp.max(log_told, axis=0, keepdims=True))  # [C, M, K]
        told = told / jnp.maximum(jnp.tensordot(density, told, axes=1), 1e-9)[None]
        # A figure and landmark that are both unseen come into view together: they count once.
        share = jnp.exp(belief.log_weight) / jnp.maximum(jnp.sum(is_free, axis=0), 1)
        is_read = belief.particles.reading[:, None] == np.arange(told.shape[2])[None]
        share = jnp.where(is_free, share[None], 0.0) @ is_read.astype(jnp.float32)  # [M, K]
        share = share / jnp.maximum(jnp.sum(share), 1e-9)
        return jnp.sum(density) * jnp.sum(told * share[None], axis=(1, 2)) - 1.0

    is_by_robot = jnp.any(readings.mention_type == ROBOT) & jnp.any(is_free)
    return 1.0 + skip_unless_any(is_by_robot, raised, (x, y))


def search_map(
    belief: ParticleBelief, prior_share: Array, ahead: Array, spoken: Utterances | None = None
) -> SearchMap:
    """Fold the belief into a map of where to look.

    Hypotheses that hang on an observed object count where they are. Those that hang on nothing
    observed are spread by the coverage, by what training worlds have taught (``prior``) and by
    what the words say of them and the robot, rather than by the few particles that sample it. The
    mass of the map sums to the expected number of things still to be found.

    Args:
        belief: weighted particles and coverage.
        prior_share: f32[] in [0, 1], how far the learned prior is trusted; 0 leaves it out.
        ahead: f32[], κ, how far things are taken to lie ahead of the viewer; 0: all round alike.
        spoken: what has been said; None: nothing that places a thing against the robot.
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    area = belief.coverage.area
    x, y = grid(area, CELLS)
    is_open = particles.is_hypothesised  # [M, P]
    is_free = is_open & (particles.root < 0)
    # A figure and landmark that are both unseen come into view together: they count once.
    share = jnp.sum(jnp.where(jnp.any(is_free, axis=0), weight, 0.0))
    miss = jnp.exp(belief.coverage.log_miss)
    size = miss.shape[0] // CELLS
    unseen = miss.reshape(CELLS, size, CELLS, size).sum(axis=(1, 3)).reshape(-1)
    likelier = prior.relative_density(belief.coverage, belief.viewer, x, y, prior_share, ahead)
    unseen = anywhere = unseen * likelier
    if spoken is not None:
        by_words = _by_words(belief, is_free, x, y, unseen, spoken)
        likelier, unseen = likelier * by_words, unseen * by_words
    unseen = unseen * (1.0 + _TILT * jnp.linspace(-0.5, 0.5, CELLS**2))
    column = jnp.floor((particles.hypothesis_x - area[0]) / (area[1] - area[0]) * CELLS)
    row = jnp.floor((particles.hypothesis_y - area[2]) / (area[3] - area[2]) * CELLS)
    is_in = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    cell = jnp.where(is_in, row * CELLS + column, 0.0).astype(jnp.int32)
    anchored = jnp.where(is_open & ~is_free & is_in, weight[None, :], 0.0)
    anchored_at = jnp.zeros(CELLS**2, jnp.float32).at[cell.reshape(-1)].add(anchored.reshape(-1))
    x, y = _least_looked_at(belief.coverage, x, y)
    scale = _partner_scale(belief, is_free, x, y)
    return SearchMap(
        x=x,
        y=y,
        unanchored=share * unseen / jnp.maximum(jnp.sum(unseen), 1e-9),
        anchored=anchored_at,
        partner_x=belief.viewer[0] + scale * (x - belief.viewer[0]),
        partner_y=belief.viewer[1] + scale * (y - belief.viewer[1]),
        elsewhere=anywhere / jnp.maximum(jnp.sum(anywhere), 1e-9),
        unseen=_unseen(belief.coverage, anchored_at, likelier),
        missed=jnp.mean(miss),
        terrain=belief.terrain,
    )


def visibility(
    view_x: Array, view_y: Array, search: SearchMap, range_max: Array, area: Array
) -> Array:
    """Compute which share of each cell comes into view at each viewpoint, f32[A, C]."""
    softness = 0.5 * (area[1] - area[0] + area[3] - area[2]) / CELLS
    eye = Eye(view_x[:, None], view_y[:, None], range_max)
    return search.terrain.view.share(eye, search.x[None, :], search.y[None, :], softness)
