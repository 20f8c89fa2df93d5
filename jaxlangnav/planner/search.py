"""The search map: probability of unseen mentioned objects by cell (section 5; ours).

For each cell of the operating area it has the probability that a mentioned, not yet observed
object lies there. ``tours`` plans the path that finds it soonest.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.numerics.batching import materialize, skip_unless_any
from jaxlangnav.planner import prior
from jaxlangnav.planner.constraints import Zones
from jaxlangnav.planner.relevance import components
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import Coverage, cell_size, log_miss_at
from jaxlangnav.semantic_map.proposal.ranks import log_viewer_density
from jaxlangnav.semantic_map.proposal.relation_query import Utterances
from jaxlangnav.terrain import OPEN, Eye, Terrain

CELLS = 12
"""Cells of the search map per side; must divide those of the coverage map."""
LATTICE = 6
"""Number of viewpoints per side of the lattice for greedy tours."""
_TIE_BREAK = 2e-3
"""Relative gradient of the cell weights across the area, to break ties: else rounding would choose
between a tour and its mirror image, differently in each compiled program."""
_GAP_SPREAD = np.array([0.6, 1.0, 1.4], np.float32)  # of the gap of a pair, about its mean
_OFF_CENTRE = 1e-3  # nats, penalty of subcells per squared offset from the centre of their cell


@pytree
class SearchMap:
    """Search map over C = CELLS² cells."""

    x: Array  # f32[C] metres, map frame: the least observed point of each cell
    y: Array  # f32[C]
    unanchored: Array  # f32[C] probability that an unanchored target lies there
    anchored: Array  # f32[C] probability that a target anchored to an observed object lies there
    partner_x: Array  # f32[C] metres: position of the landmark in an unanchored pair; else x
    partner_y: Array  # f32[C]
    unseen: Array  # f32[] u, miss probability of a target placed as described
    terrain: Terrain = OPEN  # lines of sight and travel distances
    forbidden: Zones | None = None  # keep-out zones
    prob_absent: Array | np.float32 = np.float32(0.0)  # f32[] q, no such object (``termination``)
    mean_miss: Array | np.float32 = np.float32(0.0)  # f32[] v, mean miss probability over the area
    relocation_density: Array | np.float32 = np.float32(0.0)  # f32[C] relocation density
    ordered: Array | np.float32 = np.float32(0.0)  # f32[] of what comes before one of a rank

    @property
    def mass(self) -> Array:
        """Probability that a mentioned, unobserved object lies in each cell, f32[C]."""
        return self.unanchored + self.anchored

    def relocated(self, frac: Array | float, min_moved: Array | float) -> "SearchMap":
        """Move mass to the whole unexplored area, for targets that are not where described.

        Args:
            frac: f32[], fraction of the mass that is moved.
            min_moved: f32[], lower bound of the moved mass, as few particles may have none.
        """
        total, rest = jnp.sum(self.mass), 1.0 - frac
        moved = jnp.maximum(frac * total, min_moved - rest * total)
        anchored = rest * self.anchored + jnp.multiply(moved, self.relocation_density)
        return replace(self, unanchored=rest * self.unanchored, anchored=anchored)


def grid(area: Array, side: int) -> tuple[Array, Array]:
    """Compute the centres of side × side equal cells of an area f32[4].

    f32[side²] x and y, metres, map frame.
    """
    fracs = (jnp.arange(side) + 0.5) / side
    x = area[0] + fracs * (area[1] - area[0])
    y = area[2] + fracs * (area[3] - area[2])
    return jnp.tile(x, side), jnp.repeat(y, side)


def _range_gap(belief: ParticleBelief, is_free: Array, readings: Readings) -> tuple[Array, Array]:
    """Estimate how much farther from the viewer the figure of an unseen pair is than its landmark.

    f32[] metres, the mean over particles with anything free; f32[], the fraction with a pair.
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    offset = particles.hypothesis_x - belief.viewer[0], particles.hypothesis_y - belief.viewer[1]
    distance = jnp.where(is_free, jnp.hypot(*offset), 0.0)  # [M, P]
    landmark_type = jnp.take_along_axis(readings.mention_type, readings.landmark, axis=1)
    is_edge = (readings.relation != NONE) & (landmark_type != ROBOT)  # [K, J]
    figure, landmark = jax.nn.one_hot(jnp.stack([readings.figure, readings.landmark]), len(is_free))
    sign = jnp.sign(jnp.sum((figure - landmark) * is_edge[..., None], axis=1))  # [K, M]
    gap = jnp.sum(distance * sign[particles.reading].T, axis=0)
    pairs = jnp.where(jnp.sum(is_free, axis=0) == 2, weight, 0.0)
    prob = jnp.maximum(jnp.sum(jnp.where(jnp.any(is_free, axis=0), weight, 0.0)), 1e-6)
    return jnp.sum(pairs * gap) / prob, jnp.sum(pairs) / prob


