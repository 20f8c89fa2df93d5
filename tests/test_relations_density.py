"""Relations: density, frames, information, gradients, order, and what lies between (sec. 3.2)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from oracles import relations as oracle
from readings import central

from jaxlangnav.grounding.worlds import Geometry
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, RELATIONS, RIGHT
from jaxlangnav.pytree import replace
from jaxlangnav.relations import (
    RelationParams,
    between,
    default_params,
    density_of,
    holds,
    log_density,
    prepare,
    robot_frame,
    sample_pdf,
    to_map,
    viewer_frame,
)
from jaxlangnav.relations.between import lies_between
from jaxlangnav.relations.strength import count_before, degree, kth_smallest
from jaxlangnav.relations.table import NUM_RANKS, ORDERS

ALL = range(len(RELATIONS))
VIEWER, LANDMARK = (1.0, -2.0), (4.0, 2.0)


@jax.jit
def density_at(params: RelationParams, relation: int, x: jax.Array, y: jax.Array) -> jax.Array:
    frame = viewer_frame(*VIEWER, *LANDMARK)
    return log_density(density_of(prepare(params), relation), x, y, frame)


@jax.jit
def draw(params: RelationParams, relation: int, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    normal = jax.random.normal(key, (2, 200_000))
    model = prepare(params)
    along, lateral = sample_pdf(density_of(model, relation), model, relation, *normal)
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
    """Distance and direction by Kolmogorov and Smirnov, at 1e-5, and independent of each other."""
    x, y = (np.asarray(v, float) for v in draw(default_params(), relation, jax.random.key(0)))
    numbers, sight = law(relation), np.arctan2(4.0, 3.0)
    log_r = np.log(np.hypot(x, y) / numbers["median"]) / numbers["spread"]
    turn = np.angle(np.exp(1j * (np.arctan2(y, x) - sight - numbers["axis"])))
    grid = np.linspace(-np.pi, np.pi, 20_001)
    density = np.exp(numbers["concentration"] * (np.cos(grid) - 1))
    below = scipy.integrate.cumulative_simpson(density, x=grid, initial=0.0)
    assert scipy.stats.kstest(log_r, scipy.stats.norm.cdf).pvalue > 1e-5
    assert scipy.stats.kstest(np.interp(turn, grid, below / below[-1]), "uniform").pvalue > 1e-5
    assert abs(np.corrcoef(log_r, turn)[0, 1]) < 5 / np.sqrt(x.size)


TURNS = {BEHIND: 0.0, LEFT: np.pi / 2, FRONT: np.pi, RIGHT: -np.pi / 2}
"""From the line of sight, to the left; of the robot itself from behind it, to the right."""


@pytest.mark.parametrize(
    ("pose", "landmark"),
    [
        ((0.0, 0.0, 0.0), (5.0, 0.0)),
        ((2.0, 0.0, 0.0), (2.0, 4.0)),  # seen along +y, left of the cone is −x
        *(((0.0, 0.0, heading), None) for heading in (0.0, 1.0, -2.5)),
    ],
)
def test_sides_by_hand(pose: tuple, landmark: tuple | None) -> None:
    """Of a landmark as the viewer sees it; "in front of you" is ahead, whatever the heading."""
    model, (x, y, heading) = prepare(default_params()), pose
    if landmark is None:
        where, frame, own = (x, y), robot_frame(jnp.float32(heading)), [heading]
        angles = {one: heading + np.pi - turn for one, turn in TURNS.items()}
    else:
        where, frame, own = landmark, viewer_frame(x, y, *landmark), []
        sight = np.arctan2(where[1] - y, where[0] - x)
        angles = {one: sight + turn for one, turn in TURNS.items()}
    for relation in TURNS:
        values, pdf = {}, density_of(model, relation)
        for other, angle in angles.items():
            offset = 2.0 * np.array([np.cos(angle), np.sin(angle)])
            values[other] = float(log_density(pdf, *jnp.float32(offset), frame))
            is_so = bool(holds(relation, where + offset, where, (x, y), *own))
            assert is_so == (other == relation), (RELATIONS[relation], RELATIONS[other])
        second, best = sorted(values.values())[-2:]
        assert values[relation] == best > second + 5.0


def test_near_and_far_hold_by_the_distance() -> None:
    assert bool(holds(NEAR, (5.0, 3.0), (5.0, 0.0), (0.0, 0.0)))
    assert bool(holds(FAR, (5.0, 8.0), (5.0, 0.0), (0.0, 0.0)))


def test_density_is_finite_at_and_far_from_the_landmark() -> None:
    on_the_landmark = viewer_frame(1.0, 1.0, 1.0, 1.0)
    assert np.isfinite(np.array(jax.tree.leaves(on_the_landmark))).all()
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


FIELDS = ("log_distance", "log_distance_sd", "axis", "concentration")


def density_of_all(params: RelationParams) -> jax.Array:
    return sum(density_at(params, relation, jnp.float32(2.0), jnp.float32(1.5)) for relation in ALL)


@jax.jit
def draws_of_all(params: RelationParams) -> jax.Array:
    """Draws move smoothly with the parameters (the table is part of the derivative)."""
    normal = jnp.float32(0.4), jnp.float32(0.7)
    model = prepare(params)
    drawn = [sample_pdf(density_of(model, r), model, r, *normal) for r in ALL]
    return sum(along + 2.0 * lateral for along, lateral in drawn)


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize(("value", "step"), [(density_of_all, 1e-2), (draws_of_all, 3e-2)])
def test_gradient_by_parameters_equals_finite_differences(value, step: float, field: str) -> None:
    start = replace(default_params(), concentration=3.0 + 0.0 * default_params().axis)
    gradient = np.asarray(getattr(jax.grad(value)(start), field))
    assert np.isfinite(gradient).all()
    for relation in ALL:
        difference, error = central(
            lambda by, of=relation: value(
                replace(start, **{field: getattr(start, field).at[of].add(by)})
            ),
            step,
        )
        assert abs(difference - gradient[relation]) < error


DEGREE = jax.jit(degree)
NTH = jax.jit(kth_smallest, static_argnames="tie")


def test_one_step_to_the_left_by_hand() -> None:
    """3 m away and 2 m to the left: the far one by 3, the leftmost by 2, the nearest by -3."""
    expected = {FRONT: -3.0, BEHIND: -3.0, LEFT: 2.0, RIGHT: -2.0, NEAR: -3.0, FAR: 3.0}
    for relation, value in expected.items():
        assert float(degree(relation, np.array(3.0), np.array(2.0))) == value


def test_host_and_device_agree() -> None:
    generator = np.random.default_rng(0)
    distance, sideways = generator.uniform(-5, 5, (2, 100)).astype(np.float32)
    for relation in range(len(RELATIONS)):
        on_device = DEGREE(jnp.full(100, relation), jnp.asarray(distance), jnp.asarray(sideways))
        np.testing.assert_array_equal(on_device, degree(relation, distance, sideways))


@pytest.mark.parametrize("relation", ORDERS)
def test_who_is_nth_on_the_host_is_nth_on_the_device(relation: int) -> None:
    generator = np.random.default_rng(relation)
    objects = tuple(("cone", *generator.uniform(-5, 5, 2)) for _ in range(6))
    geometry = Geometry(PlacedWorld(objects=objects, robot=(0.3, -0.2, 0.9)))
    strength = geometry.strength[relation, :, 6]
    before = count_before(strength, ~np.eye(6, dtype=bool))
    merit = jnp.asarray(-strength, jnp.float32)
    for rank in range(1, NUM_RANKS + 1):
        nth = int(np.flatnonzero(before == rank - 1)[0])
        assert float(NTH(jnp.int32(rank), merit, tie=1e-6)) == float(merit[nth])
    assert float(NTH(jnp.int32(5), merit, tie=1e-6)) == np.inf


NEARER, OTHER = (5.0, 1.0), (1.0, -2.0)
"""Five metres apart: along is (0.8, 0.6)."""


def at(x, y):
    return jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)


def test_neither_landmark_comes_first_and_no_place_is_infinite() -> None:
    places = at(*np.random.default_rng(0).uniform(-8, 8, (2, 50)))
    one, other = (
        between.log_density(places, *pair)
        for pair in ((at(*NEARER), at(*OTHER)), (at(*OTHER), at(*NEARER)))
    )
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)
    assert np.isfinite(between.log_density(places, at(*OTHER), at(*OTHER))).all()


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
