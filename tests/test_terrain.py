"""What is in view and how far it is to walk, in the open and among walls."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from placed import placed, standing
from situations import seen_goal

from jaxlangnav.planner import qmdp
from jaxlangnav.planner.latency import Tour, first_sight
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import observe
from jaxlangnav.semantic_map.coverage import add_view, cell_centres, empty_coverage
from jaxlangnav.terrain import OPEN, Eye, OpenField, StraightLines, Terrain
from jaxlangnav.terrain.geodesic import CLEARANCE, Geodesic, geodesic
from jaxlangnav.terrain.view import LARGE, Segment, eye_of
from jaxlangnav.terrain.walls import Walls, walls
from jaxlangnav.world.sensor import visible
from jaxlangnav.world.state import Scenario

AREA = jnp.array([0.0, 10.0, -5.0, 5.0])
WALL = (4.0, -2.0, 4.0, 2.0)
"""Across the way, one metre longer on either side than the robot is from it."""
HERE = jnp.float32(0.0)
# Views and ways are data: one program for all walls of one number.
SEES = jax.jit(lambda view, eye, x, y: view.sees(eye, x, y))
SHARE = jax.jit(lambda view, eye, x, y, softness: view.share(eye, x, y, softness))
METRES = jax.jit(lambda ways, *places: ways.metres(*places))
VALUES, WITHIN = jax.jit(qmdp.values), jax.jit(qmdp.mass_within)
FIRST_SIGHT, ABSENCE = jax.jit(first_sight), jax.jit(observe.log_absence)
LOOK, NEXT_PLACE = jax.jit(add_view), jax.jit(lambda ways, *places: ways.next_place(*places))
ALONG = jax.jit(lambda view, *stretch: view.first_sight(*stretch))


def eye(x: float = 0.0, y: float = 0.0, radius: float = 20.0) -> Eye:
    return Eye(jnp.float32(x), jnp.float32(y), jnp.float32(radius))


@pytest.fixture(scope="module")
def ways() -> Geodesic:
    return geodesic(walls(WALL))


def crosses(p: np.ndarray, q: np.ndarray, wall: tuple[float, ...]) -> np.ndarray:
    """Tell by signs of areas whether segments p q [n, 2] cross a wall: another way to ask."""
    a, b = np.array(wall[:2]), np.array(wall[2:])

    def side(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        first, second = v - u, w - u
        return np.sign(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])

    return (side(p, q, a) != side(p, q, b)) & (side(a, b, p) != side(a, b, q))


def test_a_body_goes_as_far_as_no_wall_is_in_its_way() -> None:
    """Against the first of 800 parts of the way, and of a body's radius more, that is crossed."""
    generator, body = np.random.default_rng(4), 0.25
    ends = [tuple(generator.uniform(-3, 3, 4)) for _ in range(4)]
    p, q = generator.uniform(-4, 4, (2, 300, 2))
    length = np.hypot(*(q - p).T)
    reach, parts = 1.0 + body / length, np.linspace(0.0, 1.0, 801)[:, None, None]
    there = p + parts * reach[:, None] * (q - p)
    hit = np.any([crosses(np.broadcast_to(p, there.shape), there, wall) for wall in ends], axis=0)
    first = np.where(hit.any(axis=0), hit.argmax(axis=0) / 800, np.inf)
    expected = np.clip(reach * first - body / length, 0.0, 1.0)
    way = Segment(*(jnp.asarray(one, jnp.float32) for one in (*p.T, *q.T)))
    share = jax.jit(lambda view, way: view.free_fraction(way, body))(walls(*ends), way)
    assert 0.1 < np.mean(expected < 1.0) < 0.9
    np.testing.assert_allclose(share, expected, atol=2e-3 * reach.max())
    assert OpenField().free_fraction(way, body) is None


def test_what_is_behind_a_wall_is_not_seen() -> None:
    generator = np.random.default_rng(0)
    ends = [tuple(generator.uniform(-5, 5, 4)) for _ in range(6)]
    p, q = generator.uniform(-6, 6, (2, 4000, 2))
    from_x, from_y, to_x, to_y = (jnp.asarray(v, jnp.float32) for v in (*p.T, *q.T))
    for number in (0, 1, 6):
        seen = SEES(walls(*ends[:number]), Eye(from_x, from_y, jnp.float32(99.0)), to_x, to_y)
        hidden = np.zeros(len(p), bool)
        for one in ends[:number]:
            hidden |= crosses(p, q, one)
        np.testing.assert_array_equal(seen, ~hidden)


