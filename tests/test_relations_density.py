"""Relations: density, frames, information, gradients, order, and what lies between (sec. 3.2)."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from differences import central
from oracles import relations as oracle

from jaxlangnav.language.labels import Geometry, PlacedWorld
from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, RELATIONS, RIGHT
from jaxlangnav.pytree import replace
from jaxlangnav.relations import (
    RelationParams,
    between,
    default_params,
    holds,
    log_density,
    prepare,
    robot_frame,
    sample_polar,
    to_map,
    viewer_frame,
)
from jaxlangnav.relations.between import SPREAD, lies_between
from jaxlangnav.relations.strength import degree, degree_of, num_before, value_of_rank
from jaxlangnav.relations.table import NUM_RANKS, ORDERS

ALL = range(len(RELATIONS))
VIEWER, LANDMARK = (1.0, -2.0), (4.0, 2.0)


@jax.jit
def density_at(params: RelationParams, relation: int, x: jax.Array, y: jax.Array) -> jax.Array:
    frame = viewer_frame(*VIEWER, *LANDMARK)
    return log_density(prepare(params), relation, x, y, frame)


@jax.jit
def draw(params: RelationParams, relation: int, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    normal = jax.random.normal(key, (2, 200_000))
    along, lateral = sample_polar(prepare(params), relation, normal[0], normal[1])
    return to_map(viewer_frame(*VIEWER, *LANDMARK), along, lateral)


def law(relation: int) -> dict[str, float]:
    free = default_params()
    return {
        "median": float(np.exp(free.log_distance[relation])),
        "spread": float(free.log_distance_sd[relation]),
        "axis": float(free.axis[relation]),
        "concentration": float(free.concentration[relation]),
    }


def polar_grid(number: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints of log-distance × direction, and the area of each, f64[n, n]."""
    log_edges = np.linspace(np.log(0.2), np.log(80.0), number + 1)
    middle = 0.5 * (log_edges[1:] + log_edges[:-1])
    angle = -np.pi + (np.arange(number) + 0.5) * 2 * np.pi / number
    r, turn = np.meshgrid(np.exp(middle), angle, indexing="ij")
    area = r**2 * (log_edges[1] - log_edges[0]) * (2 * np.pi / number)
    return np.stack([r * np.cos(turn), r * np.sin(turn)], -1), area


@pytest.mark.parametrize("relation", ALL, ids=RELATIONS)
def test_density_is_normalised_and_equals_the_equation(relation: int) -> None:
    offset, area = polar_grid()
    ours = np.asarray(density_at(default_params(), relation, offset[..., 0], offset[..., 1]))
    total = np.sum(np.exp(ours.astype(float)) * area)
    assert abs(total - 1.0) < 1e-3
    sight = np.arctan2(LANDMARK[1] - VIEWER[1], LANDMARK[0] - VIEWER[0])
    truth = np.log(oracle.density(offset, sight, **law(relation)) + 1e-300)
    is_likely = truth > truth.max() - 25.0
    np.testing.assert_allclose(ours[is_likely], truth[is_likely], atol=2e-3)


@pytest.mark.parametrize("relation", ALL, ids=RELATIONS)
def test_sampler_matches_the_density(relation: int) -> None:
    """Bin counts within 5 standard errors, and nothing where the density says nothing."""
    x, y = (np.asarray(v, float) for v in draw(default_params(), relation, jax.random.key(0)))
    number = x.size
    numbers, sight = law(relation), np.arctan2(4.0, 3.0)
    log_r = np.log(np.hypot(x, y) / numbers["median"]) / numbers["spread"]
    # Distance: quantiles of a standard normal.
    for level, share in ((-2.0, 0.02275), (-1.0, 0.15866), (0.0, 0.5), (1.5, 0.93319)):
        error = np.sqrt(share * (1 - share) / number)
        assert abs((log_r < level).mean() - share) < 5 * error
    turn = np.angle(np.exp(1j * (np.arctan2(y, x) - sight - numbers["axis"])))
    # Direction: von Mises bins, by fine summation.
    grid = np.linspace(-np.pi, np.pi, 200_001)
    weight = np.exp(numbers["concentration"] * (np.cos(grid) - 1))
    weight /= weight.sum()
    edges = np.array([-np.pi, -1.5, -0.9, -0.5, -0.2, 0.0, 0.1, 0.35, 0.7, 1.2, np.pi])
    for low, high in itertools.pairwise(edges):
        share = weight[(grid >= low) & (grid < high)].sum()
        error = np.sqrt(share * (1 - share) / number)
        assert abs(((turn >= low) & (turn < high)).mean() - share) < 5 * error + 2e-5, (low, high)
    # Distance and direction are independent.
    assert abs(np.corrcoef(log_r, turn)[0, 1]) < 5 / np.sqrt(number)


