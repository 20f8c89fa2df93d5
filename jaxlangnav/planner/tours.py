"""The way that finds things soonest: tours improved step by step (section 3.4; ours).

A tour is a line of K stops. Its *latency* is the expected length of the way until what is looked
for comes into view:

    L = Σ_c m_c t_c + Σ_{c missed} m_c (T + |c − q_K| + B / 4R)

m_c is the mass of cell c, t_c the length of the way at which the line of stops first comes within
sensing range of it (of a free pair: of either), T the whole length, q_K the last stop and B the
area that the tour has missed, so that B / 4R is about half of a sweep of it (R sin h of a view of
half-angle h below a right angle, which shows less abreast).

What is looked for may be nowhere, with probability q (``endings``): then all of the area is looked
at before that is known, in whatever order, and the way until then is what counts:

    L' = (1 − q) L + q M (T + mean_{c missed} |c − q_K| + B / 2R + G),   M = Σ_c m_c

In a *thorough* search, which may have to look at all of the area, G is the way between the patches
that the tour would leave (0 otherwise), and sweeps in lanes (``sweeps``) are drafted too.

Each decision starts from the tour under way and from greedy tours over a lattice of viewpoints, and
improves the best of them by a few rounds of random changes: move a stop, put one in, take one out,
turn a stretch round. The tour is kept from step to step, so the search goes on while the robot is
on its way; and as the tour under way is among the candidates, it is left only for a shorter one: of
a thorough search for a much shorter one, as what seems so on a grid of cells leaves corners behind.
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics import batching
from jaxlangnav.numerics.batching import once
from jaxlangnav.planner.search import SearchMap, viewpoints, visibility
from jaxlangnav.planner.sweeps import NUM_SWEEPS, between_patches, eyesight, is_worth_a_look, sweeps
from jaxlangnav.pytree import pytree
from jaxlangnav.terrain import OPEN, Terrain
from jaxlangnav.terrain.view import NEVER, Stretch

NUM_STOPS = 6
"""K, stops of a tour."""
NUM_GREEDY = 3
"""Greedy tours drafted at each decision."""
NUM_CHANGES = 8
"""Changes tried in a round."""
NUM_ROUNDS = 3
"""Rounds of changes at each decision."""
_ARRIVAL = 0.5
"""Metres from a stop that count as having been there."""
_MOVE, _MOVE_FAR, _INSERT, _REVERSE, _REMOVE = range(5)
_LESS, _LESS_SWEPT = 0.3, 0.05
"""By what share the tour under way of a thorough search must be longer than another one, and than a
sweep, to be left for it."""
_HANDICAPS = np.repeat([1.0, 1.0 + _LESS, 1.0 + _LESS_SWEPT], [1, NUM_GREEDY, NUM_SWEEPS])
"""Of the drafts: the tour under way, greedy tours, sweeps."""


@pytree
class Tour:
    """Places to go to in turn; K = NUM_STOPS."""

    x: Array  # f32[..., K] metres, map frame
    y: Array  # f32[..., K]


@pytree
class Plan:
    """The candidates of the last round; T = NUM_CHANGES + 1, the best one before it first."""

    tours: Tour  # leaves [T, K]
    latency: Array  # f32[T] expected metres until found, times the mass
    mass: Array  # f32[] expected number of things still to be found
    hung: Array  # f32[] of them, those that hang on an observed object


def best_tour(plan: Plan, value: Array) -> Tour:
    """Take the tour whose first stop is valued most.

    Args:
        plan: T candidates.
        value: f32[A], values of the nodes, the first T of them for the tours.

    Returns:
        Leaves [K].
    """
    index = jnp.argmax(value[: plan.latency.shape[0]])
    return Tour(x=plan.tours.x[index], y=plan.tours.y[index])


def no_tour(x: Array, y: Array) -> Tour:
    """Build the tour of a robot that has not planned yet: it has arrived everywhere."""
    stay = jnp.ones(NUM_STOPS, jnp.float32)
    return Tour(x=stay * x, y=stay * y)


def _is_underfoot(x: Array, y: Array, robot_x: Array, robot_y: Array) -> Array:
    """Tell which places count as reached."""
    return (x - robot_x) ** 2 + (y - robot_y) ** 2 < _ARRIVAL * _ARRIVAL


def drop_reached(tour: Tour, robot_x: Array, robot_y: Array) -> Tour:
    """Drop the first stop once the robot is there; the last one is repeated.

    Args:
        tour: leaves [K].
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.

    Returns:
        What is left of the tour.
    """
    is_there = _is_underfoot(tour.x[0], tour.y[0], robot_x, robot_y)
    return Tour(
        x=jnp.where(is_there, jnp.append(tour.x[1:], tour.x[-1]), tour.x),
        y=jnp.where(is_there, jnp.append(tour.y[1:], tour.y[-1]), tour.y),
    )


def first_sight(
    tours: Tour,
    x: Array,
    y: Array,
    robot_x: Array,
    robot_y: Array,
    radius: Array,
    opening: Array | None = None,
    *,
    terrain: Terrain = OPEN,
) -> tuple[Array, Array]:
    """Compute after how many metres each tour first comes in sight of each place.

    Limits: 0 for a place already in sight; ``NEVER`` or more for one that never is.

    Args:
        tours: leaves [T, K].
        x: f32[C], places, metres, map frame.
        y: f32[C].
        robot_x: f32[], where the tours start.
        robot_y: f32[].
        radius: f32[], metres, how far one sees.
        opening: f32[], radians, how wide one sees about the way ahead; None: all round.
        terrain: what can be seen, and how far it is to walk.

    Returns:
        f32[T, C] metres; f32[T] metres, whole length of each tour.
    """
    start = jnp.ones_like(tours.x[:, :1])
    from_x = jnp.concatenate([robot_x * start, tours.x[:, :-1]], axis=1)
    from_y = jnp.concatenate([robot_y * start, tours.y[:, :-1]], axis=1)
    length = terrain.travel.metres(from_x, from_y, tours.x, tours.y)
    walked = jnp.cumsum(length, axis=1)
    # All stretches of all tours against all places, [T, K, C].
    stretch = Stretch(from_x, from_y, tours.x, tours.y)
    enter = terrain.travel.first_sight(terrain.view, stretch, x, y, radius, opening)
    met = (walked - length)[:, :, None] + enter
    first = met[:, 0]
    for stop in range(1, met.shape[1]):  # a reduction over a middle axis is not vectorised
        first = jnp.minimum(first, met[:, stop])
    return once(first), walked[:, -1]


def latency(
    tours: Tour,
    search: SearchMap,
    robot_x: Array,
    robot_y: Array,
    sensor: SensorParams,
    area: Array,
) -> Array:
    """Compute the expected way until what is looked for comes into view, times its mass.

    Limits: at q = 0 the way until all has been looked at does not count; a view of half a circle
    or more sweeps 2 R abreast.

    Args:
        tours: leaves [T, K].
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        sensor: how far and how wide one sees.
        area: f32[4], operating area, metres.

    Returns:
        f32[T] metres; large for a tour that starts underfoot.
    """
    radius, abreast = eyesight(sensor)
    opening = sensor.field_of_view
    places_x = jnp.concatenate([search.x, search.partner_x])
    places_y = jnp.concatenate([search.y, search.partner_y])
    sight, walked = first_sight(
        tours, places_x, places_y, robot_x, robot_y, radius, opening, terrain=search.terrain
    )
    hung, partner = jnp.split(sight, 2, axis=1)
    free = jnp.minimum(hung, partner)
    away = search.terrain.travel.metres(
        tours.x[:, -1:], tours.y[:, -1:], search.x[None], search.y[None]
    )
    mass = search.mass
    counts = is_worth_a_look(mass)[None, :]
    is_left = (free >= NEVER) & counts
    cell = (area[1] - area[0]) * (area[3] - area[2]) / mass.shape[0]
    sweep = jnp.sum(is_left, axis=1) * cell / (4.0 * abreast)
    rest = (walked + sweep)[:, None] + away
    total = jnp.sum(
        search.free[None, :] * jnp.where(free < NEVER, free, rest)
        + search.hung[None, :] * jnp.where(hung < NEVER, hung, rest),
        axis=1,
    )
    is_missed = (hung >= NEVER) & counts
    number = jnp.sum(is_missed, axis=1)
    back = jnp.sum(jnp.where(is_missed, away, 0.0), axis=1) / jnp.maximum(number, 1)
    whole = walked + back + number * cell / (2.0 * abreast)
    if search.is_thorough:
        whole = whole + between_patches(is_missed, area)
    total = (1.0 - search.nowhere) * total + search.nowhere * jnp.sum(mass) * whole
    return total + jnp.where(
        _is_underfoot(tours.x[:, 0], tours.y[:, 0], robot_x, robot_y), NEVER, 0.0
    )


def greedy(
    search: SearchMap, robot_x: Array, robot_y: Array, range_max: Array, area: Array
) -> Tour:
    """Draft tours over the lattice of viewpoints: always the most mass per metre next.

    Args:
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        range_max: f32[], sensing range, metres.
        area: f32[4], operating area, metres.

    Returns:
        Tours, leaves [NUM_GREEDY, K], that start at different viewpoints.
    """
    view_x, view_y = viewpoints(area)
    sees = visibility(view_x, view_y, search, range_max, area)
    metres = search.terrain.travel.metres
    between = metres(view_x[:, None], view_y[:, None], view_x[None, :], view_y[None, :])
    distance = metres(robot_x, robot_y, view_x, view_y)
    # A metre is added to each way: what can be had for nothing is not worth all.
    _, first = jax.lax.top_k((sees @ search.mass) / (distance + 1.0), NUM_GREEDY)

    def go_on(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        here, mass = carry
        there = jnp.argmax((mass @ sees.T) / (between[here] + 1.0), axis=1)
        return (there, mass * (1.0 - sees[there])), there

    left = search.mass[None, :] * (1.0 - sees[first])
    _, others = jax.lax.scan(go_on, (first, left), length=NUM_STOPS - 1)
    chosen = jnp.concatenate([first[None], others]).T
    return Tour(x=view_x[chosen], y=view_y[chosen])


def change(key: Array, tour: Tour, search: SearchMap, area: Array) -> Tour:
    """Change a tour in NUM_CHANGES ways at random.

    Args:
        key: random key, consumed.
        tour: leaves [K].
        search: new stops are drawn where mass is.
        area: f32[4], operating area, metres; stops stay in it.

    Returns:
        Tours, leaves [NUM_CHANGES, K].
    """
    uniform = batching.uniforms(key[None], 5 * NUM_CHANGES).reshape(5, NUM_CHANGES)
    kind = (jnp.arange(NUM_CHANGES) % 5)[:, None]
    place = jnp.arange(NUM_STOPS)[None, :]
    one, other = jnp.floor(uniform[:2] * NUM_STOPS).astype(jnp.int32)[:, :, None]
    low, high = jnp.minimum(one, other), jnp.maximum(one, other)
    source = jnp.select(
        [kind == _INSERT, kind == _REVERSE, kind == _REMOVE],
        [
            jnp.where(place > one, place - 1, place),
            jnp.where((place >= low) & (place <= high), low + high - place, place),
            jnp.where(place >= one, jnp.minimum(place + 1, NUM_STOPS - 1), place),
        ],
        place,
    )
    cumulative = jnp.cumsum(search.mass)
    drawn = jnp.sum(cumulative[None, :] <= (uniform[2] * cumulative[-1])[:, None], axis=1)
    drawn = jnp.minimum(drawn, cumulative.shape[0] - 1)[:, None]
    length = (0.3 * 10.0 ** uniform[3])[:, None]
    angle = (2.0 * jnp.pi * uniform[4])[:, None]
    is_new = ((kind == _INSERT) & (place == one)) | ((kind == _REMOVE) & (place == NUM_STOPS - 1))
    is_moved = (kind <= _MOVE_FAR) & (place == one)

    def rearrange(stops: Array, cells: Array, step: Array, least: Array, most: Array) -> Array:
        stops = jnp.where(is_new, cells[drawn], stops[source])
        return jnp.clip(stops + jnp.where(is_moved, step, 0.0), least, most)

    return Tour(
        x=rearrange(tour.x, search.x, length * jnp.cos(angle), area[0], area[1]),
        y=rearrange(tour.y, search.y, length * jnp.sin(angle), area[2], area[3]),
    )


def _join(first: Tour, second: Tour) -> Tour:
    """Put candidates behind one another."""
    return Tour(x=jnp.concatenate([first.x, second.x]), y=jnp.concatenate([first.y, second.y]))


def plan(
    key: Array,
    tour: Tour,
    search: SearchMap,
    robot_x: Array,
    robot_y: Array,
    sensor: SensorParams,
    area: Array,
) -> Plan:
    """Improve the tour under way, or leave it for a better one.

    Args:
        key: random key, consumed.
        tour: leaves [K], the tour under way.
        search: where looking is worth while.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        sensor: how far and how wide one sees.
        area: f32[4], operating area, metres.

    Returns:
        The candidates and what each of them costs.
    """
    chex.assert_shape([tour.x, tour.y, area], [(NUM_STOPS,), (NUM_STOPS,), (4,)])
    chex.assert_equal_shape([search.x, search.y, search.free, search.hung, search.partner_x])
    chex.assert_rank([robot_x, robot_y, sensor.range_max, sensor.field_of_view], 0)
    chex.assert_type([tour.x, search.free, area], float)
    here = drop_reached(drop_reached(tour, robot_x, robot_y), robot_x, robot_y)
    drafts = _join(
        Tour(x=here.x[None], y=here.y[None]),
        greedy(search, robot_x, robot_y, sensor.range_max, area),
    )
    keys = jax.random.split(key, NUM_ROUNDS)
    # As many drafts as changes: one program weighs them all.
    drawn = np.minimum(np.arange(NUM_CHANGES), NUM_GREEDY)
    drafts = Tour(x=drafts.x[drawn], y=drafts.y[drawn])
    if search.is_thorough:
        here_x, here_y = jnp.asarray(robot_x), jnp.asarray(robot_y)
        swept = sweeps(search, jnp.stack([here_x, here_y]), sensor, area, num_stops=NUM_STOPS)
        first = Tour(x=drafts.x[: 1 + NUM_GREEDY], y=drafts.y[: 1 + NUM_GREEDY])
        drafts = _join(first, Tour(x=swept[:, 0], y=swept[:, 1]))

    def improve(index: Array, carry: tuple[Tour, Array]) -> tuple[Tour, Array]:
        """Keep the best tour and weigh changes of it; at first, the drafts."""
        tours, cost = carry
        least = jnp.argmin(cost)
        best = Tour(x=tours.x[least], y=tours.y[least])
        changed = change(keys[index - 1], best, search, area)
        tried = jax.tree.map(lambda one, other: jnp.where(index == 0, one, other), drafts, changed)
        weighed = latency(tried, search, robot_x, robot_y, sensor, area)
        if search.is_thorough:
            weighed = weighed * jnp.where(index == 0, _HANDICAPS.astype(np.float32), 1.0 + _LESS)
        kept = Tour(x=best.x[None], y=best.y[None])
        return _join(kept, tried), jnp.append(cost[least], weighed)

    # Nothing has been weighed yet: the first best is any of those that cost too much to be kept.
    untried = jax.tree.map(lambda one: jnp.tile(one, (NUM_CHANGES + 1, 1)), here)
    costs = jnp.full(NUM_CHANGES + 1, jnp.inf)
    tours, cost = jax.lax.fori_loop(0, NUM_ROUNDS + 1, improve, (untried, costs))
    return Plan(tours=tours, latency=cost, mass=jnp.sum(search.mass), hung=jnp.sum(search.hung))