def test_a_share_becomes_the_sharp_test_and_without_walls_the_open_field() -> None:
    generator = np.random.default_rng(1)
    x, y = (jnp.asarray(v, jnp.float32) for v in generator.uniform(-6, 6, (2, 2000)))
    sensor = by_hand.sensor(range_max=5.0, view=np.deg2rad(200.0))
    looking = eye_of(HERE, HERE, jnp.float32(0.4), sensor)
    for view in (OpenField(), walls((1.0, -1.0, 1.0, 2.0), (-2.0, 0.0, -2.0, 5.0))):
        share = SHARE(view, looking, x, y, jnp.float32(1e-4))
        np.testing.assert_array_equal(share > 0.5, SEES(view, looking, x, y))
        assert np.mean((share > 0.0) & (share < 1.0)) < 0.01
    soft = jnp.float32(0.7)
    shares = (SHARE(view, looking, x, y, soft) for view in (walls(), OpenField()))
    np.testing.assert_allclose(*shares, rtol=1e-4, atol=1e-6)


def test_a_shadow_has_a_soft_edge() -> None:
    """Two metres behind the wall's end, on its line of sight, half of a thing shows."""
    view, soft = walls((2.0, -9.0, 2.0, 0.0)), jnp.float32(1.0)
    aside = jnp.array([-0.6, -0.25, 0.0, 0.25, 0.6])
    share = SHARE(view, eye(), jnp.full(5, 4.0), aside, soft)
    np.testing.assert_allclose(share, [0.0, 0.25, 0.5, 0.75, 1.0], atol=1e-5)


def scenario(view: Walls | OpenField) -> Scenario:
    things = [(by_hand.HYDRANT, 6.0, 0.0), (by_hand.CONE, 2.0, 0.0)]
    terrain = Terrain(view=view, travel=StraightLines())
    return placed(things, slots=3, area=AREA, goal=0, terrain=terrain)


def test_the_sensor_sees_in_front_of_a_wall_and_not_behind() -> None:
    sensor, see = by_hand.sensor(range_max=8.0), jax.jit(visible)
    for view, expected in (
        (OpenField(), [True, True, False]),
        (walls(WALL), [False, True, False]),
        (walls((4.0, 1.0, 4.0, 3.0)), [True, True, False]),
    ):
        np.testing.assert_array_equal(see(standing(), scenario(view), sensor)[2], expected)


def test_what_is_behind_a_wall_is_neither_seen_nor_counted_as_absent() -> None:
    """The look leaves the cells behind unexplored, and refutes no hypothesis there."""
    sensor = by_hand.sensor(range_max=8.0, probability=0.95)
    looking = eye_of(HERE, HERE, HERE, sensor)
    coverage = empty_coverage(AREA, 20)
    open_look = LOOK(coverage, looking, sensor, OPEN.view)
    walled = LOOK(coverage, looking, sensor, walls(WALL))
    x, y = np.meshgrid(*(np.asarray(axis) for axis in cell_centres(coverage)))
    behind = (x > 4.5) & (np.abs(y) < 0.5 * x - 0.8)
    assert behind.sum() > 50
    assert (np.asarray(walled.log_miss)[behind] == 0.0).all()
    assert (np.asarray(open_look.log_miss)[behind & (np.hypot(x, y) < 7.5)] < -2.9).all()
    in_front = x < 3.5
    np.testing.assert_array_equal(walled.log_miss[in_front], open_look.log_miss[in_front])

    belief = by_hand.begin()
    particles = belief.particles
    number = belief.log_weight.shape[0]
    place = jnp.stack([jnp.full(number, 6.0), jnp.full(number, 2.0), jnp.zeros(number)])
    hypothetical = replace(
        particles,
        mean_x=particles.mean_x.at[-1].set(0.0),
        mean_y=particles.mean_y.at[-1].set(0.0),
        hypothesis_x=place,
        hypothesis_y=jnp.zeros_like(place),
        is_mentioned=particles.is_mentioned.at[:2].set(True).at[2].set(False),
    )
    none_hit = jnp.zeros_like(particles.is_observed)
    for view, expected in ((OPEN.view, np.log(0.05)), (walls(WALL), 0.0)):
        _, missed, _ = ABSENCE(hypothetical, none_hit, HERE, jnp.float32(0.25), sensor, view)
        np.testing.assert_allclose(missed[0], expected, atol=1e-4)
        np.testing.assert_allclose(missed[1], np.log(0.05), atol=1e-4)