def bits_gained(relation: int, radius: float = 8.75) -> float:
    """Information of a relation against a disc of the mean distance of Table 2, in bits."""
    x, y = draw(default_params(), relation, jax.random.key(1))
    entropy = -float(jnp.mean(density_at(default_params(), relation, x, y)))
    return float(np.log2(np.pi * radius**2) - entropy / np.log(2))


def test_directed_relations_are_worth_what_the_design_says() -> None:
    """4.35 bits for a directed "behind", 2.35 for an undirected ring, within 0.3 bits."""
    assert abs(bits_gained(BEHIND) - 4.35) < 0.3
    assert abs(bits_gained(NEAR) - 2.35) < 0.3
    directed = bits_gained(BEHIND)
    for relation in (FRONT, LEFT, RIGHT):
        assert abs(bits_gained(relation) - directed) < 0.02


def test_frame_of_the_viewer() -> None:
    """A cone five metres ahead of the viewer at the origin: which side is which."""
    places = {BEHIND: (7.0, 0.0), FRONT: (3.0, 0.0), LEFT: (5.0, 2.0), RIGHT: (5.0, -2.0)}
    model, frame = prepare(default_params()), viewer_frame(0.0, 0.0, 5.0, 0.0)
    for relation, (x, y) in places.items():
        here = log_density(model, relation, jnp.float32(x - 5.0), jnp.float32(y), frame)
        for other, place in places.items():
            there = log_density(
                model, relation, jnp.float32(place[0] - 5.0), jnp.float32(place[1]), frame
            )
            if other != relation:
                assert here > there + 5.0, (RELATIONS[relation], RELATIONS[other])
            expected = other == relation
            assert bool(holds(relation, place, (5.0, 0.0), (0.0, 0.0))) == expected


def test_frame_of_a_viewer_who_looks_sideways() -> None:
    """Seen along +y, left of the cone is −x."""
    model, frame = prepare(default_params()), viewer_frame(2.0, 0.0, 2.0, 4.0)
    left = log_density(model, LEFT, jnp.float32(-2.0), jnp.float32(0.0), frame)
    right = log_density(model, LEFT, jnp.float32(2.0), jnp.float32(0.0), frame)
    assert left > right + 5.0
    assert bool(holds(LEFT, (0.0, 4.0), (2.0, 4.0), (2.0, 0.0)))


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_frame_of_the_robot_itself(heading: float) -> None:
    """ "In front of you" is ahead, "on your left" a quarter turn counter-clockwise."""
    model, frame = prepare(default_params()), robot_frame(jnp.float32(heading))
    turns = {FRONT: 0.0, LEFT: np.pi / 2, BEHIND: np.pi, RIGHT: -np.pi / 2}
    for relation, turn in turns.items():
        values = {}
        for other, other_turn in turns.items():
            x = jnp.float32(2.0 * np.cos(heading + other_turn))
            y = jnp.float32(2.0 * np.sin(heading + other_turn))
            values[other] = float(log_density(model, relation, x, y, frame))
            assert bool(holds(relation, (x, y), (0.0, 0.0), (0.0, 0.0), heading)) == (
                other == relation
            )
        assert max(values, key=lambda one: values[one]) == relation, turn


