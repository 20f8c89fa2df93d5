"""Looking for what has not been seen: short greedy tours over a map of probability.

The paper leaves exploration to chance and names information gathering as future work (section 5).
Here the belief is folded into a *search map*: for each cell the probability that looking there
tells the hypotheses apart. Candidate viewpoints form a lattice over the operating area. The most
promising first viewpoints are each continued by a greedy tour, and the one whose tour finds
things soonest is taken:

    L(a) = Σ_k g_k t_k + r (t_K + B_r / 4R)

g_k is the mass that comes into view at stop k after t_k metres, r what is left after K stops and
B_r the area it is spread over, so that the last term is about half of a sweep of the rest.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.information import squared_distance_to_segment
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.coverage import area_size
from jaxlangnav.semantic_map.filter import ParticleBelief

CELLS = 12
"""Cells of the search map a side; must divide the cells of the coverage."""
LATTICE = 6
"""Viewpoints a side."""
NUM_TOURS = 3
"""First viewpoints that are continued by a tour."""
TOUR_LENGTH = 5
"""Stops of a tour after the first."""


@pytree
class SearchMap:
    """Where looking is worth while; C = CELLS² cells."""

    x: Array  # f32[C] metres, map frame, cell centres
    y: Array  # f32[C]
    mass: Array  # f32[C] probability that an object not yet seen, but spoken of, lies there


def _grid(area: Array, number: int) -> tuple[Array, Array]:
    """Place number × number points at the centres of equal parts of the area."""
    steps = (jnp.arange(number) + 0.5) / number
    x = area[0] + steps * (area[1] - area[0])
    y = area[2] + steps * (area[3] - area[2])
    return jnp.tile(x, number), jnp.repeat(y, number)


def viewpoints(area: Array) -> tuple[Array, Array]:
    """Build the lattice of viewpoints, f32[LATTICE²] x and y, metres, map frame."""
    return _grid(area, LATTICE)


def search_map(belief: ParticleBelief) -> SearchMap:
    """Fold the belief into a map of where to look.

    Hypotheses that hang on nothing observed are uniform over what is unexplored, so their share
    is spread by the coverage itself rather than by the few particles that sample it; hypotheses
    that hang on an observed object count where they are.

    Args:
        belief: weighted particles and coverage.

    Returns:
        The map; its mass sums to the expected number of things still to be found.
    """
    particles, weight = belief.particles, jnp.exp(belief.log_weight)
    area = belief.coverage.area
    x, y = _grid(area, CELLS)
    is_open = particles.is_hypothesised  # [M, P]
    is_free = is_open & (particles.root < 0)
    # A figure and landmark that are both unseen come into view together: they count once.
    free = jnp.sum(jnp.where(jnp.any(is_free, axis=0), weight, 0.0))
    miss = jnp.exp(belief.coverage.log_miss)
    size = miss.shape[0] // CELLS
    unseen = miss.reshape(CELLS, size, CELLS, size).sum(axis=(1, 3)).reshape(-1)
    mass = free * unseen / jnp.maximum(jnp.sum(unseen), 1e-9)
    column = jnp.floor((particles.hypothesis_x - area[0]) / (area[1] - area[0]) * CELLS)
    row = jnp.floor((particles.hypothesis_y - area[2]) / (area[3] - area[2]) * CELLS)
    is_in = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
    cell = jnp.where(is_in, row * CELLS + column, 0.0).astype(jnp.int32)
    hung = jnp.where(is_open & ~is_free & is_in, weight[None, :], 0.0)
    return SearchMap(x=x, y=y, mass=mass.at[cell.reshape(-1)].add(hung.reshape(-1)))


def visibility(
    view_x: Array, view_y: Array, search: SearchMap, range_max: Array, area: Array
) -> Array:
    """Compute which share of each cell comes into view at each viewpoint, f32[A, C]."""
    softness = 0.5 * (area[1] - area[0] + area[3] - area[2]) / CELLS
    offset_x = view_x[:, None] - search.x[None, :]
    offset_y = view_y[:, None] - search.y[None, :]
    squared = offset_x * offset_x + offset_y * offset_y
    return jnp.clip((range_max - jnp.sqrt(squared + 1e-9)) / softness + 0.5, 0.0, 1.0)


def latency(
    belief: ParticleBelief,
    search: SearchMap,
    robot_x: Array,
    robot_y: Array,
    range_max: Array,
    offset: Array,
) -> tuple[Array, Array, Array]:
    """Judge each viewpoint by what its way reveals and by the tour that may follow.

    Args:
        belief: for the operating area.
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        range_max: f32[], sensing range, metres.
        offset: f32[], metres added to a way before dividing what it reveals by it.

    Returns:
        f32[LATTICE²] mass revealed on the way to each viewpoint; f32[LATTICE²] the same per
        metre; f32[LATTICE²] expected metres until found, +∞ where no tour was tried.
    """
    area = belief.coverage.area
    view_x, view_y = viewpoints(area)
    softness = 0.5 * (area[1] - area[0] + area[3] - area[2]) / CELLS
    way = jnp.sqrt(
        squared_distance_to_segment(
            search.x[None, :], search.y[None, :], robot_x, robot_y,
            view_x[:, None], view_y[:, None],
        )
        + 1e-9
    )  # fmt: skip
    on_way = jnp.clip((range_max - way) / softness + 0.5, 0.0, 1.0)
    revealed = jnp.sum(on_way * search.mass[None, :], axis=1)
    distance = jnp.sqrt((view_x - robot_x) ** 2 + (view_y - robot_y) ** 2 + 1e-9)
    rate = revealed / (distance + offset)
    _, first = jax.lax.top_k(rate, NUM_TOURS)
    sees = visibility(view_x, view_y, search, range_max, area)
    between = jnp.sqrt(
        (view_x[:, None] - view_x[None, :]) ** 2 + (view_y[:, None] - view_y[None, :]) ** 2 + 1e-9
    )
    mass = search.mass[None, :] * (1.0 - on_way[first])  # [F, C]
    here, walked = first, distance[first]
    total = revealed[first] * walked
    for _ in range(TOUR_LENGTH):
        gain = mass @ sees.T  # [F, A]
        step = between[here]
        best = jnp.argmax(gain / (step + offset), axis=1)
        walked = walked + jnp.take_along_axis(step, best[:, None], axis=1)[:, 0]
        total = total + jnp.take_along_axis(gain, best[:, None], axis=1)[:, 0] * walked
        mass = mass * (1.0 - sees[best])
        here = best
    left = jnp.sum(mass, axis=1)
    spread = jnp.sum(mass > 0.1 / search.mass.shape[0] * jnp.sum(search.mass), axis=1)
    spread = spread / search.mass.shape[0] * area_size(belief.coverage)
    total = total + left * (walked + spread / (4.0 * range_max))
    expected = jnp.full(view_x.shape[0], jnp.inf, jnp.float32).at[first].set(total)
    return revealed, rate, expected