def test_the_way_round_a_wall(ways: Geodesic) -> None:
    """From (0, 0) to (8, 0) it leads past an end of the wall: twice √(4² + 2²) m."""
    generator = np.random.default_rng(2)
    p, q = generator.uniform([0.0, -5.0], [10.0, 5.0], (2, 500, 2))
    p[0], q[0] = (0.0, 0.0), (8.0, 0.0)
    from_x, from_y, to_x, to_y = (jnp.asarray(v, jnp.float32) for v in (*p.T, *q.T))
    line = METRES(StraightLines(), from_x, from_y, to_x, to_y)
    way = np.asarray(METRES(ways, from_x, from_y, to_x, to_y))
    is_open = ~crosses(p, q, WALL)
    np.testing.assert_allclose(way[is_open], line[is_open], rtol=1e-6)
    ends = [np.array([4.0, -2.0 - CLEARANCE]), np.array([4.0, 2.0 + CLEARANCE])]
    exact = np.min([np.hypot(*(p - e).T) + np.hypot(*(q - e).T) for e in ends], axis=0)
    np.testing.assert_allclose(way[~is_open], exact[~is_open], rtol=1e-5)
    assert way[0] > 1.08 * 8.0


def test_the_way_out_of_a_maze() -> None:
    """Two walls across a passage, with gaps at opposite sides: the way winds."""
    ways = geodesic(walls((3.0, -9.0, 3.0, 2.0), (6.0, -2.0, 6.0, 9.0)))
    zero = jnp.float32(0.0)
    way = float(METRES(ways, zero, zero, jnp.float32(9.0), zero))
    top, low = (3.0, 2.0 + CLEARANCE), (6.0, -2.0 - CLEARANCE)
    expected = np.hypot(*top) + np.hypot(3.0, top[1] - low[1]) + np.hypot(3.0, low[1])
    assert way == pytest.approx(expected, rel=1e-5)


def test_without_walls_every_way_is_straight_and_a_closed_room_has_none() -> None:
    free, zero, far = geodesic(walls()), jnp.float32(0.0), jnp.float32(3.0)
    assert float(METRES(free, zero, zero, far, far)) == pytest.approx(np.hypot(3.0, 3.0))
    assert NEXT_PLACE(free, zero, zero, far, far) == (far, far)
    corners = [(2.0, -2.0), (6.0, -2.0), (6.0, 2.0), (2.0, 2.0)]
    sides = zip(corners, corners[1:] + corners[:1], strict=True)
    shut = geodesic(walls(*((*a, *b) for a, b in sides)))
    inside, outside = (jnp.float32(4.0), zero), (jnp.float32(9.0), zero)
    assert float(METRES(shut, *inside, *outside)) >= LARGE
    assert float(METRES(shut, *inside, jnp.float32(3.0), jnp.float32(1.0))) < 2.0


@pytest.mark.parametrize("one", [(1.0, 2.0, 3.0), (0.0, 0.0, np.nan, 1.0)])
def test_what_is_no_wall_is_refused(one: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="each must be x, y, x, y, finite, in metres"):
        walls(one)  # pyright: ignore[reportArgumentType]


def test_who_follows_the_next_places_walks_round_the_wall(ways: Geodesic) -> None:
    place, end, walked = np.zeros(2), np.array([8.0, 0.0]), 0.0
    for _ in range(40):
        ahead = np.array(NEXT_PLACE(ways, *jnp.asarray([*place, *end], jnp.float32)))
        step = ahead - place
        step = step * min(1.0, 0.5 / max(np.hypot(*step), 1e-9))
        assert not crosses(place[None], (place + step)[None], WALL)[0]
        place, walked = place + step, walked + np.hypot(*step)
        if np.hypot(*(end - place)) < 1e-3:
            break
    assert np.hypot(*(end - place)) < 1e-3
    assert 2 * np.hypot(4.0, 2.0) < walked < 2 * np.hypot(4.0, 2.0 + CLEARANCE) + 1e-3


