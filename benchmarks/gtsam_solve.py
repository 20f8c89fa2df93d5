"""The Gaussian map solve: ours, a thousand maps at once, against GTSAM on prebuilt graphs.

    python benchmarks/gtsam_solve.py [--quick] [--json]

A map is a robot and eight objects in the plane: a prior on the robot, a relative position of each
object, and two more between objects, all linear and Gaussian, each with a noise of its own. GTSAM
is handed its factor graphs and an elimination order ready, and solves them. Ours never solves: as
the filter does with detections, it enters the objects and conditions on one factor after the
other, from the bare factors on, and ends with the same means and the whole joint covariance. GTSAM
is timed for the means alone, and for the means with the marginal covariance of the robot.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

from typing import NamedTuple

import gtsam
import jax
import jax.numpy as jnp
import numpy as np
import record
from record import Measurement, against, entry
from jax import Array

from jaxlangnav.experiments.timing import measure
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


def solve_all(maps: Maps) -> tuple[Array, Array]:
    """Enter the objects and condition on the remaining factors, as the filter does.

    Args:
        maps: all of them, the axis of the maps last.

    Returns:
        Means f32[2, N, maps] and covariances f32[N, N, maps] of the N = 9 places; the axes share Σ.
    """
    unit = (jnp.arange(NUM_OBJECTS + 1) == ROBOT).astype(jnp.float32)[:, None]
    number = maps.robot.shape[-1]
    start = gaussian.Moments(
        jnp.broadcast_to(PRIOR**2 * unit[:, None] * unit[None], (*unit.shape[:1] * 2, number)),
        unit * maps.robot[:1],
        unit * maps.robot[1:],
    )
    offset, variance = jnp.asarray(maps.offset), jnp.square(maps.noise)
    is_new = jnp.broadcast_to(unit == 0.0, (NUM_OBJECTS + 1, number))
    first = jnp.pad(offset[:NUM_OBJECTS], ((0, 1), (0, 0), (0, 0)))
    own = jnp.pad(variance[:NUM_OBJECTS], ((0, 1), (0, 0)))
    entered = gaussian.enter(start, ROBOT, is_new, first[:, 0], first[:, 1], own)
    further = [(int(of), int(origin)) for of, origin in EDGES[NUM_OBJECTS:]]
    rest = slice(NUM_OBJECTS, None)
    is_used = jnp.ones((len(further), number), bool)
    found = gaussian.condition_offsets(
        entered, further, is_used, offset[rest, 0], offset[rest, 1], variance[rest]
    )
    return jnp.stack([found.mean_x, found.mean_y]), found.covariance


solve = jax.jit(solve_all)


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


def entries(*, is_quick: bool) -> list[Measurement]:
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