def test_near_and_far_are_rings() -> None:
    model, frame = prepare(default_params()), viewer_frame(0.0, 0.0, 5.0, 0.0)
    angle = jnp.linspace(0.0, 2 * jnp.pi, 9)
    for relation, near in ((NEAR, 2.0), (FAR, 8.0)):
        value = log_density(model, relation, near * jnp.cos(angle), near * jnp.sin(angle), frame)
        np.testing.assert_allclose(value, value[0], rtol=1e-5, atol=1e-5)
    assert bool(holds(NEAR, (5.0, 3.0), (5.0, 0.0), (0.0, 0.0)))
    assert bool(holds(FAR, (5.0, 8.0), (5.0, 0.0), (0.0, 0.0)))


def test_density_is_finite_at_and_far_from_the_landmark() -> None:
    for offset in (0.0, 1e-4, 1e3):
        for relation in ALL:
            value, gradient = jax.value_and_grad(
                lambda x, relation=relation: density_at(
                    default_params(), relation, x, jnp.zeros_like(x)
                )
            )(jnp.float32(offset))
            assert np.isfinite(value)
            assert np.isfinite(gradient)
            assert value < -4.0


def test_frame_is_finite_where_the_viewer_stands_on_the_landmark() -> None:
    frame = viewer_frame(1.0, 1.0, 1.0, 1.0)
    assert np.isfinite(np.array(jax.tree.leaves(frame))).all()


FIELDS = ("log_distance", "log_distance_sd", "axis", "concentration")


@pytest.mark.parametrize("field", FIELDS)
def test_gradient_by_parameters_equals_finite_differences(field: str) -> None:
    x, y = jnp.float32(2.0), jnp.float32(1.5)
    start = replace(default_params(), concentration=jnp.full(6, 3.0))

    def value(params: RelationParams) -> jax.Array:
        return sum(density_at(params, relation, x, y) for relation in ALL)

    gradient = np.asarray(getattr(jax.grad(value)(start), field))
    assert np.isfinite(gradient).all()
    for relation in ALL:
        difference, error = central(
            lambda by, of=relation: value(
                replace(start, **{field: getattr(start, field).at[of].add(by)})
            ),
            1e-2,
        )
        assert abs(difference - gradient[relation]) < error


@pytest.mark.parametrize("field", FIELDS)
def test_gradient_of_the_sampler_equals_finite_differences(field: str) -> None:
    """Draws move smoothly with the parameters (the table is part of the derivative)."""
    start = replace(default_params(), concentration=jnp.full(6, 3.0))

    @jax.jit
    def value(params: RelationParams) -> jax.Array:
        model = prepare(params)
        along, lateral = sample_polar(model, BEHIND, jnp.float32(0.4), jnp.float32(0.7))
        return along + 2.0 * lateral

    gradient = float(np.asarray(getattr(jax.jit(jax.grad(value))(start), field))[BEHIND])
    difference, error = central(
        lambda by: value(replace(start, **{field: getattr(start, field).at[BEHIND].add(by)})), 3e-2
    )
    assert np.isfinite(gradient)
    assert abs(difference - gradient) < error


# ---------------------------------------------------------------- how strongly it holds

DEGREE = jax.jit(degree)
NTH = jax.jit(value_of_rank, static_argnames="tie")


def test_one_step_to_the_left_by_hand() -> None:
    """3 m away and 2 m to the left: the far one by 3, the leftmost by 2, the nearest by -3."""
    expected = {FRONT: -3.0, BEHIND: -3.0, LEFT: 2.0, RIGHT: -2.0, NEAR: -3.0, FAR: 3.0}
    for relation, value in expected.items():
        assert float(degree_of(relation, np.array(3.0), np.array(2.0))) == value


def test_host_and_device_agree() -> None:
    generator = np.random.default_rng(0)
    distance, sideways = generator.uniform(-5, 5, (2, 100)).astype(np.float32)
    for relation in range(len(RELATIONS)):
        on_device = DEGREE(jnp.full(100, relation), jnp.asarray(distance), jnp.asarray(sideways))
        np.testing.assert_array_equal(on_device, degree_of(relation, distance, sideways))