def _towards_viewer(x: Array, y: Array, gap: Array, viewer: Array) -> tuple[Array, Array]:
    """Move positions towards the viewer by ``gap`` metres."""
    frac = gap / jnp.sqrt((x - viewer[0]) ** 2 + (y - viewer[1]) ** 2 + 1e-9)
    return x - frac * (x - viewer[0]), y - frac * (y - viewer[1])


def _unseen_prob(coverage: Coverage, anchored: Array, density: Array) -> Array:
    """Compute the probability, f32[], that a target would have been missed by all observations."""
    # The mean over the area, weighted by the search density; or, if larger, over the positions
    # anchored to observed objects, which are a small part of the area.
    # Materialized, so that the search map stays bitwise the same as without it.
    coverage, anchored, density = materialize((coverage, anchored, density))
    block = coverage.log_miss.shape[0] // CELLS
    miss = jnp.exp(coverage.log_miss).reshape(CELLS, block, CELLS, block)
    miss_prob = miss.mean(axis=(1, 3)).reshape(-1)
    mean_miss = jnp.sum(miss_prob * density) / jnp.maximum(jnp.sum(density), 1e-9)
    return jnp.minimum(jnp.maximum(mean_miss, jnp.sum(anchored * miss_prob)), 1.0)


def _least_observed(coverage: Coverage, x: Array, y: Array) -> tuple[Array, Array]:
    """Find the least observed point of each cell of the search map, f32[C] x and y."""
    # When its centre is in view much of a cell may be out of view, and a tour that views all
    # centres would never go there. In a cell that is unobserved, or uniformly observed, it is the
    # point nearest the centre.
    block = coverage.log_miss.shape[0] // CELLS
    subcells = coverage.log_miss.reshape(CELLS, block, CELLS, block)
    subcells = subcells.transpose(0, 2, 1, 3).reshape(CELLS**2, block * block)
    offsets = np.arange(block, dtype=np.float32) - 0.5 * (block - 1)
    dx, dy = np.tile(offsets, block), np.repeat(offsets, block)
    penalty = _OFF_CENTRE * (dx**2 + dy**2)
    best = jnp.argmax(subcells - penalty[None], axis=1)
    cell_width, cell_height = cell_size(coverage)
    return x + cell_width * jnp.asarray(dx)[best], y + cell_height * jnp.asarray(dy)[best]


def _viewer_factor(
    belief: ParticleBelief, is_free: Array, x: Array, y: Array, mass: Array, utterances: Utterances
) -> Array:
    """Compute the factor of relations to the robot on the cells' unanchored mass, f32[C] > 0."""
    readings, mentions = utterances.readings, np.arange(utterances.readings.mention_type.shape[1])

    def factor(positions: tuple[Array, Array]) -> Array:
        log_density = log_viewer_density(utterances, belief, *positions)
        is_grouped = (components(readings)[:, None] >> mentions[None, :, None]) & 1  # [M, M, K]
        log_density = jnp.sum(jnp.where(is_grouped[None] > 0, log_density[:, None], 0.0), axis=2)
        density = jnp.exp(log_density - jnp.max(log_density, axis=0, keepdims=True))  # [C, M, K]
        density = density / jnp.maximum(jnp.tensordot(mass, density, axes=1), 1e-9)[None]
        # A figure and landmark that are both unseen come into view together: they count once.
        prob = jnp.exp(belief.log_weight) / jnp.maximum(jnp.sum(is_free, axis=0), 1)
        is_read = belief.particles.reading[:, None] == np.arange(density.shape[2])[None]
        prob = jnp.where(is_free, prob[None], 0.0) @ is_read.astype(jnp.float32)  # [M, K]
        prob = prob / jnp.maximum(jnp.sum(prob), 1e-9)
        return jnp.sum(mass) * jnp.sum(density * prob[None], axis=(1, 2))

    is_by_robot = jnp.any(readings.mention_type == ROBOT) & jnp.any(is_free)
    return skip_unless_any(is_by_robot, factor, (x, y), jnp.ones_like(x))


