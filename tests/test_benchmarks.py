"""The baselines of benchmarks/ solve the problem they are timed on, and so do we."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest

FOLDER = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def scripts() -> Iterator[None]:
    """Make the scripts importable, without the pinning of threads that they begin with."""
    sys.path.insert(0, str(FOLDER))
    pinning = ModuleType("pinning")
    pinning.CORE = None
    sys.modules["pinning"] = pinning
    yield
    sys.path.remove(str(FOLDER))
    del sys.modules["pinning"]


def kalman(drive) -> np.ndarray:
    """Filter a drive exactly, f64[L + 1, 2]: landmarks, then the robot; metres."""
    scenario = importlib.import_module("slam_scenario")
    number = len(scenario.LANDMARKS)
    covariance = np.diag([1e8] * number + [1e-8])
    mean = np.zeros((number + 1, 2))
    watch = np.hstack([np.eye(number), -np.ones((number, 1))])
    for odometry, offsets in zip(drive.odometry, drive.offsets, strict=True):
        mean[-1] += odometry
        covariance[-1, -1] += (scenario.ODOMETRY_NOISE * scenario.STEP) ** 2
        spread = watch @ covariance @ watch.T + scenario.SENSOR_NOISE**2 * np.eye(number)
        gain = np.linalg.solve(spread, watch @ covariance).T
        mean += gain @ (offsets - watch @ mean)
        covariance -= gain @ spread @ gain.T
    return mean


def test_fastslam_loop_is_near_the_exact_filter() -> None:
    scenario = importlib.import_module("slam_scenario")
    loop = importlib.import_module("fastslam_loop")
    drive = scenario.drive(6, 0)
    robot, landmarks = loop.run(drive, 300, seed=1)
    exact = kalman(drive)
    # 300 sampled ways of six noisy steps, 0.05 m each: their mean strays by a few centimetres.
    np.testing.assert_allclose(robot, exact[-1], atol=0.05)
    np.testing.assert_allclose(landmarks, exact[:-1], atol=0.05)


def test_our_step_is_the_exact_filter() -> None:
    scenario = importlib.import_module("slam_scenario")
    ours = importlib.import_module("fastslam")
    drive = scenario.drive(6, 0)
    robot, landmarks = ours.estimate(ours.run_core(*ours.arrays(drive, 0)))
    exact = kalman(drive)
    # The package starts with a robot known to a centimetre, the exact filter to a tenth of one.
    np.testing.assert_allclose(robot, exact[-1], atol=0.005)
    np.testing.assert_allclose(landmarks, exact[:-1], atol=0.005)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*deprecated:DeprecationWarning")
def test_dynamax_is_near_the_exact_filter() -> None:
    pytest.importorskip("dynamax")
    scenario = importlib.import_module("slam_scenario")
    rival = importlib.import_module("dynamax_filter")
    drive = scenario.drive(6, 0)
    with jax.numpy_rank_promotion("allow"):
        robot, landmarks = rival.estimate(rival.prepare(drive, 50, 0)())
    exact = kalman(drive)
    np.testing.assert_allclose(robot, exact[-1], atol=0.05)
    np.testing.assert_allclose(landmarks, exact[:-1], atol=0.05)


def test_the_map_solve_is_least_squares() -> None:
    pytest.importorskip("gtsam")
    solve = importlib.import_module("gtsam_solve")
    maps = solve.draw(3)
    ours = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), maps)
    mean, covariance = solve.solve(ours)
    number = solve.NUM_OBJECTS + 1
    for index in range(3):
        share = 1.0 / np.append(maps.noise[:, index], solve.PRIOR)
        rows = np.zeros((len(solve.EDGES) + 1, number))
        for row, (of, origin) in enumerate(solve.EDGES):
            rows[row, of], rows[row, origin] = 1.0, -1.0
        rows[-1, solve.ROBOT] = 1.0
        values = np.concatenate([maps.offset[:, :, index], maps.robot[None, :, index]])
        found = np.linalg.lstsq(share[:, None] * rows, share[:, None] * values, rcond=None)[0]
        np.testing.assert_allclose(mean[:, :, index].T, found, atol=1e-3)
        exact = np.linalg.inv((share[:, None] * rows).T @ (share[:, None] * rows))
        np.testing.assert_allclose(covariance[:, :, index], exact, rtol=0.02, atol=1e-6)
