"""The Gaussian map solve: ours, a thousand maps at once, against GTSAM on prebuilt graphs.

    python benchmarks/gtsam_solve.py [--quick] [--json]

A map is a robot and eight objects in the plane: a prior on the robot, a relative position of each
object, and two more between objects, all linear and Gaussian, each with a noise of its own. GTSAM
is handed its factor graphs and an elimination order ready; ours assembles Λ and η from the same
factors within the time that is measured, and gives all means and the joint covariance. GTSAM is
timed for the means alone, and for the means with the marginal covariance of the robot.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

from typing import NamedTuple

import gtsam
import jax
import jax.numpy as jnp
import numpy as np
import record
from jax import Array

from jaxlangnav.experiments.measuring import Entry, against, entry, measure
from jaxlangnav.numerics import gaussian

NUM_OBJECTS = 8
ROBOT = NUM_OBJECTS
EDGES = np.array([(index, ROBOT) for index in range(NUM_OBJECTS)] + [(1, 0), (5, 4)])
"""i64[F, 2], pairs (of, from) whose relative position is measured."""
PRIOR = 0.01
"""Standard deviation of the robot's start, each axis, metres."""


class Maps(NamedTuple):
    """Maps to be solved; the axis of the maps comes last."""

    robot: np.ndarray | Array  # f[2, maps] metres, the prior's mean
    offset: np.ndarray | Array  # f[F, 2, maps] metres, measured
    noise: np.ndarray | Array  # f[F, maps] metres, standard deviation, each axis


def draw(number: int) -> Maps:
    """Draw maps.

    Args:
        number: how many.

    Returns:
        The maps in float64.
    """
    random = np.random.default_rng(0)
    places = random.uniform(-10.0, 10.0, (NUM_OBJECTS + 1, 2, number))
    noise = random.uniform(0.05, 0.2, (len(EDGES), number))
    offset = places[EDGES[:, 0]] - places[EDGES[:, 1]]
    offset = offset + noise[:, None] * random.normal(size=offset.shape)
    return Maps(places[ROBOT], offset, noise)


def solve_one(one: Maps) -> tuple[Array, Array]:
    """Assemble a map in canonical form and solve it.

        Λ = e_r e_rᵀ / σ₀² + Σ_f h_f h_fᵀ / σ_f²,   η = e_r x₀ / σ₀² + Σ_f h_f z_f / σ_f²

    Args:
        one: a single map.

    Returns:
        Mean f32[2, N] and covariance f32[N, N] of the N = 9 places; the axes share Σ.
    """
    unit = jnp.eye(NUM_OBJECTS + 1)
    edges = unit[EDGES[:, 0]] - unit[EDGES[:, 1]]
    share = 1.0 / jnp.square(one.noise)
    precision = jnp.diag(unit[ROBOT]) / PRIOR**2
    for edge, own in zip(edges, share, strict=True):
        precision = precision + own * edge[:, None] * edge[None, :]
    covariance = gaussian.invert(precision)
    information = [
        unit[ROBOT] * one.robot[axis] / PRIOR**2
        + jnp.sum(edges * (share * one.offset[:, axis])[:, None], axis=0)
        for axis in range(2)
    ]
    means = [jnp.sum(covariance * own[None, :], axis=1) for own in information]
    return jnp.stack(means), covariance


solve = jax.jit(jax.vmap(solve_one, in_axes=-1, out_axes=-1))


def graphs(maps: Maps) -> list[gtsam.GaussianFactorGraph]:
    """Build GTSAM's factor graph of every map."""
    built = []
    eye = np.eye(2)
    for index in range(maps.robot.shape[-1]):
        graph = gtsam.GaussianFactorGraph()
        prior = gtsam.noiseModel.Isotropic.Sigma(2, PRIOR)
        graph.add(gtsam.JacobianFactor(ROBOT, eye, maps.robot[:, index], prior))
        for number, (of, origin) in enumerate(EDGES):
            noise = gtsam.noiseModel.Isotropic.Sigma(2, maps.noise[number, index])
            offset = np.asarray(maps.offset[number, :, index])
            graph.add(gtsam.JacobianFactor(int(origin), -eye, int(of), eye, offset, noise))
        built.append(graph)
    return built


def entries(*, is_quick: bool) -> list[Entry]:
    """Measure everything.

    Args:
        is_quick: fewer maps and repetitions.

    Returns:
        Entries of the bench's document.
    """
    number, repetitions = (200, 3) if is_quick else (1000, 9)
    maps = draw(number)
    built = graphs(maps)
    order = gtsam.Ordering.ColamdGaussianFactorGraph(built[0])
    ours = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), maps)
    mean, _ = jax.block_until_ready(solve(ours))

    def optimize() -> list[gtsam.VectorValues]:
        return [graph.optimize(order) for graph in built]

    def with_marginal() -> list[np.ndarray]:
        found = []
        for graph in built:
            tree = graph.eliminateMultifrontal(order)
            tree.optimize()
            found.append(tree.marginalCovariance(ROBOT))
        return found

    theirs = np.array([[own.at(place) for place in range(NUM_OBJECTS + 1)] for own in optimize()])
    difference = float(np.max(np.abs(np.moveaxis(np.asarray(mean), -1, 0) - theirs.swapaxes(1, 2))))
    cost = 1e6 * measure(lambda: solve(ours), repetitions).cpu / number
    means = 1e6 * measure(optimize, repetitions).cpu / number
    marginal = 1e6 * measure(with_marginal, repetitions).cpu / number
    unit = "µs CPU a map"
    return [
        entry("map solve against GTSAM, prebuilt graphs, means only", cost, unit)
        | against(cost, means, 5.0),
        entry("map solve against GTSAM, prebuilt graphs, means and a marginal", cost, unit)
        | against(cost, marginal, 5.0),
        entry(
            "largest difference of the means from GTSAM's",
            difference,
            "m",
            target=0.001,
            is_limit=True,
        ),
    ]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