def search_map(
    belief: ParticleBelief, prior_share: Array, ahead: Array, utterances: Utterances | None = None
) -> SearchMap:
    """Compute the search map of a belief.

    Hypotheses anchored to an observed object count at their position. Unanchored ones are
    distributed by the coverage map (of a pair neither has been seen), the prior learned from
    training worlds (``prior``) and their relations to the robot, rather than by the few particles
    that sample them. The mass of the map sums to the expected number of objects still to be found.

    Args:
        belief: weighted particles and coverage map.
        prior_share: f32[] in [0, 1], weight of the learned prior; 0 leaves it out.
        ahead: f32[], κ of the prior that objects lie ahead of the viewer; 0: uniform direction.
        utterances: utterances; None: none that relates an object to another or the robot.
    """
    particles, weight, area = belief.particles, jnp.exp(belief.log_weight), belief.coverage.area
    x, y = grid(area, CELLS)
    is_open = particles.is_hypothesised  # [M, P]
    is_free = is_open & (particles.root < 0)
    # A figure and landmark that are both unseen come into view together: they count once.
    unanchored_prob = jnp.sum(jnp.where(jnp.any(is_free, axis=0), weight, 0.0))
    miss = jnp.exp(belief.coverage.log_miss)
    block = miss.shape[0] // CELLS
    unseen = miss.reshape(CELLS, block, CELLS, block).sum(axis=(1, 3)).reshape(-1)
    ordered, gap, prob_pair = np.float32(0.0), jnp.float32(0.0), jnp.float32(0.0)
    if utterances is not None:
        gap, prob_pair = _range_gap(belief, is_free, utterances.readings)
    weights = prior_share, ahead, prob_pair
    factor = prior.relative_density(belief.coverage, belief.viewer, x, y, *weights)
    unseen = uniform_unseen = unseen * factor
    if utterances is not None:
        readings, mentions = utterances.readings, np.arange(is_open.shape[0])[None, None]
        is_figure = (readings.figure[:, :, None] == mentions) & readings.is_ordinal[:, :, None]
        is_ranked = jnp.any(is_figure, axis=1)[particles.reading].T  # [M, P]
        ordered = jnp.sum(jnp.where(jnp.any(is_open & is_ranked, axis=0), weight, 0.0))
        viewer_factor = _viewer_factor(belief, is_free, x, y, unseen, utterances)
        factor, unseen = factor * viewer_factor, unseen * viewer_factor
        partner = _towards_viewer(x[None], y[None], gap * _GAP_SPREAD[:, None], belief.viewer)
        partner_miss = jnp.mean(jnp.exp(log_miss_at(belief.coverage, *partner)), axis=0)
        unseen *= 1.0 - prob_pair * (1.0 - utterances.params.misleading) * (1.0 - partner_miss)
    unseen = unseen * (1.0 + _TIE_BREAK * jnp.linspace(-0.5, 0.5, CELLS**2))
    anchored = jnp.where(is_open & ~is_free, weight[None], 0.0).reshape(-1)
    positions = particles.hypothesis_x.reshape(-1), particles.hypothesis_y.reshape(-1)
    anchored = jnp.histogram2d(*positions, CELLS, [area[:2], area[2:]], anchored)[0].T.reshape(-1)
    x, y = _least_observed(belief.coverage, x, y)
    partner_x, partner_y = _towards_viewer(x, y, gap, belief.viewer)
    return SearchMap(
        x=x,
        y=y,
        unanchored=unanchored_prob * unseen / jnp.maximum(jnp.sum(unseen), 1e-9),
        anchored=anchored,
        partner_x=partner_x,
        partner_y=partner_y,
        relocation_density=uniform_unseen / jnp.maximum(jnp.sum(uniform_unseen), 1e-9),
        ordered=ordered,
        unseen=_unseen_prob(belief.coverage, anchored, factor),
        mean_miss=jnp.mean(miss),
        terrain=belief.terrain,
    )


def visibility(x: Array, y: Array, search: SearchMap, range_max: Array, area: Array) -> Array:
    """Compute the fraction of each cell that is in view from each viewpoint, f32[A, C]."""
    softness = 0.5 * (area[1] - area[0] + area[3] - area[2]) / CELLS
    eye = Eye(x[:, None], y[:, None], range_max)
    return search.terrain.view.share(eye, search.x[None, :], search.y[None, :], softness)
