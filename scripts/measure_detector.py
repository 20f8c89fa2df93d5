"""Measure the tag detector of the robots' camera: detection rate, error, false tags.

    python scripts/measure_detector.py [LOOKS]

A robot stands before one thing at a time, at many ranges, bearings and turns of its cube. Counted
are things, after all gates but that of range. Prints a Markdown table, which docs/robot.md shows;
``robots/physics/tags.py`` holds what the belief is told. Needs ``jaxlangnav[robot]`` and EGL.
"""

import argparse
import dataclasses
import itertools
import sys
from collections.abc import Sequence

import numpy as np

from jaxlangnav.inputs.sanitize import markdown_table
from jaxlangnav.robots.physics.robot import PhysicsRobot, SensorErrors
from jaxlangnav.robots.physics.tags import TAGS_PER_TYPE, Gates
from jaxlangnav.world.state import HYDRANT, make_scenario

MEASURED_RANGES = (1.25, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0)
"""Metres."""
MEASURED_TURNS = (0.0, 15.0, 30.0, 45.0)
"""Degrees between the line of sight and the nearest side's normal; 45 is a cube's corner."""
NOMINAL = SensorErrors()
PICTURES = {"clean": (0.0, 0.0), "as told": (NOMINAL.grain, NOMINAL.blur), "bad": (12.0, 1.6)}
"""Grain, grey levels, and blur, pixels."""
_FARTHEST = 20.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Figure:
    """Detector statistics in one condition."""

    picture: str
    range: float  # metres
    turned: float  # degrees
    looks: int
    rate: float  # detection rate
    bias: float  # metres, mean error of the range; NaN without detections
    error: float  # metres, root mean square of the position error, each axis
    false: int  # false tags


def measure(
    *,
    looks: int = 6,
    ranges: Sequence[float] = MEASURED_RANGES,
    pictures: Sequence[str] = tuple(PICTURES),
) -> list[Figure]:
    """Measure the Husky's detector, also the wheelchair's, for each picture, range and turn.

    Args:
        looks: of each kind, at bearings drawn within the gate.
        ranges: metres.
        pictures: names in ``PICTURES``.
    """
    scenario = make_scenario([(HYDRANT, 500.0, 0.0)])
    figures = []
    for picture in pictures:
        grain, blur = PICTURES[picture]
        errors, gates = SensorErrors(grain=grain, blur=blur), Gates(range=_FARTHEST)
        robot = PhysicsRobot("husky", scenario, seed=0, gates=gates, errors=errors)
        rng = np.random.default_rng(0)
        for distance, angle in itertools.product(ranges, MEASURED_TURNS):
            figures.append(_measure_condition(robot, rng, picture, distance, angle, looks))
        robot.close()
    return figures


def _measure_condition(
    robot: PhysicsRobot,
    rng: np.random.Generator,
    picture: str,
    distance: float,
    turned: float,
    looks: int,
) -> Figure:
    """Observe one object at one range and orientation."""
    errors, biases, false = [], [], 0
    half = 0.5 * Gates(range=_FARTHEST).field_of_view
    x, y, heading = robot.true_pose
    for _ in range(looks):
        bearing = rng.uniform(-half, half) * 0.98
        angle = heading + bearing
        position = np.array([x + distance * np.cos(angle), y + distance * np.sin(angle)])
        robot.scene.set_position("thing0", *position)
        robot.scene.set_heading("thing0", angle + rng.choice([-1, 1]) * np.deg2rad(turned))
        robot.settle()
        detections = robot.detections() or []
        false += sum(tag.tag_id != HYDRANT * TAGS_PER_TYPE for tag in robot.last_tags)
        for detection in detections[:1]:
            errors.append(np.array([x, y]) + detection.offset(heading) - position)
            biases.append(detection.range - distance)
    return Figure(
        picture=picture,
        range=distance,
        turned=turned,
        looks=looks,
        rate=len(errors) / looks,
        bias=float(np.mean(biases)) if biases else float("nan"),
        error=float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan"),
        false=false,
    )


def tabulate(figures: Sequence[Figure]) -> tuple[list[str], list[list[str]]]:
    """Build a table: a row for each picture and range, a column for each turn."""
    angles = list(dict.fromkeys(figure.turned for figure in figures))
    headings = ["picture", "range (m)", *(f"{angle:g}°" for angle in angles)]
    rows: dict[tuple[str, float], list[str]] = {}
    for figure in figures:
        cell = f"{100 * figure.rate:.0f} %"
        if figure.rate > 0:
            cell += f", {100 * figure.bias:+.1f}, {100 * figure.error:.1f} cm"
        cell += f", {figure.false} false" if figure.false else ""
        rows.setdefault((figure.picture, figure.range), []).append(cell)
    return headings, [[name, f"{distance:g}", *cells] for (name, distance), cells in rows.items()]


def main() -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description="Measure the robots' camera and tags.")
    parser.add_argument("looks", nargs="?", type=int, default=6, help="of each kind; 6")
    looks = parser.parse_args().looks
    if looks < 1:
        parser.error(f"looks is {looks}, but must be at least 1")
    try:
        figures = measure(looks=looks)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown_table(*tabulate(figures)))
    near = [figure for figure in figures if figure.picture == "as told" and figure.range <= 4.0]
    rate = np.mean([figure.rate for figure in near])
    error = np.sqrt(np.nanmean([figure.error**2 for figure in near]))
    false = sum(figure.false for figure in figures)
    print(f"As told, to 4 m: found {100 * rate:.1f} %, error {100 * error:.1f} cm each axis;")
    print(f"{false} false tags in {sum(figure.looks for figure in figures)} looks.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