@pytest.mark.parametrize("relation", ORDERS)
def test_who_is_nth_on_the_host_is_nth_on_the_device(relation: int) -> None:
    generator = np.random.default_rng(relation)
    objects = tuple(("cone", *generator.uniform(-5, 5, 2)) for _ in range(6))
    geometry = Geometry(PlacedWorld(objects=objects, robot=(0.3, -0.2, 0.9)))
    strength = geometry.strength[relation, :, 6]
    before = num_before(strength, ~np.eye(6, dtype=bool))
    everything, merit = tuple(range(6)), jnp.asarray(-strength, jnp.float32)
    for rank in range(1, NUM_RANKS + 1):
        nth = int(np.flatnonzero(before == rank - 1)[0])
        assert geometry.is_extreme(relation, nth, 6, rank, everything)
        assert float(NTH(jnp.int32(rank), merit, tie=1e-6)) == float(merit[nth])
    assert float(NTH(jnp.int32(5), merit, tie=1e-6)) == np.inf


# ---------------------------------------------------------------- what lies between two landmarks

NEARER, OTHER = (5.0, 1.0), (1.0, -2.0)
"""Five metres apart: along is (0.8, 0.6)."""


def at(x, y):
    return jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)


def test_density_by_hand_and_normalised() -> None:
    middle = float(between.log_density(at(3.0, -0.5), at(*NEARER), at(*OTHER)))
    assert middle == pytest.approx(-np.log(2 * np.pi * SPREAD[0] * SPREAD[1] * 25.0), abs=1e-4)
    # One standard deviation along, and two across.
    aside = at(3.0 + 0.8 * 1.0 - 0.6 * 1.5, -0.5 + 0.6 * 1.0 + 0.8 * 1.5)
    assert float(between.log_density(aside, at(*NEARER), at(*OTHER))) == pytest.approx(
        middle - 0.5 - 2.0, abs=1e-4
    )
    step = np.arange(-10.0, 15.0, 0.05)
    grid = at(*np.meshgrid(step, step))
    total = (
        np.exp(np.asarray(between.log_density(grid, at(*NEARER), at(*OTHER)), float)).sum()
        * 0.05**2
    )
    assert total == pytest.approx(1.0, abs=1e-3)


def test_neither_landmark_comes_first_and_no_place_is_infinite() -> None:
    places = at(*np.random.default_rng(0).uniform(-8, 8, (2, 50)))
    one, other = (
        between.log_density(places, *pair)
        for pair in ((at(*NEARER), at(*OTHER)), (at(*OTHER), at(*NEARER)))
    )
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
    assert np.isfinite(between.log_density(places, at(*OTHER), at(*OTHER))).all()


def test_draws_have_the_densities_they_say() -> None:
    normal = jax.random.normal(jax.random.key(1), (2, 2, 40_000))
    along, lateral, log_drawn = between.sample(normal[0], normal[1])
    # A figure, seen from one landmark towards the other one, in shares of the way.
    places = np.asarray(along[0]) + 1.0, np.asarray(lateral[0])
    for values, mean, spread in zip(places, (0.5, 0.0), SPREAD, strict=True):
        error = spread / np.sqrt(values.size)
        assert abs(values.mean() - mean) < 5 * error
        assert abs(values.std() - spread) < 5 * error
    # A landmark, seen from its figure: the mean of 1 / q over a piece of a sector is its area.
    distance, turn = np.hypot(along[1], lateral[1]), np.arctan2(lateral[1], -along[1])
    for radius in (0.5, 1.0, 2.0):
        is_in = (distance > 0.2) & (distance < radius) & (np.abs(turn) < 1.2)
        inside = np.where(is_in, np.exp(-np.asarray(log_drawn[0], float)), 0.0)
        error = inside.std() / np.sqrt(inside.size)
        assert error < 0.05
        assert abs(inside.mean() - 1.2 * (radius**2 - 0.04)) < 5 * error


def test_lies_between_by_hand() -> None:
    one, other = (0.0, 0.0), (4.0, 0.0)
    told = {
        (2.0, 0.0): True,
        (2.0, 0.8): True,
        (2.0, 1.4): True,  # 2.33 standard deviations aside
        (2.0, 1.5): False,
        (0.3, 0.1): True,
        (-0.1, 0.0): False,
        (4.5, 0.0): False,
        (0.0, 0.0): False,
        (4.0, 0.0): False,
    }
    for place, is_so in told.items():
        assert bool(lies_between(np.array(place), one, other)) is is_so, place
        assert bool(lies_between(np.array(place), other, one)) is is_so, place
