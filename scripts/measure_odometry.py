"""Measure the error of the robots' dead reckoning.

    python scripts/measure_odometry.py [DRIVES]

The belief takes each cycle's error for independent, its standard deviation a share of the cycle's
way (``MotionParams.odometry_noise``). A robot's is not: a skid-steer slides aside in a turn and
partly back, a wheel's radius and a gyro's bias are out all along. So the share is measured with
which that law is right over several numbers of cycles. Prints a Markdown table, which docs/robot.md
shows; ``robots/physics/robot.py`` holds what the belief is told. Needs ``jaxlangnav[robot]`` and
EGL.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence

import numpy as np

from jaxlangnav.inputs.sanitize import markdown_table
from jaxlangnav.robots.driver import DECISION_SECONDS
from jaxlangnav.robots.physics.robot import ODOMETRY_NOISE, ROBOT_MODELS, PhysicsRobot
from jaxlangnav.robots.physics.tags import Gates
from jaxlangnav.robots.robot import WaypointStatus
from jaxlangnav.world.state import make_scenario

SPANS = (1, 2, 4, 8, 16)
"""Numbers of cycles over which the noise model is fitted."""
_NUM_LEGS, _MIN_LEG, _MAX_LEG = 5, 1.0, 4.0  # of a drive, and metres of each
_EDGE = 6.0  # metres from the start within which they end


@dataclasses.dataclass(frozen=True, kw_only=True)
class OdometryFigures:
    """Odometry statistics of a robot's drives."""

    machine: str
    drives: int
    way: float  # metres, mean of a drive
    shares: tuple[float, ...]  # of ``SPANS``: standard deviation of an axis, as the belief has it
    end: float  # mean distance between true and reckoned end, as a share of the way
    end_most: float  # the largest such share
    heading: float  # radians, mean error at the end


def measure(machine: str, *, drives: int = 30, seed: int = 0) -> OdometryFigures:
    """Drive "husky" or "wheelchair" in an empty area, and compare odometry with the true pose.

    Each drive has wheels, gyro and places of its own; their seeds follow upon the first one.
    """
    logs = [_drive(machine, seed + i) for i in range(drives)]
    way = np.array([np.hypot(*np.diff(log[:, :2], axis=0).T).sum() for log in logs])
    errors = np.array([log[-1, :3] - log[-1, 3:] for log in logs])
    ends = np.hypot(errors[:, 0], errors[:, 1]) / way
    headings = np.abs((errors[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return OdometryFigures(
        machine=machine,
        drives=drives,
        way=float(way.mean()),
        shares=tuple(_noise_fraction(logs, span) for span in SPANS),
        end=float(ends.mean()),
        end_most=float(ends.max()),
        heading=float(headings.mean()),
    )


def _drive(machine: str, seed: int) -> np.ndarray:
    """Drive once: f64[T, 6], pose by odometry and true pose after each cycle."""
    scenario = make_scenario(area=(-_EDGE, _EDGE, -_EDGE, _EDGE))
    robot = PhysicsRobot(machine, scenario, seed=seed, gates=Gates(range=1.0))
    rng, goal = np.random.default_rng(seed), np.zeros(2)
    log = [np.append(robot.pose(), robot.true_pose)]
    for _ in range(_NUM_LEGS):
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(_MIN_LEG, _MAX_LEG)
        goal = np.clip(goal + distance * np.array([np.cos(angle), np.sin(angle)]), -_EDGE, _EDGE)
        robot.go_to(goal, speed=1.0, clearance=0.0)
        progress = WaypointStatus.UNDER_WAY
        while progress is WaypointStatus.UNDER_WAY:
            progress = robot.wait(DECISION_SECONDS)
            log.append(np.append(robot.pose(), robot.true_pose))
    robot.close()
    return np.array(log)


def _noise_fraction(logs: Sequence[np.ndarray], span: int) -> float:
    """Estimate the noise fraction with which independent cycle errors explain those of a span.

        σ² = Σ |e|² / (2 Σ d²)

    with e the error of a span and d the ways of its cycles.
    """
    squared_errors = squared_distances = 0.0
    for log in logs:
        errors_at = log[:, :2] - log[:, 3:5]
        squares = np.append(0.0, np.cumsum((np.diff(log[:, :2], axis=0) ** 2).sum(axis=1)))
        squared_errors += float(((errors_at[span:] - errors_at[:-span]) ** 2).sum())
        squared_distances += float(2.0 * (squares[span:] - squares[:-span]).sum())
    return float(np.sqrt(squared_errors / squared_distances))


def odometry_table(figures: Sequence[OdometryFigures]) -> tuple[list[str], list[list[str]]]:
    """Build a table of the figures of ``measure``: headings and rows."""
    spans = [f"{span} cycle" + ("s" if span > 1 else "") for span in SPANS]
    headings = ["robot", *spans, "told", "end, mean (most)", "heading"]
    rows = []
    for row in figures:
        shares = [f"{100 * share:.1f} %" for share in row.shares]
        end = f"{100 * row.end:.1f} % ({100 * row.end_most:.1f} %)"
        assumed = f"{100 * ODOMETRY_NOISE[row.machine]:g} %"
        rows.append([row.machine, *shares, assumed, end, f"{np.rad2deg(row.heading):.1f}°"])
    return headings, rows


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description="Measure the robots' odometry.")
    parser.add_argument("drives", nargs="?", type=int, default=30, help="of each robot; 30")
    drives = parser.parse_args().drives
    if drives < 1:
        parser.error(f"drives is {drives}, but must be at least 1")
    try:
        results = [measure(name, drives=drives) for name in ROBOT_MODELS]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown_table(*odometry_table(results)))
    print(f"{drives} drives each, mean way {', '.join(f'{row.way:.1f} m' for row in results)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