def test_values_discount_by_what_there_is_to_walk(ways: Geodesic) -> None:
    """A goal behind the wall: the nearer node is worth less, if the way from it is longer."""
    node_x, node_y = jnp.array([3.0, 5.0]), jnp.array([0.0, 3.5])
    goals, discount = seen_goal(1.0, 5.0, 0.0), jnp.float32(0.8)
    straight = VALUES(node_x, node_y, goals, discount)
    walked = VALUES(node_x, node_y, goals, discount, ways)
    assert straight[0] > straight[1]
    assert walked[0] < walked[1]
    np.testing.assert_allclose(walked[1], straight[1])
    near = jnp.float32(2.5)
    assert float(WITHIN(node_x[0], node_y[0], goals, near)[1]) == 1.0
    assert float(WITHIN(node_x[0], node_y[0], goals, near, walls(WALL))[1]) == 0.0


def test_a_tour_sees_behind_a_wall_once_it_is_past_its_end(ways: Geodesic) -> None:
    """Two stops, beside the wall's end and behind it; what is looked for lies behind the middle."""
    tour = Tour(x=jnp.array([[4.0, 6.0]]), y=jnp.array([[3.0, 2.0]]))
    place, radius = (jnp.array([5.0]), jnp.array([0.0])), jnp.float32(6.0)
    free, length = FIRST_SIGHT(tour, *place, (HERE, HERE), radius)
    assert float(free[0, 0]) == 0.0
    there = Terrain(view=ways.walls, travel=ways)
    hidden, same = FIRST_SIGHT(tour, *place, (HERE, HERE), radius, terrain=there)
    np.testing.assert_allclose(same, length, rtol=1e-6)
    assert 4.9 < float(hidden[0, 0]) < float(length[0])
    straight_through = Tour(x=jnp.array([[8.0]]), y=jnp.array([[0.0]]))
    late, way = FIRST_SIGHT(straight_through, *place, (HERE, HERE), radius, terrain=there)
    np.testing.assert_allclose(late[0], way)  # around the wall: what its end shows counts alone
    assert float(way[0]) > 8.5


def test_a_stretch_past_walls_agrees_with_looking_step_by_step() -> None:
    generator = np.random.default_rng(5)
    view = walls((4.0, -2.0, 4.0, 2.0), (1.0, 3.0, 6.0, 3.0))
    ends = generator.uniform([0.0, -5.0], [10.0, 5.0], (2, 30, 2))
    place = generator.uniform([0.0, -5.0], [10.0, 5.0], (50, 2))
    stretch = Segment(*(jnp.asarray(one, jnp.float32) for one in (*ends[0].T, *ends[1].T)))
    x, y = (jnp.asarray(one, jnp.float32) for one in place.T)
    found = np.asarray(ALONG(view, stretch, x, y, jnp.float32(3.0)))
    parts = np.linspace(0.0, 1.0, 201)[:, None, None]
    eye_x = jnp.asarray(ends[0, :, :1] + parts * (ends[1] - ends[0])[:, :1], jnp.float32)
    eye_y = jnp.asarray(ends[0, :, 1:] + parts * (ends[1] - ends[0])[:, 1:], jnp.float32)
    seen = np.asarray(SEES(view, Eye(eye_x, eye_y, jnp.float32(3.0)), x[None, None], y[None, None]))
    length = np.hypot(*(ends[1] - ends[0]).T)[:, None]
    exact = np.where(seen.any(0), seen.argmax(0) / 200 * length, LARGE)
    is_found = (found < LARGE) & (exact < LARGE)
    assert (found[is_found] >= exact[is_found] - 0.06).all()
    assert (found[is_found] <= exact[is_found] + length.max() / 8 + 0.06).all()
    assert ((found < LARGE) != (exact < LARGE)).mean() < 0.03
