"""Measure how far the robots' dead reckoning is out.

    python scripts/measure_odometry.py [DRIVES]

Prints a Markdown table; docs/robot.md shows it, ``robots/physics/odometry.py`` holds what the
belief is told of it. Needs ``jaxlangnav[robot]`` and EGL.
"""

import argparse
import sys

from jaxlangnav.inputs.sanitize import markdown_table
from jaxlangnav.robots.physics import odometry
from jaxlangnav.robots.physics.robot import MACHINES


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description="Measure the robots' odometry.")
    parser.add_argument("drives", nargs="?", type=int, default=30, help="of each robot; 30")
    drives = parser.parse_args().drives
    if drives < 1:
        parser.error(f"drives is {drives}, but must be at least 1")
    try:
        found = [odometry.measure_odometry(name, drives=drives) for name in MACHINES]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown_table(*odometry.odometry_table(found)))
    print(f"{drives} drives each, mean way {', '.join(f'{one.way:.1f} m' for one in found)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
