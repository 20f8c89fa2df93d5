"""The bench measures what it says: entries judge themselves, the NumPy twin does real work."""

import io
import time

import numpy as np
import pytest
from rich.console import Console

from jaxlangnav.speed import breakdown, measuring, numpy_twin, roofline


def test_entries_judge_themselves() -> None:
    keys = {"name", "value", "unit", "baseline", "ratio", "target", "holds"}
    plain = measuring.entry("rate", 170.0, "1/s")
    assert set(plain) == keys
    assert plain["holds"] is None
    assert measuring.entry("time", 50.0, "s", target=60.0, is_limit=True)["holds"] is True
    assert measuring.entry("time", 70.0, "s", target=60.0, is_limit=True)["holds"] is False
    judged = measuring.entry("step", 2.0, "ms") | measuring.against(2.0, 7.0, 3.0)
    assert (judged["baseline"], judged["ratio"], judged["holds"]) == (7.0, 3.5, True)


def test_costs_are_measured() -> None:
    def busy() -> None:
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass

    cost = measuring.measure(busy, 3)
    assert 0.04 < cost.cpu < 0.5
    assert cost.wall >= 0.9 * cost.cpu / max(1, measuring.usable_cores())


def test_patience_ends_repetitions() -> None:
    calls = []
    measuring.measure(lambda: calls.append(time.sleep(0.02)), 50, patience=0.05)
    assert 1 <= len(calls) < 10
    measuring.measure(lambda: calls.clear(), 1, patience=0.0)
    assert calls == []


def test_least_times_by_hand() -> None:
    peaks = roofline.Peaks(operations=100e9, bandwidth=50e9, memory_bandwidth=10e9)
    busy = breakdown.Part(name="busy", seconds=1e-3, operations=1e6, memory=1e5)
    wide = breakdown.Part(name="wide", seconds=1e-3, operations=1e6, memory=1e6)
    assert peaks.least_seconds(busy) == pytest.approx(1e-5)
    assert peaks.least_seconds(wide) == pytest.approx(2e-5)
    entries = {one["name"]: one for one in roofline.distances([busy, wide], peaks)}
    last = entries["wide of one lane against its least time at these peaks"]
    assert last["value"] == pytest.approx(1000.0)
    assert last["baseline"] == pytest.approx(20.0)
    assert last["ratio"] == pytest.approx(0.02)


def test_shares_by_hand() -> None:
    parts = [
        breakdown.Part(name=name, seconds=1e-6 * seconds, operations=0.0, memory=0.0)
        for name, seconds in (("the cycle", 80), ("the sensor", 8), ("the filter", 40))
    ]
    found = [(one["name"], round(one["value"], 6)) for one in breakdown.share_entries(parts)]
    assert found == [
        ("one cycle of one lane", 80.0),
        ("share of the sensor", 10.0),
        ("share of the filter", 50.0),
        ("share of planner, motion and the rest", 40.0),
    ]


def test_peaks_are_within_reason() -> None:
    peaks = roofline.measure_peaks(1)
    # A core of the last fifteen years: 1 to 1,000 Gflop/s, 1 to 1,000 GB/s.
    assert 1e9 < peaks.operations < 1e12
    assert 1e9 < peaks.memory_bandwidth <= peaks.bandwidth < 1e12


def test_the_table_says_all() -> None:
    document = {
        "machine": measuring.describe_machine(),
        "entries": [
            measuring.entry("cycle", 0.5, "ms CPU") | measuring.against(0.5, 20.0, 150.0),
            measuring.entry("rate", 170.0, "1/s"),
        ],
    }
    console = Console(width=120, file=io.StringIO(), record=True)
    console.print(measuring.render(document))
    text = console.export_text()
    for part in ("0.5 ms CPU", "20", "40", "150", "170 1/s", "no", "threads"):
        assert part in text


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
