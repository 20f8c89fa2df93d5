"""Relations: density, frames, information, gradients (section 3.2; design of the map)."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from differences import central
from oracles import relations as oracle

from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, RELATIONS, RIGHT
from jaxlangnav.pytree import replace
from jaxlangnav.relations import (
    RelationParams,
    default_params,
    holds,
    log_density,
    prepare,
    robot_frame,
    sample_polar,
    to_map,
    viewer_frame,
)
from jaxlangnav.relations.density import (
    SIDE_CONCENTRATION,
    anywhere,
    law_of,
    log_density_in_frame,
)

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


@pytest.mark.parametrize(("is_side", "is_order"), [(True, False), (False, True), (False, False)])
def test_a_side_says_where_but_not_how_far(is_side: bool, is_order: bool) -> None:
    """Over all directions it is 1 / A on average, at any range; what is neither stays as it was."""
    law = law_of(prepare(default_params()), jnp.int32(LEFT))
    found = anywhere(law, jnp.asarray(is_side), jnp.asarray(is_order), jnp.log(jnp.float32(50.0)))
    if not (is_side or is_order):
        jax.tree.map(np.testing.assert_array_equal, found, law)
        return
    turn = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
    for metres in (0.5, 9.0):
        value = log_density_in_frame(found, metres * jnp.cos(turn), metres * jnp.sin(turn))
        density = np.exp(np.asarray(value, float))
        assert density.mean() == pytest.approx(1 / 50.0, rel=1e-3)
        # Left of the way is where it is likeliest; an order alone says nothing of the side.
        ratio = density[np.argmin(np.abs(turn - np.pi / 2))] / density.min()
        expected = np.exp(2 * SIDE_CONCENTRATION) if is_side else 1.0
        assert ratio == pytest.approx(expected, rel=1e-2)


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
