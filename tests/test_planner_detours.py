"""Cheapest ways round what is forbidden: by hand, against quadrature and a dense graph."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from oracles.detours import shortest_way
from situations import nodes_at, seen_goal, situation

from jaxlangnav.planner.constraints import (
    CORNER_RADIUS,
    KEEP_AWAY,
    MAX_ZONES,
    ZONE_RADIUS,
    Zones,
    cost_along,
    keep_out,
    safe_fraction,
)
from jaxlangnav.planner.detours import detours
from jaxlangnav.planner.situation import Situation
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig

P, COST, FAR = 16, 100.0, 30.0
CONFIG = MapConfig(num_particles=P, num_objects=3, num_cells=24)
AREA = (-FAR, FAR, -FAR, FAR)
DETOURS = jax.jit(detours)


def things_at(places, share: float = 1.0) -> Zones:
    table = np.zeros((3, MAX_ZONES), np.float32)
    for slot, place in enumerate(places):
        table[:, slot] = *place, COST * share
    return Zones(x=jnp.asarray(table[0]), y=jnp.asarray(table[1]), cost=jnp.asarray(table[2]))


def shown(things, robot, share: float = 1.0) -> Situation:
    """A robot in a wide area that has seen things, all forbidden in a share of the maps."""
    objects = [(by_hand.CONE, *thing) for thing in things]
    belief = by_hand.with_objects(by_hand.begin(config=CONFIG), objects)
    coverage = replace(belief.coverage, area=jnp.asarray(AREA))
    forbidden = np.zeros((7, belief.particles.mean_x.shape[0], P), np.float32)
    forbidden[6, : len(things), : round(share * P)] = 1.0
    belief = replace(belief, coverage=coverage)
    made = situation(belief, nodes_at([], [], []), seen_goal(0.0), robot)
    return replace(made, forbidden_prob=jnp.asarray(forbidden))


def way_to(things, robot, places, spare: float = 0.0, share: float = 1.0) -> tuple:
    x, y = jnp.asarray(places, jnp.float32).T
    return DETOURS(shown(things, robot, share), x, y, jnp.full(x.shape, jnp.float32(spare)))


def test_the_price_of_a_way_is_the_integral_of_nearness() -> None:
    draw = np.random.default_rng(0)
    things = draw.uniform(-3.0, 3.0, (2, 2))
    ends = draw.uniform(-5.0, 5.0, (40, 4)).astype(np.float32)
    found = cost_along(*jnp.asarray(ends).T, things_at(things, 0.5))
    share = (np.arange(4000) + 0.5)[:, None, None] / 4000
    line = ends[:, :2] + share * (ends[:, 2:] - ends[:, :2])
    squared = ((line[:, :, None] - things) ** 2).sum(-1)
    deep = (np.maximum(1.0 - np.sqrt(squared) / ZONE_RADIUS, 0.0) ** 2).sum(-1).mean(axis=0)
    expected = 0.5 * COST * deep * np.hypot(*(ends[:, 2:] - ends[:, :2]).T)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    through = cost_along(*jnp.array([[-9.0], [0.0], [9.0], [0.0]]), things_at([(0.0, 0.0)]))
    np.testing.assert_allclose(through, COST * 2.0 * ZONE_RADIUS / 3.0, rtol=1e-5)


def test_ways_are_the_shortest_that_keep_the_berth() -> None:
    """Of places that allow it: at most 4 % and a few cm longer than with dense circles."""
    draw, number = np.random.default_rng(1), 0
    for _ in range(40):
        things, robot, place = draw.uniform(-6.0, 6.0, (3, 2)), *draw.uniform(-8.0, 8.0, (2, 2))
        ends = np.stack([robot, place])
        if np.hypot(*(ends[:, None] - things[None]).T).min() < ZONE_RADIUS + 0.05:
            continue
        best = shortest_way(robot, place, things, AREA, berth=ZONE_RADIUS, reach=0.05)
        length = np.hypot(*(place - robot))
        found = length + float(way_to(things, robot, [place])[0][0])
        # A gap that is a little too narrow may be cheaper than the way round.
        assert best > 0.95 * found - 0.1
        assert found > min(best, 1.5 * length) - 0.3
        number += 1
    assert number > 15


def test_with_nothing_forbidden_ways_are_straight() -> None:
    for share in (0.0, 0.02):
        longer, *at = way_to([(3.0, 0.0)], (0.0, 0.0), [(6.0, 0.0), (1.0, 2.0)], share=share)
        np.testing.assert_array_equal(longer, 0.0)
        np.testing.assert_array_equal(at, [[6.0, 1.0], [0.0, 2.0]])


def test_from_within_the_berth_the_way_leads_out() -> None:
    robot = np.array([-0.6, 0.1])
    for _ in range(3):
        _, *corner = np.array(way_to([(0.0, 0.0)], robot, [(6.0, 0.0)]))[:, 0]
        assert np.hypot(*corner) > ZONE_RADIUS - 0.01
        after = robot + 0.4 * (corner - robot) / np.hypot(*(corner - robot))
        assert np.hypot(*after) > np.hypot(*robot) + 0.2
        robot = after


@pytest.mark.parametrize(
    ("things", "start", "goal"),
    [
        ([(3.0, 0.0)], (0.0, 0.0), (4.0, 0.0)),
        # In a gap of 3.7 m: gone up to straight from there, it is reached 1.6 m from a thing.
        ([(3.98, 0.53), (5.56, 3.84)], (4.44, 2.3), (5.15, 0.79)),
    ],
)
def test_a_goal_in_the_berth_is_reached_from_its_far_side(things, start, goal) -> None:
    robot, path = np.array(start), [np.array(start)]
    for _ in range(14):
        longer, *corner = np.array(way_to(things, robot, [goal], spare=1.08))[:, 0]
        assert 0.0 < longer < 12.0 or np.hypot(*(robot - goal)) < 1.2
        span = corner - robot
        short = 1.08 if abs(corner[0] - goal[0]) < 1e-6 else 0.0
        robot = robot + max(min(1.0, np.hypot(*span) - short), 0.0) * span / np.hypot(*span)
        path.append(robot)
    assert np.hypot(*(robot - goal)) < 1.2
    assert np.hypot(*(np.array(path)[:, None] - np.array(things)).T).min() > 1.8


def test_a_gap_is_taken_once_where_there_is_no_other_way() -> None:
    made = shown([(3.0, y) for y in (-1.6, 1.6)], (0.0, 0.0))
    coverage = replace(made.belief.coverage, area=jnp.array([0.0, 6.0, -2.0, 2.0]))
    made = replace(made, belief=replace(made.belief, coverage=coverage))
    x, y, met = 0.0, 0.0, [(0.0, 0.0)]
    while x < 5.9 and len(met) < 20:
        made = replace(made, robot_x=jnp.float32(x), robot_y=jnp.float32(y))
        _, *corner = DETOURS(made, jnp.array([6.0]), jnp.array([-0.8]), jnp.zeros(1))
        span = np.ravel(corner) - [x, y]
        x, y = np.array([x, y]) + span * min(1.0, 1.0 / np.hypot(*span))
        met.append((x, y))
    met = np.array(met)
    assert (np.diff(met[:, 0]) > 0.0).all()
    assert np.hypot(met[:, :1] - 3.0, met[:, 1:] - [[-1.6, 1.6]]).min() > 1.5


def test_a_corner_that_was_given_up_is_gone_round_by_the_other_side() -> None:
    made = shown([(3.0, 0.1)], (0.0, 0.0))
    place = jnp.array([6.0]), jnp.array([0.0]), jnp.zeros(1)
    _, (x,), (y,) = DETOURS(made, *place)
    assert y < 0.0
    given_up, old = {"closed_x": x, "closed_y": y, "closed_for": 9}, made.progress
    blocked = {name: getattr(old, name).at[0].set(at) for name, at in given_up.items()}
    blocked = replace(old, **blocked)
    _, (other_x,), (other_y,) = DETOURS(replace(made, progress=blocked), *place)
    assert np.hypot(other_x - x, other_y - y) > 0.7


def test_stops_are_put_out_of_the_berth_where_one_sees_in() -> None:
    area, things = jnp.asarray(AREA), things_at([(0.0, 0.0)])
    x, y = jnp.array([1.0, 5.0, 0.0]), jnp.array([0.0, 0.0, -1.0])
    out = keep_out(x, y, things, jnp.float32(4.0), area)
    expected = [[CORNER_RADIUS, 5.0, 0.0], [0.0, 0.0, -CORNER_RADIUS]]
    np.testing.assert_allclose(out, expected, atol=1e-5)
    for same in (
        keep_out(x, y, things, jnp.float32(1.5), area),
        keep_out(x, y, things_at([]), jnp.float32(4.0), area),
    ):
        np.testing.assert_array_equal(same, [x, y])
    beside = keep_out(x, y, things, jnp.float32(4.0), area.at[1].set(1.5))
    np.testing.assert_allclose(beside[0][0], -CORNER_RADIUS, atol=1e-5)


@pytest.mark.parametrize("opening", [2.0 * np.pi, 1.5])
def test_steps_leave_time_to_see_what_is_forbidden(opening: float) -> None:
    """Against a loop over cells: nothing one more look would show is close after the step."""
    draw = np.random.default_rng(2)
    belief = by_hand.begin(config=CONFIG, area=(-6.0, 6.0, -6.0, 6.0))
    mentioned = jnp.zeros(belief.particles.is_mentioned.shape, bool).at[1, : P // 2].set(True)
    particles = replace(belief.particles, is_mentioned=mentioned)
    forbidden = jnp.zeros((7, 3 + len(mentioned) + 1, P)).at[6, 4].set(1.0)
    sensor, choose = by_hand.sensor(4.0, opening), jax.jit(safe_fraction)
    found = []
    for risk in (1e-3, 3e-3, 1e-2, 0.1):
        miss = 0.05 ** draw.integers(0, 3, (24, 24))
        belief = replace(by_hand.with_coverage(belief, np.log(miss)), particles=particles)
        robot, step = draw.uniform(-3.0, 3.0, (2, 2))
        given = belief, forbidden, tuple(map(jnp.float32, robot)), jnp.asarray(step, jnp.float32)
        found.append(float(choose(*given, sensor, jnp.float32(risk))))
        centres = np.stack(np.meshgrid(*[-5.75 + 0.5 * np.arange(24)] * 2), -1) - robot
        away = np.hypot(*centres.T).T
        ahead = centres @ step >= np.cos(0.5 * opening) * away * np.hypot(*step)
        for share in (1.0, 0.5, 0.25):
            after = np.hypot(*(centres - share * step).T).T
            is_close = (
                (after < KEEP_AWAY) & (after < away) & (away <= 4.0) & (ahead | (opening > 6.0))
            )
            if 0.5 * 0.95 * miss[is_close].sum() / miss.sum() <= risk:
                break
        assert found[-1] == share
        seen = replace(belief, particles=replace(particles, is_mentioned=mentioned & False))
        assert choose(seen, *given[1:], sensor, jnp.float32(0.0)) == 1.0
    assert len(set(found)) > 1


def test_a_batch_is_as_one_by_one() -> None:
    worlds = [([(3.0, 0.0)], 1.0), ([(3.0, 0.0)], 0.0), ([(2.0, 1.0)], 0.5)]
    made = [shown(things, (0.0, 0.0), share) for things, share in worlds]
    places = jnp.array([6.0, 2.0]), jnp.array([0.5, -3.0]), jnp.zeros(2)
    many = jax.tree.map(lambda *leaves: jnp.stack(leaves), *made)
    found = jax.jit(jax.vmap(detours, in_axes=(0, None, None, None)))(many, *places)
    for lane, one in enumerate(made):
        own = jax.tree.map(lambda leaf, n=lane: leaf[n], found)
        chex.assert_trees_all_close(own, DETOURS(one, *places), atol=1e-4)
