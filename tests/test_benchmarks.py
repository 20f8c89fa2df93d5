"""The baselines of benchmarks/ solve the problem they are timed on, and so do we."""

import importlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import bench
import jax
import numpy as np
import numpy_twin
import pytest
import record

from jaxlangnav.cli import bench as command
from jaxlangnav.cli.main import main
from jaxlangnav.experiments import timing


@pytest.fixture(scope="module", autouse=True)
def scripts() -> Iterator[None]:
    """Take out the pinning of threads that the scripts begin with."""
    pinning = ModuleType("pinning")
    pinning.CORE = None
    sys.modules["pinning"] = pinning
    yield
    del sys.modules["pinning"]


def kalman(drive) -> np.ndarray:
    """Filter a drive exactly, f64[L + 1, 2]: landmarks, then the robot; metres."""
    scenario = load("slam_scenario")
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


def load(name: str) -> ModuleType:
    return importlib.import_module(name)


def by_dynamax(drive) -> tuple[np.ndarray, np.ndarray]:
    pytest.importorskip("dynamax")
    rival = load("dynamax_filter")
    with jax.numpy_rank_promotion("allow"):
        return rival.estimate(rival.prepare(drive, 50, 0)())


def by_ours(drive) -> tuple[np.ndarray, np.ndarray]:
    ours = load("fastslam")
    return ours.estimate(ours.run_core(*ours.arrays(drive, 0)))


@pytest.mark.parametrize(
    ("estimate", "error"),
    [
        # 300 sampled ways of six noisy steps, 0.05 m each: their mean strays by centimetres.
        (lambda drive: load("fastslam_loop").run(drive, 300, seed=1), 0.05),
        # The package starts with a robot known to a centimetre, the exact one to a tenth of it.
        (by_ours, 0.005),
        pytest.param(by_dynamax, 0.05, marks=pytest.mark.slow),
    ],
    ids=["loop", "ours", "dynamax"],
)
@pytest.mark.filterwarnings("ignore:.*deprecated:DeprecationWarning")
def test_filters_are_near_the_exact_one(estimate, error: float) -> None:
    drive = load("slam_scenario").drive(6, 0)
    robot, landmarks = estimate(drive)
    exact = kalman(drive)
    np.testing.assert_allclose(robot, exact[-1], atol=error)
    np.testing.assert_allclose(landmarks, exact[:-1], atol=error)


def test_entries_judge_themselves() -> None:
    keys = {"name", "value", "unit", "baseline", "ratio", "target", "holds"}
    plain = record.entry("rate", 170.0, "1/s")
    assert set(plain) == keys
    assert plain["holds"] is None
    assert record.entry("time", 50.0, "s", target=60.0, is_limit=True)["holds"] is True
    assert record.entry("time", 70.0, "s", target=60.0, is_limit=True)["holds"] is False
    judged = record.entry("step", 2.0, "ms") | record.against(2.0, 7.0, 3.0)
    assert (judged["baseline"], judged["ratio"], judged["holds"]) == (7.0, 3.5, True)


def test_costs_are_measured() -> None:
    def busy() -> None:
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass

    cost = timing.measure(busy, 3)
    assert 0.04 < cost.cpu < 0.5
    assert cost.wall >= 0.9 * cost.cpu / max(1, timing.usable_cores())


def test_patience_ends_repetitions() -> None:
    calls = []
    timing.measure(lambda: calls.append(time.sleep(0.02)), 50, max_seconds=0.05)
    assert 1 <= len(calls) < 10
    timing.measure(lambda: calls.clear(), 1, max_seconds=0.0)
    assert calls == []


def test_shares_by_hand() -> None:
    parts = {"the cycle": 80e-6, "the sensor": 8e-6, "the filter": 40e-6}
    found = [(one["name"], round(one["value"], 6)) for one in bench.share_entries(parts)]
    assert found == [
        ("one cycle of one lane", 80.0),
        ("share of the sensor", 10.0),
        ("share of the filter", 50.0),
    ]


def walk(particles: int, *, is_looping: bool) -> tuple[numpy_twin.Twin, np.ndarray]:
    """Walk past a cone, then a hydrant behind it."""
    twin = numpy_twin.start(particles, seed=3)
    noise, robot, waypoint = np.random.default_rng(0), np.zeros(2), np.zeros(2)
    for index in range(10):
        move = np.array([0.8, 0.1]) if index else np.zeros(2)
        robot = robot + move
        seen = [
            (kind, *(np.array(place) - robot + noise.normal(0.0, 0.05, 2)))
            for kind, place in ((1, (5.0, 0.5)), (0, (8.0, 0.9)))
            if np.hypot(*(np.array(place) - robot)) < 3.0
        ]
        waypoint = numpy_twin.step(twin, move, seen, 3.0, is_looping=is_looping)
    return twin, waypoint


@pytest.mark.parametrize("is_looping", [False, True])
def test_the_twin_maps_what_it_sees_and_goes_there(is_looping: bool) -> None:
    twin, waypoint = walk(48, is_looping=is_looping)
    weight = np.exp(twin.log_weight)
    assert weight.sum() == pytest.approx(1.0, abs=1e-6)
    types = twin.particles["type"]
    assert np.all(np.sort(types, axis=0)[-2:] == [[0], [1]])
    assert np.all(types[2:] == -1)
    mean = twin.particles["mean"][:, :-1] @ weight
    np.testing.assert_allclose(mean[:, types[:, 0] == 1][:, 0], [5.0, 0.5], atol=0.4)
    np.testing.assert_allclose(mean[:, types[:, 0] == 0][:, 0], [8.0, 0.9], atol=0.4)
    np.testing.assert_allclose(waypoint, [8.0, 0.9], atol=0.5)


def test_the_twins_precision_is_that_of_a_dense_filter() -> None:
    """One object seen four times from a robot that moves: information form against Kalman form."""
    twin = numpy_twin.start(2, seed=0)
    covariance = np.diag([1e6, 1e-4])  # object, robot: one axis
    for index in range(4):
        move = np.array([0.5, 0.0]) if index else np.zeros(2)
        covariance[1, 1] += 0.02**2 * float(move @ move) + 1e-12
        gain = np.array([1.0, -1.0])
        innovation = gain @ covariance @ gain + 0.1**2
        covariance -= np.outer(covariance @ gain, gain @ covariance) / innovation
        numpy_twin.step(twin, move, [(0, 2.0 - 0.5 * index, 0.0)], 3.0, is_looping=False)
    found = np.linalg.inv(twin.particles["precision"][:, :, 0])
    assert found[-1, -1] == pytest.approx(covariance[1, 1], rel=0.02)
    assert found[0, 0] == pytest.approx(covariance[0, 0], rel=0.02)


def test_programs_compile_anew_without_the_cache_which_is_then_as_before() -> None:
    before = dict(jax.config.values)
    with bench.without_cache():
        assert not jax.config.values["jax_enable_compilation_cache"]
    assert jax.config.values == before


def test_without_a_checkout_bench_says_so(monkeypatch, tmp_path: Path, capsys) -> None:
    monkeypatch.setattr(command, "FOLDER", tmp_path)
    assert main(["bench"]) == 2
    told = capsys.readouterr().err
    assert "from a checkout" in told
    assert told.count("\n") == 1
